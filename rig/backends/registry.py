"""Which device a config names: the built-in ones and those of other packages, found and asked alike.

The setup of a device comes in here, and goes out as an open bench.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING

from rig.backends.backend import Backend, Unopened
from rig.backends.clock import MonotonicClock, PacedClock
from rig.backends.driver import Clock, DeviceInfo, Driver
from rig.backends.emulated.shaft import ShaftPath
from rig.backends.plug_in import GROUP, offered_backend
from rig.config.problems import Problem, wrong
from rig.config.schema import DeviceSetup
from rig.core.faults import Fault

if TYPE_CHECKING:  # these load slowly
    from rig.backends.emulated.board_process import BoardProcess
    from rig.model.bench import BenchParameters

BUILT_IN = {
    name: EntryPoint(name, f"rig.backends.{name}.backend:{name.upper()}", GROUP)
    for name in ("simulated", "serial", "modbus", "servo")
}
_REAL = "the time of this device is real, whose pace is 1"
_EMULATES = "serial"  # what `rig emulate` starts for a config whose device cannot be emulated by itself


@dataclass(frozen=True)
class Bench:
    """An open bench.

    driver, clock  what the loop runs on
    info           what the device reported when it was opened
    truth          the motor behind an emulated bench; None behind a real one
    shaft          the path of the emulated shaft so far; None where the device does not tell it
    watchdog_s     silence of the host after which it drives 0 V, as far as the config says, s; None: it has no watchdog
    times_error_s  error of the recorded time of a drive against that of a sample, at most, s
    """

    driver: Driver
    clock: Clock
    info: DeviceInfo
    truth: BenchParameters | None
    shaft: Callable[[], ShaftPath] | None = None
    watchdog_s: float | None = None
    times_error_s: float = 0.0


def backend_of(d: DeviceSetup) -> Backend:
    """The device that the config names. If there is none: a backend whose rules refuse every config."""
    return backend_named(d.daq.driver)


def backend_named(name: str) -> Backend:
    """The device of that name; as ``backend_of``."""
    if name in BUILT_IN:
        built_in: Backend = BUILT_IN[name].load()
        return built_in
    return offered_backend(name, BUILT_IN)


def rules(d: DeviceSetup) -> Iterator[Problem]:
    """The problems that keep the experiment from running on its device: keys of other devices, then its own rules."""
    own = backend_of(d)
    given = {key: value for key, value in d.daq if value is not None}
    yield from (
        own.foreign_key(d, key) for key in ("port", "usb_serial", "options") if key in given.keys() - own.shared_keys
    )
    others = [other for other in map(backend_named, BUILT_IN) if other.own_keys is not own.own_keys]
    for other in others:
        keys = other.own_keys.model_fields if other.own_keys is not None else ()
        yield from (own.foreign_key(d, key, other.name) for key in keys if key in given)
    port = d.daq.port
    if own.name in BUILT_IN and "port" in own.shared_keys and port is not None:  # a package's ports have any name
        owner = next((other.name for other in others if other.owns_port(port)), None)
        if owner is not None:
            yield wrong("daq.port", f"{port} is a port of `driver: {owner}`", "/dev/ttyACM0, or port: emulated")
            return  # rules about this link say nothing of that port
    if d.pace not in (None, 1.0) and own.name in BUILT_IN and not own.in_virtual_time(d):
        yield wrong("loop.pace", f"{d.pace:g}, but {_REAL}", "leave it out, and --pace")
    yield from own.rules(d)


def unopened(d: DeviceSetup) -> AbstractContextManager[Unopened]:
    """The driver of the config, not opened yet. An emulated device lives for the block.

    If you open the driver, close it. Raises as ``connect``, Fault LINK_OPEN included.
    """
    return backend_of(d).unopened(d)


@contextmanager
def connect(d: DeviceSetup) -> Iterator[Bench]:
    """Open the bench for the block, and stop and close it after the block.

    Raises Fault LINK_* where there is no such device, NO_WATCHDOG where the device has no watchdog and the config does
    not accept that; ConfigError where a driver of another package is not installed, or refuses its options.
    rig never simulates a device that is missing.
    """
    with unopened(d) as (driver, clock, truth, shaft):
        try:
            info = driver.open()
            if driver.failsafe is None and not d.daq.accept_no_watchdog:
                raise Fault("NO_WATCHDOG")
            if d.pace is not None and not isinstance(clock, MonotonicClock):
                clock = PacedClock(clock, d.pace)
            elif d.pace not in (None, 1.0):
                raise Fault("CONFIG_MISMATCH", f"loop.pace is {d.pace:g}, but {_REAL}")
            # only a device that says that it is emulated has a truth to compare with
            truth, shaft = truth if info.emulated else None, shaft if info.emulated else None
            own = backend_of(d)
            yield Bench(driver, clock, info, truth, shaft, own.watchdog(d).time_s, own.times_error_s(d))
        except Fault as fault:
            fault.fit(d.daq.driver)
            raise
        finally:
            try:
                driver.safe_stop()
            finally:
                driver.close()


def emulated_board(
    d: DeviceSetup, link: Path | None = None, trace: Path | None = None, *, chip: bool = False
) -> AbstractContextManager[BoardProcess]:
    """The emulated device of the config, running in real time for the block; its ``port`` is a value for daq.port.

    link   symbolic link to its port
    trace  CSV file of the truth
    chip   the Uno's firmware on its emulated chip, whatever the config's port is
    Raises EmulationError where it cannot be built or started, LookupError where no backend emulates a device.
    """
    for backend in (backend_of(d), backend_named(_EMULATES)):
        found = backend.emulated(d, link, trace, chip=chip)
        if found is not None:
            return found
    raise LookupError("no device is emulated")
