"""``driver: serial``: a device with rig's firmware, as a config describes it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from typing_extensions import override

from rig.backends.backend import Opening, PortBackend, Watchdog
from rig.backends.driver import RelayRules
from rig.backends.emulated.words import without_real_time
from rig.backends.link_budget import LinkBudget
from rig.backends.links.usb_adapters import CHIPS, Adapter
from rig.backends.serial import link_budget
from rig.backends.serial.flashing import FULL_DUTY, board_of
from rig.backends.serial.ports import EMULATED_PORTS, adapter_of
from rig.backends.serial.rules import serial_rules
from rig.backends.serial.section import SerialKeys
from rig.config.problems import Problem
from rig.config.schema import DeviceSetup
from rig.core.strict_json import JsonObject

if TYPE_CHECKING:  # it loads slowly
    from rig.core.calibration import DriveMap

_DRIVE_UNITS = 799  # of the firmware at full duty
_RESONATOR_PPM = 4000.0  # an Uno's ceramic resonator is good to half a percent


class SerialBackend(PortBackend):
    """A board with rig's firmware behind a serial port; or emulated, as firmware on this machine or on its chip."""

    name = "serial"
    own_keys = SerialKeys
    emulated_ports = EMULATED_PORTS
    port_example = "e.g. port: /dev/ttyACM0, or port: emulated"
    is_traced = True

    @override
    def rules(self, d: DeviceSetup) -> Iterator[Problem]:
        yield from super().rules(d)
        yield from serial_rules(d)

    @override
    def watchdog(self, d: DeviceSetup) -> Watchdog:
        """The firmware's watchdog, in milliseconds."""
        return Watchdog(d.daq.watchdog_s)

    @override
    def writes_first(self, d: DeviceSetup) -> bool:
        """A drive goes out at once."""
        return False

    @override
    def budget(self, d: DeviceSetup) -> LinkBudget:
        return link_budget.tick_budget(d)

    @override
    def reading_budget(self, d: DeviceSetup) -> LinkBudget:
        return link_budget.reading_budget(d)

    @override
    def reply_delay_s(self, d: DeviceSetup) -> float:
        """The delay of the USB adapter."""
        return link_budget.reply_delay_s(d)

    @override
    def times_error_s(self, d: DeviceSetup) -> float:
        """The device stamps both times itself."""
        return link_budget.STAMPS_S

    @override
    def words(self, d: DeviceSetup) -> str:
        emulated = {
            "emulated-chip": "the Uno's emulated chip with its firmware, {} baud, virtual time, nothing moves",
            "emulated-chip-realtime": "the Uno's emulated chip with its firmware, {} baud, real time, nothing moves",
            "emulated-pico": "the Pico's emulated chip with its firmware, {} baud, virtual time, nothing moves",
            "emulated-pico-realtime": "the Pico's emulated chip with its firmware, {} baud, real time, nothing moves",
            "emulated": "an emulated device, {} baud, virtual time, nothing moves",
            "emulated-realtime": "an emulated device behind a pseudo-terminal, {} baud, real time, nothing moves",
        }
        found = emulated.get(d.daq.port or "")
        if found is not None:
            return found.format(d.daq.baud)
        return f"a REAL MOTOR behind the serial port {d.daq.port}, {d.daq.baud} baud"

    @override
    def plan(self, d: DeviceSetup) -> Iterator[str]:
        yield f"link: {self.budget(d).beside(d.period_s)}"
        yield self.late_words(d)
        delay_ms = 1e3 * link_budget.sample_to_drive_s(d)
        yield f"delay of the link: a drive acts up to {delay_ms:.2f} ms after its sample, plus the host's own time"
        if d.runs_relay:
            block = link_budget.block_sum(d.daq.baud)
            if not d.runs_strokes:
                yield f"relay in the device: decides every ms; {block}; the gain search runs in the host"
                yield from _device_drives(d)
            else:
                yield f"relay and strokes in the device: decide every ms; {block}; the rest runs in the host"

    @override
    def notes(self, d: DeviceSetup) -> Iterator[str]:
        """Which USB adapter rig assumes, where it is not certain; and whether it can tell the board from another."""
        yield from super().notes(d)
        adapter = adapter_of(d)
        chip = CHIPS.get(adapter)
        if chip is not None and d.daq.adapter is None:
            yield (
                f"daq.adapter is not given; from the port's name rig assumes {chip.words} ({adapter}): "
                "`rig doctor` says which is there"
            )
        if chip is not None and chip.assumed:
            yield (
                f"no data sheet says how long {chip.words} waits; rig assumes {1e3 * chip.wait_s:g} ms: measure it "
                "with `rig doctor` on this config"
            )

    @override
    def adapter_behind(self, d: DeviceSetup) -> Adapter | None:
        return None if self.is_emulated(d) else adapter_of(d)

    @override
    def opening(self) -> Opening:
        from rig.backends.serial import opening

        return opening

    @override
    def rehearsed(self, d: DeviceSetup) -> dict[str, JsonObject]:
        """The firmware's core on this machine, with the board's steps of the drive, behind the same USB adapter."""
        if self.is_emulated(d):
            return {"daq": {"port": without_real_time(d.daq.port or "")}, "emulated": {}}
        return {
            "daq": {"port": "emulated", "usb_serial": None, "adapter": adapter_of(d)},
            "emulated": {"drive_counts": FULL_DUTY[board_of(d)], "clock_error_ppm": _RESONATOR_PPM},
        }

    @override
    def relay_rules(self, d: DeviceSetup, drive_map: DriveMap, clock_ratio: float) -> RelayRules:
        from rig.backends.serial.firmware_laws import FirmwareLawRules

        return FirmwareLawRules(d.sensor.curve, drive_map, clock_ratio)


def _device_drives(d: DeviceSetup) -> Iterator[str]:
    """The given gains in whole units of the drive."""
    full_V, dead = d.drive.supply_V - d.drive.bridge_drop_V, d.drive.dead_band_duty.plus
    for g in d.gains:
        outer, inner = (
            round(_DRIVE_UNITS * (dead + (1.0 - dead) * u_V / full_V))
            for u_V in (g.h1_V + g.h2_V, abs(g.h2_V - g.h1_V))
        )
        yield f"  at ({g.h1_V:g}, {g.h2_V:g}) V it drives +-{outer} and +-{inner} of {_DRIVE_UNITS} units"


SERIAL = SerialBackend()
