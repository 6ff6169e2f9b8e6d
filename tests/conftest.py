"""What holds for every test."""

import signal

from hypothesis import settings

# The same examples in every run, so that what fails says what changed; `make search` draws others.
settings.register_profile("same", derandomize=True)
settings.register_profile("search", derandomize=False, print_blob=True)
settings.load_profile("same")


def pytest_configure() -> None:
    """A runner that was started in the background ignores Ctrl-C, and so would the processes that tests send it to."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
