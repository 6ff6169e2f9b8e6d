"""result.json: the result of a run."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from rig.run_folder.results.estimates import BreakawayResult, FrictionMapResult, HystereticResult, RelayTestResult
from rig.run_folder.results.identification import Answered, MotorLawResult, OlderKeys
from rig.run_folder.results.live import StoppedResult
from rig.run_folder.results.meta import RealTimeReport, TrueMotor
from rig.run_folder.results.part import NOT_IN_EACH_FILE, VERSION, Count, Flag, Number, Part, Sometimes, Text
from rig.run_folder.results.tuned import TunedResult


class FaultReport(Part):
    """The fault that ended the run."""

    code: Text = Field("unknown", description="a code of rig/core/faults.py")
    cause: Text = Field("", description="what it means")
    cure: Text = Field("", description="what to do")
    detail: Text = Field("", description="what was seen")
    t_s: Sometimes[Number] = Field(None, description="when, s since the run's start; only in an event")


NO_ESTIMATE = "no estimate"  # why a check did not run: the tests are not for its method, and no more is to be said


class TrackingResult(Part):
    """A tracking check: its errors, or why there are none."""

    rms_rad: Annotated[Number, NOT_IN_EACH_FILE] = Field(None, description="RMS error, rad")
    max_rad: Annotated[Number, NOT_IN_EACH_FILE] = Field(None, description="largest error, rad")
    true_rms_rad: Sometimes[Number] = Field(
        None, description="RMS error of the emulated shaft, without the sensor's noise, rad; a real shaft has none"
    )
    true_max_rad: Sometimes[Number] = Field(None, description="largest error of the emulated shaft, rad")
    law: Sometimes[tuple[Text, ...]] = Field(None, description="laws of the motor that the drive made up for")
    law_left_out: Sometimes[tuple[Text, ...]] = Field(
        None, description="laws that were found, and that no drive makes up for"
    )
    not_run: Sometimes[Text] = Field(None, description="why there is no error")


class Quantiles(Part):
    """Quantiles of the times that one part of a tick took, us; null if no tick ran."""

    p50: Number = Field(None, description="median")
    p99: Number = Field(None, description="99 %")
    p999: Number = Field(None, description="99.9 %")
    max: Number = Field(None, description="the largest of all")


class DeviceLoop(Part):
    """The ticks of a relay in the device."""

    period_s: Number = Field(None, description="its period, s")
    ticks: Count = Field(0, description="ticks that were recorded")
    missed: Count = Field(0, description="ticks that it missed")


class LoopResult(Part):
    """Timing of the loop."""

    period_s: Number = Field(None, description="its period, s")
    ticks: Count | None = Field(None, description="ticks that ran")
    skipped: Count | None = Field(None, description="ticks that the loop skipped because an earlier one took too long")
    late_us: Quantiles | None = Field(None, description="how late ticks began")
    io_us: Quantiles | None = Field(None, description="reading the device")
    compute_us: Quantiles | None = Field(None, description="law and guard")
    write_us: Quantiles | None = Field(None, description="writing the drive")
    record_us: Quantiles | None = Field(None, description="handing a row to the recorder")
    device: Sometimes[DeviceLoop] = Field(None, description="the relay in the device, if one ran")
    real_time: Sometimes[RealTimeReport] = Field(None, description="what the machine granted the loop")


class JogResult(Part):
    """What `rig jog` did."""

    from_rad: Number = Field(None, description="position before, rad")
    to_rad: Number = Field(None, description="position after, rad")
    refused_ticks: Count = Field(0, description="ticks in which the guard cut the drive")


class SearchStepResult(Part):
    """A pair of gains that the search tried."""

    t_s: Number = Field(None, description="when, s since the run's start")
    h1_V: Number = Field(None, description="gain of the relay on position, V")
    h2_V: Number = Field(None, description="gain of the relay on the integral, V")
    period_s: Number = Field(None, description="period of the settled cycle, s; null: none settled")
    amplitude_rad: Number = Field(None, description="amplitude of the settled cycle, rad; null: none settled")
    outcome: Text = Field("", description="what happened, in words")


class _Head(Part):
    """What ran."""

    version: Annotated[Count, Field(ge=0)] = Field(VERSION, alias="schema", description="version of this file's form")
    backend: Text = Field("", description="the bench in words")
    rehearsal: Sometimes[Flag] = Field(
        None, description="true: `rig rehearse` ran it, on a motor made up from a data sheet; nothing was measured"
    )


class _Run(Part):
    """What came of it."""

    relays: tuple[RelayTestResult, ...] = Field((), description="relay tests that were used")
    tracking: dict[str, TrackingResult] = Field({}, description="tracking checks by the method of their model")
    loop: LoopResult | None = Field(None, description="timing of the loop")
    link: dict[str, Count] = Field({}, description="number of exchanges with the device, and of each kind of error")
    faults: tuple[FaultReport, ...] = Field((), description="the fault that ended the run; empty: none did")
    config_notes: tuple[Text, ...] = Field((), description="what `rig check` notes of the config")
    notes: tuple[Text, ...] = Field((), description="what else there is to know, in words")
    hysteretic: Sometimes[tuple[HystereticResult, ...]] = Field(None, description="runs of hysteretic relays")
    models_from: Sometimes[Text] = Field(None, description="another run whose models drove this one")
    breakaway: Sometimes[BreakawayResult] = Field(None, description="the breakaway check, and static friction")
    friction_map: Sometimes[FrictionMapResult] = Field(None, description="the drive over speed and over position")
    jog: Sometimes[JogResult] = Field(None, description="what `rig jog` did")
    search: Sometimes[tuple[SearchStepResult, ...]] = Field(None, description="the gain search, step by step")
    stopped: Sometimes[StoppedResult] = Field(None, description="why the tests of `relay.until` ended, and when")
    tuned: Sometimes[TunedResult] = Field(None, description="the loop that `rig tune --try` drove, and its prediction")
    truth: Sometimes[TrueMotor] = Field(None, description="the emulated motor")


class RunResult(OlderKeys, MotorLawResult, _Run, Answered, _Head):
    """result.json of a run folder. A file of an older version may lack any key."""

    # Its parts are read from right to left: the file keeps that order of keys.
