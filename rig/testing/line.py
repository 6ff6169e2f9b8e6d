"""The one place to put a test's own device: instead of what the config names, or around it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

from rig.backends.backend import Line, LineBackend, OpenLine, own_line
from rig.backends.driver import Clock, Transport
from rig.config.schema import Experiment


@contextmanager
def lines_opened_by(instead: OpenLine) -> Iterator[None]:
    """In the block, each driver of a built-in kind speaks on what ``instead`` gives: for a backend and an experiment.

    It may open the line that the config names (``backend.line(experiment)``), and give that in a wrapping.
    """
    before, own_line.instead = own_line.instead, instead
    try:
        yield
    finally:
        own_line.instead = before


def on_device(
    transport: Transport | Callable[[Experiment], Transport],
    clock: Clock | None = None,
    *,
    name: str = "test",
    emulated: bool = True,
) -> AbstractContextManager[None]:
    """In the block, each driver of a built-in kind speaks to this device.

    transport  of the device, or what makes it for an experiment; where it is a clock, too, its time is the driver's
    clock      another one
    emulated   whether the driver knows that no real motor is behind it
    """

    def opened(backend: LineBackend, e: Experiment) -> AbstractContextManager[Line]:
        device = transport(e) if callable(transport) else transport
        time = clock if clock is not None else device
        if not isinstance(time, Clock):
            raise TypeError("a transport without `sleep_until` needs a clock")
        return nullcontext(Line(device, time, name, emulated))

    return lines_opened_by(opened)
