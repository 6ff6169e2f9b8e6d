"""What holds for every test."""

import contextlib
import gc
import importlib
import resource
import signal
from collections.abc import Callable, Generator, Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# The same examples in every run, so that what fails says what changed; `make search` draws others. No deadline, nor a
# time within which an example must be drawn: a busy machine exceeds it. Times are ratios to a peer, in tools/bench.
TIMELESS: dict[str, Any] = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("same", derandomize=True, **TIMELESS)
settings.register_profile("search", derandomize=False, print_blob=True, **TIMELESS)
settings.load_profile("same")

# Rooms about what is found of a motor, and about what is shown. Elsewhere a run ends without laws, or without figures.
FINDINGS = {"campaign", "compare", "export", "fuzz", "identify", "report", "results", "tools", "tune"}
SHOWN = {"compare", "report"}


def pytest_configure() -> None:
    """One in the background ignores Ctrl-C, one under nohup SIGHUP; so would the processes that tests signal."""
    for number, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, usual)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is collected stays: to look for garbage among ever more of takes a seventh of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files that take longest begin first, so that workers that share the files end together."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)


@pytest.fixture(autouse=True, scope="module")
def _loaded_for_good() -> None:
    """What is loaded by now stays: the loop collects garbage before each arming, and would look at all of it."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def largest_file() -> Callable[[int], contextlib.AbstractContextManager[None]]:
    """In its block no file of this process grows beyond so many bytes: as a full disk, but EFBIG."""

    @contextlib.contextmanager
    def limited(size: int) -> Iterator[None]:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))  # Python ignores SIGXFSZ
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return limited


@contextlib.contextmanager
def _no_drawing() -> Iterator[None]:
    """In its block figures are made but not drawn: what can go wrong with missing data goes wrong before that."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ConstrainedLayoutEngine, "execute", lambda self, figure: None)
        patch.setattr(Figure, "savefig", lambda self, buffer, **options: buffer.write(b"<svg/>"))
        yield


@contextlib.contextmanager
def _no_figures() -> Iterator[None]:
    """In its block a report says of each figure that there is none: to make them all takes longer than a run, too."""
    pages = [importlib.import_module(name) for name in ("rig.output.report.page", "rig.output.compare.page")]
    with _no_drawing(), pytest.MonkeyPatch.context() as patch:
        for page in pages:  # loaded now, or one that is loaded in the block keeps this for later tests
            patch.setattr(page, "drawn", lambda *_: pages[0].Figure(None, "not in this test"))
        yield


@pytest.fixture(autouse=True, scope="module")
def _drawn_where_looked_at(request: pytest.FixtureRequest) -> Iterator[None]:
    """To draw the figures of a report takes longer than a run in virtual time: tests marked ``drawn`` look at them."""
    made = request.node.get_closest_marker("made") or request.path.parent.name in SHOWN
    absent = _no_drawing if made else _no_figures
    with contextlib.nullcontext() if request.node.get_closest_marker("drawn") else absent():
        yield


@pytest.fixture
def undrawn() -> Iterator[None]:
    """Figures are made but not drawn, in a test of a module marked ``drawn``."""
    with _no_drawing():
        yield


@pytest.fixture
def figureless() -> Iterator[None]:
    """A report has no figures, in a test of a module marked ``drawn`` or of a room about what is shown."""
    with _no_figures():
        yield


@contextlib.contextmanager
def _no_laws() -> Iterator[None]:
    """In its block every motor is taken to be a plain one: nobody looks for laws of the motor."""
    identification = importlib.import_module("rig.identification.identification")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identification, "_add_motor_law", lambda *_: None)
        yield


@pytest.fixture(autouse=True, scope="module")
def _laws_where_looked_at(request: pytest.FixtureRequest) -> Iterator[None]:
    """To look for laws takes longer than a run in virtual time: rooms about findings, and those marked ``laws``, do."""
    looks = request.node.get_closest_marker("laws") or request.path.parent.name in FINDINGS
    with contextlib.nullcontext() if looks else _no_laws():
        yield


@pytest.fixture(autouse=True, scope="module")
def _few_ids(request: pytest.FixtureRequest) -> Iterator[None]:
    """To ask nobody takes a third of the time: in the room of servos an opening asks the ids up to 8 who is there."""
    with pytest.MonkeyPatch.context() as patch:
        if request.path.parent.name == "servo" and request.node.get_closest_marker("every_id") is None:
            patch.setattr(importlib.import_module("rig.backends.servo.opening"), "LAST_ID", 8)
        yield


@pytest.fixture
def plain_motor() -> Iterator[None]:
    """No laws in one test of a module marked ``laws``."""
    with _no_laws():
        yield


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """A campaign writes no page: that takes a second to draw, and is tested elsewhere."""
    from rig.campaign import report

    monkeypatch.setattr(report, "write_report", lambda *_: None)
