"""Drivers as another package would offer them, for tests."""

from __future__ import annotations

from typing import Any

from simulated_bench import CALIBRATION, DEMO, RAILS

from rig.backends.clock import VirtualClock
from rig.backends.driver import DeviceInfo, DriverSettings
from rig.backends.simulated.driver import SimulatedDriver, SimulatedLatency
from rig.core.calibration import DriveMap, Scaling
from rig.core.faults import Fault
from rig.core.signals import Order, Sample


def settings(**options: Any) -> DriverSettings:
    """What a driver is constructed with for a bench like the demo's."""
    return DriverSettings(options, CALIBRATION, DriveMap(12.0), RAILS, 1023, 0.03, 0.01, 0.1)


class VirtualCard(SimulatedDriver):
    """A card in virtual time with the demo's motor behind it."""

    acts: Order = "sample_first"

    def __init__(self, settings: DriverSettings) -> None:
        unknown = set(settings.options) - {"seed"}
        if unknown:
            raise ValueError(f"unknown: {', '.join(sorted(unknown))}; known: seed")
        self.clock = VirtualClock()
        self.period_s = settings.period_s
        super().__init__(
            self.clock,
            DEMO,
            Scaling(settings.calibration, settings.drive_map, settings.rail_counts),
            SimulatedLatency(0.0012, 0.0003),
            settings.options.get("seed", 1),
            order=self.acts,
        )
        self.backend = "virtual card"
        self.dead = False  # the link, once a test has cut it

    def read(self) -> Sample:
        if self.dead:
            raise Fault("LINK_LOST", "the plug was pulled")
        return super().read()

    def safe_stop(self) -> bool:
        return super().safe_stop() and not self.dead


class WriteFirstCard(VirtualCard):
    """What a tick decides goes out with the next one's exchange."""

    acts: Order = "write_first"


class BareCard:
    """Has what a driver must have, and does nothing."""

    order = "sample_first"
    failsafe = None
    backend = "bare"
    link_statistics: dict[str, int] = {}  # noqa: RUF012

    def __init__(self, settings: DriverSettings) -> None:
        if settings.options.get("channel", 0) > 7:
            raise ValueError(f"channel {settings.options['channel']}: this card has 0 to 7")
        if "mode" in settings.options:
            settings.options["range"]

    def open(self) -> DeviceInfo:
        return DeviceInfo(build="1", board="bare", reset_cause="not told", emulated=False)

    def arm(self, limits: object) -> None: ...

    def read(self) -> None: ...

    def write(self, u_V: float) -> None: ...

    def safe_stop(self) -> bool:
        return True

    def close(self) -> None: ...


class WriteTakesNothing(BareCard):
    """A method with too few arguments."""

    def write(self) -> None: ...  # type: ignore[override]  # the defect


class ReadTakesMore(BareCard):
    """A method with too many arguments."""

    def read(self, channel: int) -> None: ...  # type: ignore[override]  # the defect
