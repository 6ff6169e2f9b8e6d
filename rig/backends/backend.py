"""The interface of a kind of device: its rules, its link budget, what rig says about it, and how it opens.

Built-in devices and those of other packages use the same interface; ``rig.backends.registry`` finds them. A driver
(``rig.backends.driver``) is one open device. A backend knows a device from its config alone. ``d`` is the device's
setup throughout.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol, TypeVar

from typing_extensions import override

from rig.backends.clock import MonotonicClock
from rig.backends.driver import Clock, Driver, RelayRules, Transport
from rig.backends.emulated.shaft import ShaftPath, traced
from rig.backends.emulated.words import in_virtual_time
from rig.backends.link_budget import LinkBudget
from rig.backends.links.open_link import OpenLink
from rig.backends.tick_waits import REACTS_TICKS, unwatched_s
from rig.config.problems import Problem, wrong
from rig.config.schema import DeviceSetup, Emulated
from rig.core.section import Section
from rig.core.strict_json import JsonObject

if TYPE_CHECKING:  # these load slowly
    from rig.backends.emulated.board_process import BoardProcess
    from rig.backends.links.usb_adapters import Adapter
    from rig.core.calibration import DriveMap
    from rig.model.bench import BenchParameters

OwnSection = TypeVar("OwnSection", bound=Section)

_FORMER_PORT = "emulated-virtual"  # in older run folders; it is `emulated` now


class Watchdog(NamedTuple):
    """The watchdog that sets 0 V when the host is silent, as far as the config says.

    time_s    silence after which it acts, s; None: there is no watchdog
    unit_s    arming sets the time, in whole units of this, s; None: it was set on the device itself
    certain   False: only the device can say whether it has a watchdog
    """

    time_s: float | None
    unit_s: float | None = 0.001
    certain: bool = True


class Line(NamedTuple):
    """The open link of a driver.

    transport   carries the bytes; open
    clock       clock of its times
    name        of the port, for people
    emulated    True if no real motor can be behind it
    shaft       the path of the emulated shaft so far; None where the device does not tell it
    answered    another process has opened the device on it
    """

    transport: Transport
    clock: Clock
    name: str
    emulated: bool = False
    shaft: Callable[[], ShaftPath] | None = None
    answered: bool = False


class Unopened(NamedTuple):
    """A driver before ``open``, its clock, and the bench described under ``emulated``, if there is one.

    shaft  the path of its shaft so far; None where the device does not tell it
    """

    driver: Driver
    clock: Clock
    truth: BenchParameters | None
    shaft: Callable[[], ShaftPath] | None = None


class Backend(ABC):
    """One kind of device. Only ``unopened`` and ``emulated`` touch a device.

    name           value of ``daq.driver``
    section        schema of ``daq.options``; None: there are no options, or the driver checks them
    own_keys       the keys of ``daq`` that only this device has; for devices of rig itself
    shared_keys    which of the keys ``port``, ``usb_serial`` and ``options`` of ``daq`` it has
    has_chip       whether `rig emulate --chip` works with it

    The defaults fit a device of which nothing more is known.
    """

    name: ClassVar[str] = ""
    section: ClassVar[type[Section] | None] = None
    own_keys: ClassVar[type[Section] | None] = None
    shared_keys: ClassVar[frozenset[str]] = frozenset({"port", "options"})
    has_chip: ClassVar[bool] = True

    # ------------------------------------------------------------------ what may be run

    def rules(self, d: DeviceSetup) -> Iterator[Problem]:
        """The problems that keep an experiment from running on this device; none if it may run.

        If there is a ``section``, ``daq.options`` already fits it.
        """
        yield from ()

    def foreign_key(self, d: DeviceSetup, key: str, owner: str = "") -> Problem:
        """The problem of a key of ``daq`` that is given, and that this device does not have.

        owner  the driver whose key it is; "" for ``port``, ``usb_serial`` and ``options``
        """
        driver = f"`driver: {d.daq.driver}`"
        if key == "usb_serial":
            return wrong("daq.usb_serial", f"{driver} has no port on USB", "remove it")
        if key == "port":
            return wrong("daq.port", f"{driver} has no port", "remove it, or set daq.driver to serial")
        whose = f"`driver: {owner}`" if owner else "plug-in drivers"
        return wrong(f"daq.{key}", f"is a key of {whose}, not of {driver}", "remove it")

    def owns_port(self, port: str) -> bool:
        """Whether a port of this name can only be one of this device."""
        return False

    def watchdog(self, d: DeviceSetup) -> Watchdog:
        """The watchdog that sets 0 V when the host is silent."""
        return Watchdog(d.daq.watchdog_s, certain=False)

    def writes_first(self, d: DeviceSetup) -> bool:
        """Whether the drive of a tick goes out with the next tick. True if unknown: that is the slower case."""
        return True

    def budget(self, d: DeviceSetup) -> LinkBudget:
        """Time that one tick needs on the link; no terms where it is unknown."""
        return LinkBudget()

    def reading_budget(self, d: DeviceSetup) -> LinkBudget:
        """Time that one reading of an unarmed device needs; no terms where it is unknown."""
        return LinkBudget()

    def reply_delay_s(self, d: DeviceSetup) -> float:
        """Delay of each reply between line and host (a USB adapter), at most, s."""
        return 0.0

    def lost_reply_s(self, d: DeviceSetup) -> float:
        """For how long a drive may act on because a reply does not come, beside the device's watchdog, s."""
        return d.daq.timeout_s

    def times_error_s(self, d: DeviceSetup) -> float:
        """Error of the recorded time of a drive against that of a sample, at most, s."""
        return 1e-4

    def rehearsed(self, d: DeviceSetup) -> dict[str, JsonObject] | None:
        """The keys of ``daq`` and ``emulated`` that put an emulated device, in virtual time, in place of the real one.

        A key of ``daq`` that is None goes. None: rig emulates no such device.
        """
        return None

    # ------------------------------------------------------------------ what rig says about it

    @abstractmethod
    def words(self, d: DeviceSetup) -> str:
        """The device, and whether a real motor may turn, for people."""

    def hand(self, d: DeviceSetup) -> str:
        """What somebody at a terminal must try before the device is driven, in words; empty: nothing."""
        return ""

    def is_emulated(self, d: DeviceSetup) -> bool:
        """Whether the bench is that of section ``emulated``, so that nothing moves."""
        return False

    def plan(self, d: DeviceSetup) -> Iterator[str]:
        """Lines of `rig check` about link and device."""
        yield from ()

    def failsafe_words(self, d: DeviceSetup) -> str:
        """What stops the drive when the host is silent, for people."""
        return (
            f"failsafe: the device sets 0 V after {d.daq.watchdog_s * 1e3:g} ms of silence "
            f"({d.daq.watchdog_s / d.period_s:.3g} periods), latched until it is armed again"
        )

    def notes(self, d: DeviceSetup) -> Iterator[str]:
        """What you must know to read the results, a sentence each."""
        yield from ()

    def not_emulated_words(self, d: DeviceSetup) -> str:
        """For people: what section ``emulated`` does where this device is not emulated."""
        return "section `emulated` counts as the truth only if the driver says that its device is emulated"

    def in_virtual_time(self, d: DeviceSetup) -> bool:
        """Whether its time is virtual, as far as the config says: it passes only while the loop waits."""
        return False

    def adapter_behind(self, d: DeviceSetup) -> Adapter | None:
        """The adapter that the delays of a real USB port are computed with; None where there is no such port."""
        return None

    # ------------------------------------------------------------------ the device

    @abstractmethod
    def unopened(self, d: DeviceSetup) -> AbstractContextManager[Unopened]:
        """The driver, not opened yet. An emulated device lives for the block.

        Raises Fault LINK_OPEN where there is no port, EmulationError where a device cannot be emulated.
        """

    def stopper(self, d: DeviceSetup, descriptor: int) -> Driver | None:
        """A driver that only stops the device, on a link that this process has inherited; None: there is no such.

        descriptor  number of the open file or socket, of which its driver told; the process that opened it is gone, or
                    never speaks again
        """
        return None

    def emulated(
        self, d: DeviceSetup, link: Path | None = None, trace: Path | None = None, *, chip: bool = False
    ) -> AbstractContextManager[BoardProcess] | None:
        """The device of section ``emulated``, running in real time for the block; None: this kind has none.

        link   symbolic link to its port
        trace  CSV file of the truth
        chip   the Uno's firmware on its emulated chip, whatever the config's port is
        """
        return None

    def emulated_hint(self, d: DeviceSetup, port: str) -> str:
        """A command to try on the emulated device at ``port``, for people; "" for none."""
        return ""

    # ------------------------------------------------------------------ a recording of it

    def relay_rules(self, d: DeviceSetup, drive_map: DriveMap, clock_ratio: float) -> RelayRules | None:
        """What the device makes of the gains of a relay that it runs itself; None: it has no relay, or does not say.

        drive_map    with the units of the device that was recorded
        clock_ratio  its seconds in a second of the host
        """
        return None

    # ------------------------------------------------------------------ for those who write one

    def options(self, d: DeviceSetup, section: type[OwnSection]) -> OwnSection:
        """``daq.options``, as ``section``. Raises pydantic's ValidationError."""
        return section.model_validate_json(json.dumps(d.daq.options or {}), strict=True)


class LineBackend(Backend):
    """A kind of device behind a line: how the line opens, and which driver speaks on it."""

    @abstractmethod
    def line(self, d: DeviceSetup) -> AbstractContextManager[Line]:
        """The open line of the config. The caller closes its transport; an emulated device lives for the block."""

    @abstractmethod
    def driver(self, d: DeviceSetup, line: Line) -> Driver:
        """The driver on that line, not opened yet."""

    @override
    @contextmanager
    def unopened(self, d: DeviceSetup) -> Iterator[Unopened]:
        """On the line of the config, or on a test's own line (``rig.testing.line``)."""
        with own_line.opened(self, d) as line:
            yield Unopened(self.driver(d, line), line.clock, truth_of(d), line.shaft)

    @override
    def stopper(self, d: DeviceSetup, descriptor: int) -> Driver | None:
        """On the inherited link."""
        return self.driver(d, Line(OpenLink(descriptor), host_clock(d), "inherited", answered=True))


class Opening(Protocol):
    """How a kind of device opens: a module, which loads slowly, so that only what opens a device loads it."""

    def virtual_line(self, d: DeviceSetup) -> Line:
        """The line of the emulated device in virtual time. Raises EmulationError."""

    def transport(self, d: DeviceSetup, port: str, *, emulated: bool = False) -> Transport:
        """The open port, a real one or an emulated device's in real time. Raises Fault LINK_OPEN, CONFIG_MISMATCH."""

    def driver(self, d: DeviceSetup, line: Line) -> Driver:
        """As of ``LineBackend``."""

    def emulated_board(
        self, d: DeviceSetup, link: Path | None = None, trace: Path | None = None, *, chip: bool = False
    ) -> AbstractContextManager[BoardProcess]:
        """As ``Backend.emulated``. Raises EmulationError where it does not start."""


class PortBackend(LineBackend):
    """A device of rig's own: on a real port, or the emulated one of section ``emulated`` in its place.

    emulated_ports  words of ``daq.port`` for that one
    port_example    a port, for people
    bench_example   a config with such a section ``emulated``
    is_traced       whether the trace of its emulated device in real time tells the shaft's path
    """

    shared_keys = frozenset({"port", "usb_serial"})
    emulated_ports: ClassVar[tuple[str, ...]]
    port_example: ClassVar[str]
    bench_example: ClassVar[str] = "config/demo.yaml"
    is_traced: ClassVar[bool] = False

    @abstractmethod
    def opening(self) -> Opening:
        """How it opens."""

    @override
    def rules(self, d: DeviceSetup) -> Iterator[Problem]:
        """A port that the device can have, and the section that an emulated one needs."""
        port = d.daq.port
        if port is None:
            yield wrong("daq.port", f"`driver: {self.name}` needs a port", self.port_example)
            return
        if d.daq.usb_serial is not None and not port.startswith("/"):
            yield wrong("daq.usb_serial", f"{port} is no port on USB", "remove it")
        if port.startswith("emulated") and port not in self.emulated_ports:
            hint = "it is `emulated` now" if port == _FORMER_PORT else f"one of {', '.join(self.emulated_ports)}"
            yield wrong("daq.port", f"no {port} for `driver: {self.name}`", hint)
        elif self.is_emulated(d) and d.emulated is None:
            yield wrong(
                "emulated", f"`port: {port}` needs this section", f"describe the bench: see {self.bench_example}"
            )

    @override
    def is_emulated(self, d: DeviceSetup) -> bool:
        return d.daq.port in self.emulated_ports

    @override
    def in_virtual_time(self, d: DeviceSetup) -> bool:
        return self.is_emulated(d) and in_virtual_time(d.daq.port)

    @override
    def notes(self, d: DeviceSetup) -> Iterator[str]:
        yield from usb_notes(d)

    @override
    def not_emulated_words(self, d: DeviceSetup) -> str:
        return f"section `emulated` is not used with port {d.daq.port}"

    @override
    @contextmanager
    def line(self, d: DeviceSetup) -> Iterator[Line]:
        """Raises ValueError where the config has no port."""
        port = d.daq.port
        if port is None:
            raise ValueError("daq.port is missing")
        if self.in_virtual_time(d):
            yield self.opening().virtual_line(d)
        elif self.is_emulated(d):
            with TemporaryDirectory(prefix="rig-") as folder:
                trace = Path(folder) / "truth.csv" if self.is_traced else None
                with self.opening().emulated_board(d, trace=trace) as board:
                    line = self._line_of_port(d, board.port, emulated=True)
                    yield line if trace is None else line._replace(shaft=partial(traced, trace))
        else:
            yield self._line_of_port(d, port)

    def late_words(self, d: DeviceSetup) -> str:
        """How late answers may come until a run ends, for people."""
        watchdog_s, timeout_s = self.watchdog(d).time_s, d.daq.timeout_s
        acts_s = unwatched_s(timeout_s, d.daq.watchdog_s) if watchdog_s is None else watchdog_s
        longest_s = acts_s if watchdog_s is None else timeout_s + acts_s
        takes_s = self.budget(d).total_s
        one_s = (
            min(longest_s, max(timeout_s, acts_s - d.period_s)) - takes_s
        )  # the drive has acted for a period by then
        ticks = REACTS_TICKS + self.writes_first(d)
        late = min(int((longest_s - takes_s) / d.period_s), ticks)
        which = "each" if late == ticks else f"{late} of {ticks} in a row"
        by_a_period = f", or {which} by a period" if late else ""
        return f"late answers: one may be late by {1e3 * one_s:.0f} ms{by_a_period}; more ends the run"

    def _line_of_port(self, d: DeviceSetup, port: str, *, emulated: bool = False) -> Line:
        transport = self.opening().transport(d, port, emulated=emulated)
        return Line(transport, host_clock(d), f"{self.name}:{port}", emulated=emulated)

    @override
    def driver(self, d: DeviceSetup, line: Line) -> Driver:
        return self.opening().driver(d, line)

    @override
    def emulated(
        self, d: DeviceSetup, link: Path | None = None, trace: Path | None = None, *, chip: bool = False
    ) -> AbstractContextManager[BoardProcess]:
        return self.opening().emulated_board(d, link, trace, chip=chip)


OpenLine = Callable[[LineBackend, DeviceSetup], AbstractContextManager[Line]]


class _OwnLine:
    """The one place where a test replaces the device that the config names."""

    def __init__(self) -> None:
        self.instead: OpenLine | None = None

    def opened(self, backend: LineBackend, d: DeviceSetup) -> AbstractContextManager[Line]:
        """The line to speak on."""
        return backend.line(d) if self.instead is None else self.instead(backend, d)


own_line = _OwnLine()


def usb_notes(d: DeviceSetup) -> Iterator[str]:
    """That rig cannot tell the board of this bench from another one, where the port is on USB. Opens nothing."""
    port = d.daq.port
    if port is None or not port.startswith("/") or d.daq.usb_serial is not None:
        return
    from rig.backends.links.usb_port import UsbPort, is_usb_name, usb_port

    found = usb_port(port) if Path(port).exists() else UsbPort(port)
    if found.vid_is_known and found.serial_number is None:
        yield (
            f"the USB adapter at {port} has no serial number of its own: rig takes whatever board is plugged in there "
            "for this bench's; with two such boards, name the USB socket: a link of /dev/serial/by-path as daq.port"
        )
    elif found.serial_number is not None or is_usb_name(port):
        yield (
            f"daq.usb_serial is not given: rig takes whatever board is at {port} for this bench's; `rig calibrate` "
            "puts the number in"
        )


def host_clock(d: DeviceSetup) -> MonotonicClock:
    """The clock of this machine, with the config's way of waiting."""
    return MonotonicClock(1e-6 * d.spin_us)


def emulated_of(d: DeviceSetup) -> Emulated:
    """Section ``emulated``. Raises ValueError without it."""
    if d.emulated is None:
        raise ValueError("the config has no section `emulated`")
    return d.emulated


def truth_of(d: DeviceSetup) -> BenchParameters | None:
    """The bench of section ``emulated``; None without that section."""
    if d.emulated is None:
        return None
    from rig.backends.emulated.bench_of_config import bench_parameters

    return bench_parameters(d.emulated, d.tachometer)
