"""The one interface of a kind of device: what a config says of it, what keeps it from running, and how it opens.

The built-in ones and those of other packages are alike; ``rig.backends.registry`` finds them. A driver
(``rig.backends.driver``) is one device that is open, or about to be; a backend knows the device from its config alone.
``e`` is the experiment throughout.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple, TypeVar

from rig.backends.clock import MonotonicClock
from rig.backends.driver import Clock, Driver, Transport
from rig.backends.link_budget import LinkBudget
from rig.backends.section import Section
from rig.config.problems import Problem
from rig.config.schema import Experiment

if TYPE_CHECKING:  # these load slowly
    from rig.backends.emulated.board_process import BoardProcess
    from rig.backends.links.usb_adapters import Adapter
    from rig.model.bench import BenchParameters

OwnSection = TypeVar("OwnSection", bound=Section)


class Watchdog(NamedTuple):
    """What sets 0 V when the host is silent, as far as the config tells.

    time_s    silence after which it does, s; None: nothing does
    unit_s    arming sets the time, in whole units of this, s; None: it was set on the device itself
    certain   False: only the device can say whether it has one
    """

    time_s: float | None
    unit_s: float | None = 0.001
    certain: bool = True


class Line(NamedTuple):
    """What a driver speaks over.

    transport   open
    clock       that its times are in
    name        of the port, for people
    emulated    True where it is known that no real motor is behind it
    """

    transport: Transport
    clock: Clock
    name: str
    emulated: bool = False


class Unopened(NamedTuple):
    """A driver before ``open``, its clock, and the bench described under ``emulated``, if there is one."""

    driver: Driver
    clock: Clock
    truth: BenchParameters | None


class Backend(ABC):
    """One kind of device. Constructing it, and asking it anything but ``unopened`` and ``emulated``, touches no device.

    name           as ``daq.driver`` has it
    section        what ``daq.options`` must be; None: the config's own keys are all there is, or a driver checks them
    has_chip       whether `rig emulate --chip` means something to it

    What has a default fits a device of which nothing more is known.
    """

    name: ClassVar[str] = ""
    section: ClassVar[type[Section] | None] = None
    has_chip: ClassVar[bool] = True

    # ------------------------------------------------------------------ what may be run

    def rules(self, e: Experiment) -> Iterator[Problem]:
        """Why this experiment must not be run on this device, with the keys; nothing where it may.

        ``section`` holds already, where there is one.
        """
        yield from ()

    def watchdog(self, e: Experiment) -> Watchdog:
        """What sets 0 V when the host is silent."""
        return Watchdog(e.daq.watchdog_s, certain=False)

    def writes_first(self, e: Experiment) -> bool:
        """Whether what a tick decides goes out with the next one: the slower of the two, where it is not known."""
        return True

    def budget(self, e: Experiment) -> LinkBudget:
        """What one tick needs of the link; without terms where that is not known."""
        return LinkBudget()

    def reading_budget(self, e: Experiment) -> LinkBudget:
        """What one reading needs of a device that is not armed; without terms where that is not known."""
        return LinkBudget()

    def reply_delay_s(self, e: Experiment) -> float:
        """By how much what sits between host and line makes each reply later, at most, s."""
        return 0.0

    def times_error_s(self, e: Experiment) -> float:
        """By how much the recorded time of a drive may be wrong against that of a sample, s."""
        return 1e-4

    # ------------------------------------------------------------------ what is said of it

    @abstractmethod
    def words(self, e: Experiment) -> str:
        """What is there, and whether a real motor may turn, for people."""

    def is_emulated(self, e: Experiment) -> bool:
        """Whether the bench is the one of section ``emulated``, so that nothing moves."""
        return False

    def plan(self, e: Experiment) -> Iterator[str]:
        """What `rig check` says of link and device, a line each."""
        yield from ()

    def failsafe_words(self, e: Experiment) -> str:
        """What stops the drive when the host is silent, for people."""
        return (
            f"failsafe: the device sets 0 V after {e.daq.watchdog_s * 1e3:g} ms of silence "
            f"({e.daq.watchdog_s / e.period_s:.3g} periods), latched until it is armed again"
        )

    def notes(self, e: Experiment) -> Iterator[str]:
        """What a person has to know who reads the results."""
        yield from ()

    def not_emulated_words(self, e: Experiment) -> str:
        """What section ``emulated`` is for where this device is not the one that it describes, for people."""
        return "section `emulated` counts as the truth only if the driver says that its device is emulated"

    def seconds_words(self, e: Experiment) -> str:
        """What is said after seconds of a run that are none of ours; "" where they are."""
        return ""

    def adapter_behind(self, e: Experiment) -> Adapter | None:
        """What the delays of a real USB port are reckoned with; None where the device has no such port."""
        return None

    # ------------------------------------------------------------------ the device

    @abstractmethod
    def unopened(self, e: Experiment) -> AbstractContextManager[Unopened]:
        """The driver, not opened as a device yet; what an emulated one needs lives for the block.

        Raises Fault LINK_OPEN where there is no port, EmulationError where a device cannot be emulated.
        """

    def emulated(
        self, e: Experiment, link: Path | None = None, trace: Path | None = None, *, chip: bool = False
    ) -> AbstractContextManager[BoardProcess] | None:
        """The device of section ``emulated``, running in real time for the block; None: there is none of this kind.

        link   symbolic link to its port;  trace  CSV file of the truth
        chip   the Uno's firmware on its emulated chip, wherever the config's port is
        """
        return None

    def emulated_hint(self, e: Experiment, port: str) -> str:
        """What to try on the emulated device that runs on ``port``, for people; "" for nothing."""
        return ""

    # ------------------------------------------------------------------ for those who write one

    def options(self, e: Experiment, section: type[OwnSection]) -> OwnSection:
        """``daq.options``, as ``section``. Raises pydantic's ValidationError."""
        return section.model_validate_json(json.dumps(e.daq.options or {}), strict=True)


class LineBackend(Backend):
    """A kind of device that a driver speaks to over a line: how the line is opened, and who speaks on it."""

    @abstractmethod
    def line(self, e: Experiment) -> AbstractContextManager[Line]:
        """The line of the config, open for whoever closes its transport; an emulated device lives for the block."""

    @abstractmethod
    def driver(self, e: Experiment, line: Line) -> Driver:
        """Who speaks on that line, not opened as a device yet."""

    @contextmanager
    def unopened(self, e: Experiment) -> Iterator[Unopened]:
        """As of ``Backend``, on the line of the config; or on that of a test (``rig.testing.line``)."""
        with own_line.opened(self, e) as line:
            yield Unopened(self.driver(e, line), line.clock, truth_of(e))


OpenLine = Callable[[LineBackend, Experiment], AbstractContextManager[Line]]


class _OwnLine:
    """The one place where a test puts a device of its own, instead of what the config names."""

    def __init__(self) -> None:
        self.instead: OpenLine | None = None

    def opened(self, backend: LineBackend, e: Experiment) -> AbstractContextManager[Line]:
        """The line to speak on."""
        return backend.line(e) if self.instead is None else self.instead(backend, e)


own_line = _OwnLine()


def host_clock(e: Experiment) -> MonotonicClock:
    """The clock of this machine, as the config has it wait."""
    return MonotonicClock(1e-6 * e.loop.spin_us)


def truth_of(e: Experiment) -> BenchParameters | None:
    """The bench described under ``emulated``, or None."""
    if e.emulated is None:
        return None
    from rig.backends.emulated.bench import bench_parameters

    return bench_parameters(e.emulated, e.tachometer)
