"""Put a test's own device in place of the one that the config names, or around it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

from rig.backends.backend import Line, LineBackend, OpenLine, own_line
from rig.backends.driver import Clock, Transport
from rig.config.schema import DeviceSetup


@contextmanager
def lines_opened_by(instead: OpenLine) -> Iterator[None]:
    """In the block, each built-in driver speaks on the line that ``instead`` opens for a backend and a setup.

    ``instead`` may open the config's own line (``backend.line(setup)``) and wrap it.
    """
    before, own_line.instead = own_line.instead, instead
    try:
        yield
    finally:
        own_line.instead = before


def on_device(
    transport: Transport | Callable[[DeviceSetup], Transport],
    clock: Clock | None = None,
    *,
    name: str = "test",
    emulated: bool = True,
) -> AbstractContextManager[None]:
    """In the block, each built-in driver speaks to this device.

    transport  of the device, or a function that makes it for a setup
    clock      of the driver; None: the transport is a clock too
    name       of the port, for people
    emulated   whether the driver knows that no real motor is behind it
    Raises TypeError, when the driver opens, where neither is a clock.
    """

    def opened(backend: LineBackend, d: DeviceSetup) -> AbstractContextManager[Line]:
        device = transport(d) if callable(transport) else transport
        time = clock if clock is not None else device
        if not isinstance(time, Clock):
            raise TypeError("a transport without `sleep_until` needs a clock")
        return nullcontext(Line(device, time, name, emulated))

    return lines_opened_by(opened)
