"""meta.json: what rig knows of a run before its first row."""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal

from pydantic import Field, JsonValue

from rig.core.signals import Order
from rig.run_folder.results.part import VERSION, Count, Flag, Number, Part, Real, Sometimes, Text, key

REHEARSAL: Final = "rehearsal: this motor was made up from a data sheet, nothing was measured"


class DeviceSeen(Part):
    """The device as it introduced itself."""

    board: Text = key("kind of board or device", "")
    build: Text = key("the name that its firmware gives", "")
    reset_cause: Text = key("why it last started", "")
    clock_ratio: Annotated[float, Field(strict=True, gt=0.0)] = key(
        "seconds of the device's clock in a second of the host's", 1.0
    )
    supply_V: Sometimes[Number] = key("motor supply as the device measures it, V")
    supply_at_least: Sometimes[Flag] = key("true: the supply is above what the device can measure")


class SupplyBelieved(Part):
    """The motor supply that the config gives."""

    supply_V: Number = key("supply of the bridge, V")
    bridge_drop_V: Number = key("voltage drop in the bridge, V")
    supply_error_percent: Sometimes[Number] = key("largest error of supply_V, %")

    @property
    def full_V(self) -> float:
        """What the motor gets at full drive, V; inf: not known."""
        supply_V, drop_V = self.supply_V, self.bridge_drop_V or 0.0
        return math.inf if supply_V is None or not 0.0 <= drop_V < supply_V else supply_V - drop_V


class SensorBelieved(Part):
    """What the config says of the sensor's errors."""

    linearity_percent: Number = key("largest departure from a straight line, % of the full range")
    full_range_rad: Number = key("that range, rad")
    calibration_error_rad: Number = key("largest error of each angle of the calibration, rad")
    calibration_rad: tuple[Real, ...] = key("those angles, rad, rising", ())


class ScriptCall(Part):
    """The script that ran, with its arguments, so that it can be replayed."""

    name: Text = Field(description="run, relay, survey, breakaway, track, jog or law")
    breakaway: Sometimes[Text] = key("law of the breakaway check; older versions write none")
    search: Sometimes[Text] = key("law of a gain search; older versions write none")
    u_V: Sometimes[Number] = key("drive of a jog, V")
    duration_s: Sometimes[Number] = key("duration of a jog or of a user's law, s")
    leased: Sometimes[Flag] = key("whether a jog was driven by leases; `duration_s` is its longest time")
    law: Sometimes[Text] = key("the user's law that ran: its name in the config, or its class")


class RealTimeReport(Part):
    """What the machine granted the loop, and what it refused: a sentence for each."""

    granted: tuple[Text, ...] = key("each measure that it granted", ())
    refused: tuple[Text, ...] = key("each measure that it refused, and what helps", ())


class RunTime(Part):
    """In which time the loop ran."""

    kind: Literal["real", "virtual"] = Field(description="real, or virtual: it passes only while the loop waits")
    pace: Sometimes[Number] = key("of virtual time, its seconds in a second; null: as fast as the machine")
    stalls: Sometimes[Count] = key(
        "of a paced time: how often the machine, or rig's own sums, kept it waiting; at the run's end"
    )
    longest_stall_s: Sometimes[Number] = key("the longest of them, s")


class TrueLaw(Part):
    """What the emulated motor has beyond tau, K and Coulomb friction, named and measured as a law that is found."""

    name: Text = Field(description="dead_band, gain_by_sign, sag, lag, ... (docs/theory.md 12.1)")
    value: Number = key("its size: its number, or the root sum of squares of its numbers")
    unit: Text = key("of the value; 1: none", "")
    numbers: dict[str, Number] = key("all its numbers, with the unit in the name", {})


class TrueMotor(Part):
    """The emulated motor's parameters, as an estimate names them."""

    tau_s: Real = Field(description="time constant that the motion shows, s")
    K_rad_s_V: Real = Field(description="velocity gain that the motion shows, (rad/s)/V")
    fc_V: Real = Field(description="Coulomb friction, V")
    asym_V: Number = key("asymmetry of the effective drive, V")
    static_plus_V: Number = key("drive at break-away towards rising positions, V")
    static_minus_V: Number = key("drive at break-away towards falling positions, V")
    stribeck_rad_s: Sometimes[Number] = key("Stribeck velocity, rad/s")
    viscous_V_s_rad: Sometimes[Number] = key("viscous friction, V s/rad")
    tau_without_viscous_s: Sometimes[Number] = key("time constant without viscous friction, s")
    K_without_viscous_rad_s_V: Sometimes[Number] = key("gain without viscous friction, (rad/s)/V")

    law: Sometimes[tuple[TrueLaw, ...]] = key("what it has beyond tau, K and Coulomb friction; []: nothing")

    def value(self, name: str) -> float | None:
        """One parameter by its name in an estimate; None if the motor has none of that name."""
        found = getattr(self, name) if name in type(self).model_fields else None
        return found if isinstance(found, float) else None


class RunMeta(Part):
    """meta.json of a run folder. A file of an older version may lack any key."""

    version: Annotated[Count, Field(ge=0)] = Field(VERSION, alias="schema", description="version of this file's form")
    name: Text = key("the config's name", "")
    backend: Text = key("the bench in words", "")
    emulated: Flag = key("whether nothing real moves", False)
    order: Order | None = key("order of a tick: docs/architecture.md, One tick")
    period_s: Number = key("period of the loop, s")
    drive_units: Annotated[Count, Field(gt=0)] | None = key(
        "steps of the drive at full duty; null: the drive has no steps"
    )
    times_error_s: Number = key("largest error of t_u_s against t_s, s")
    times_shift_s: Sometimes[float] = key(
        "by how much all of t_u_s may be off against t_s, s: of a device whose times rig reckons from its exchanges"
    )
    firmware: DeviceSeen | None = key("the device as it introduced itself")
    drive: SupplyBelieved | None = key("the motor supply by the config")
    sensor: Sometimes[SensorBelieved] = key("the sensor's errors by the config")
    failsafe: Text = key("what stops the drive if the host is silent", "")
    started_utc: Text | None = key("when the run started: ISO 8601, UTC")
    versions: dict[str, JsonValue] = key("of rig and Python", {})
    host: dict[str, JsonValue] = key("the machine", {})
    command: Text | None = key("the command line")
    truth: TrueMotor | None = key("the emulated motor; null: the motor is real")
    rehearsal: Sometimes[Flag] = key(
        "true: `rig rehearse` ran it, on a motor made up from a data sheet; nothing was measured"
    )
    time: Sometimes[RunTime] = key("in which time the loop ran; older versions write none")
    script: ScriptCall | None = key("what ran")
    real_time: Sometimes[RealTimeReport] = key("written once the loop has asked the machine")
    identify_without: Sometimes[tuple[Text, ...]] = key("stages that identification does not read, by the config")
