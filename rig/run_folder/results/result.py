"""result.json: the result of a run; and the JSON Schemas of it and of meta.json."""

from __future__ import annotations

import json
from typing import Annotated, Final

from pydantic import Field

from rig.run_folder.results.estimates import BreakawayResult, FrictionMapResult, HystereticResult, RelayTestResult
from rig.run_folder.results.event import StoppedResult
from rig.run_folder.results.identification import Answered, MotorLawResult, OlderKeys
from rig.run_folder.results.meta import RealTimeReport, RunMeta, TrueMotor
from rig.run_folder.results.part import NOT_IN_EACH_FILE, VERSION, Count, Flag, Number, Part, Sometimes, Text, key
from rig.run_folder.results.tuned import TunedResult


class FaultReport(Part):
    """The fault that ended the run."""

    code: Text = key("a code of rig/core/faults.py", "unknown")
    cause: Text = key("what it means", "")
    cure: Text = key("what to do", "")
    detail: Text = key("what was seen", "")
    t_s: Sometimes[Number] = key("when, s since the run's start; only in an event")


NO_ESTIMATE = "no estimate"  # why a check did not run: the tests are not for its method, and no more is to be said


class TrackingResult(Part):
    """A tracking check: its errors, or why there are none."""

    rms_rad: Annotated[Number, NOT_IN_EACH_FILE] = key("RMS error, rad")
    max_rad: Annotated[Number, NOT_IN_EACH_FILE] = key("largest error, rad")
    true_rms_rad: Sometimes[Number] = key(
        "RMS error of the emulated shaft, without the sensor's noise, rad; a real shaft has none"
    )
    true_max_rad: Sometimes[Number] = key("largest error of the emulated shaft, rad")
    law: Sometimes[tuple[Text, ...]] = key("laws of the motor that the drive made up for")
    law_left_out: Sometimes[tuple[Text, ...]] = key("laws that were found, and that no drive makes up for")
    not_run: Sometimes[Text] = key("why there is no error")


class Quantiles(Part):
    """Quantiles of the times that one part of a tick took, us; null if no tick ran."""

    p50: Number = key("median")
    p99: Number = key("99 %")
    p999: Number = key("99.9 %")
    max: Number = key("the largest of all")


class DeviceLoop(Part):
    """The ticks of a relay in the device."""

    period_s: Number = key("its period, s")
    ticks: Count = key("ticks that were recorded", 0)
    missed: Count = key("ticks that it missed", 0)


class LoopResult(Part):
    """Timing of the loop."""

    period_s: Number = key("its period, s")
    ticks: Count | None = key("ticks that ran")
    skipped: Count | None = key("ticks that the loop skipped because an earlier one took too long")
    late_us: Quantiles | None = key("how late ticks began")
    io_us: Quantiles | None = key("reading the device")
    compute_us: Quantiles | None = key("law and guard")
    write_us: Quantiles | None = key("writing the drive")
    record_us: Quantiles | None = key("handing a row to the recorder")
    device: Sometimes[DeviceLoop] = key("the relay in the device, if one ran")
    real_time: Sometimes[RealTimeReport] = key("what the machine granted the loop")


class JogResult(Part):
    """What `rig jog` did."""

    from_rad: Number = key("position before, rad")
    to_rad: Number = key("position after, rad")
    refused_ticks: Count = key("ticks in which the guard cut the drive", 0)


class SearchStepResult(Part):
    """A pair of gains that the search tried."""

    t_s: Number = key("when, s since the run's start")
    h1_V: Number = key("gain of the relay on position, V")
    h2_V: Number = key("gain of the relay on the integral, V")
    period_s: Number = key("period of the settled cycle, s; null: none settled")
    amplitude_rad: Number = key("amplitude of the settled cycle, rad; null: none settled")
    outcome: Text = key("what happened, in words", "")


class _Head(Part):
    """What ran."""

    version: Annotated[Count, Field(ge=0)] = Field(VERSION, alias="schema", description="version of this file's form")
    backend: Text = key("the bench in words", "")
    rehearsal: Sometimes[Flag] = key(
        "true: `rig rehearse` ran it, on a motor made up from a data sheet; nothing was measured"
    )


class _Run(Part):
    """What came of it."""

    relays: tuple[RelayTestResult, ...] = key("relay tests that were used", ())
    tracking: dict[str, TrackingResult] = key("tracking checks by the method of their model", {})
    loop: LoopResult | None = key("timing of the loop")
    link: dict[str, Count] = key("number of exchanges with the device, and of each kind of error", {})
    faults: tuple[FaultReport, ...] = key("the fault that ended the run; empty: none did", ())
    config_notes: tuple[Text, ...] = key("what `rig check` notes of the config", ())
    notes: tuple[Text, ...] = key("what else there is to know, in words", ())
    hysteretic: Sometimes[tuple[HystereticResult, ...]] = key("runs of hysteretic relays")
    models_from: Sometimes[Text] = key("another run whose models drove this one")
    breakaway: Sometimes[BreakawayResult] = key("the breakaway check, and static friction")
    friction_map: Sometimes[FrictionMapResult] = key("the drive over speed and over position")
    jog: Sometimes[JogResult] = key("what `rig jog` did")
    search: Sometimes[tuple[SearchStepResult, ...]] = key("the gain search, step by step")
    stopped: Sometimes[StoppedResult] = key("why the tests of `relay.until` ended, and when")
    tuned: Sometimes[TunedResult] = key("the loop that `rig tune --try` drove, and its prediction")
    truth: Sometimes[TrueMotor] = key("the emulated motor")


class RunResult(OlderKeys, MotorLawResult, _Run, Answered, _Head):
    """result.json of a run folder. A file of an older version may lack any key."""

    # Its parts are read from right to left: the file keeps that order of keys.


DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"


def schema_text(of: type[Part]) -> str:
    """JSON Schema (draft 2020-12) of a file of this version, as text; ``of``: RunMeta or RunResult."""
    titles = {RunMeta: "meta.json of a run of rig", RunResult: "result.json of a run of rig"}
    schema = {"$schema": DIALECT, **of.model_json_schema(), "title": titles.get(of, of.__name__)}
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"
