"""What an experiment will do, in lines for people: backend, stages, limits, link, failsafe; and what to know of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from math import isclose
from typing import NamedTuple

from rig.backends.registry import backend_of
from rig.config.problems import bracketed
from rig.config.schema import DeadBand, DeviceSetup, Experiment
from rig.control.law import OWN
from rig.control.sweep_plan import TooShortError
from rig.core.motor_numbers import RealMotor
from rig.core.signals import percent
from rig.running.preflight import room_to_stop as stopping
from rig.running.preflight.breakaway_strokes import FRICTION_DIFFERS, breakaway_strokes

_SLACK = 1e-6  # relative: numbers closer than this are equal but for their digits
_BENT_COUNTS = 1.0  # largest distance of a calibration table from a straight line that is left unsaid
_SCALED = "K and f_c will come out scaled"


def differences(d: DeviceSetup) -> Iterator[str]:
    """A sentence for each difference between the emulated bench and the config; none for a real motor."""
    if d.emulated is None or not backend_of(d).is_emulated(d):
        return
    yield from _bridge(d)
    yield from _sensor(d)
    if d.tachometer is not None and d.emulated.tachometer is False:
        yield "the emulated bench has no velocity channel (emulated.tachometer); the config has a section tachometer"
    parts = d.emulated.motor.parts
    given = [] if parts is None else [(name, value) for name, value in parts if name in RealMotor._fields and value]
    if given:
        yield (
            f"the emulated motor has parts that tau, K and f_c leave out (emulated.motor.parts: "
            f"{', '.join(f'{name} {value:g}' for name, value in given)}): estimates without these laws may be off"
        )
    stops, hard = d.emulated.motor.stop_rad, d.limits.hard_rad
    if not d.limits.is_endless and not (stops[0] <= hard[0] and hard[1] <= stops[1]):
        yield (
            f"the emulated shaft meets its mechanical stops at {bracketed(stops)} rad, inside limits.hard_rad "
            f"{bracketed(hard)}: its motion there is not free"
        )


def _bridge(d: DeviceSetup) -> Iterator[str]:
    emulated, drive = d.emulated, d.drive
    if emulated is None or emulated.supply_V is None or emulated.bridge_drop_V is None:
        return
    full_V, config_V = emulated.supply_V - emulated.bridge_drop_V, drive.supply_V - drive.bridge_drop_V
    if not isclose(full_V, config_V, rel_tol=_SLACK):
        yield f"the emulated bridge gives {full_V:g} V, by the config it gives {config_V:g} V: {_SCALED}"
    if emulated.dead_band_duty != drive.dead_band_duty:
        yield (
            f"the emulated bridge passes nothing below {_shares(emulated.dead_band_duty)}, drive.dead_band_duty says "
            f"{_shares(drive.dead_band_duty)}: the true drive differs from the recorded one, and {_SCALED}"
        )
    if emulated.reversed != drive.reversed:
        yield "the emulated bridge turns the shaft the opposite way to drive.reversed"


def _sensor(d: DeviceSetup) -> Iterator[str]:
    if d.emulated is None:
        return
    true, (rad_per_count, centre_counts) = d.emulated.potentiometer, d.sensor.straight
    if true.rad_per_count is None or true.centre_counts is None:
        return
    if not isclose(true.rad_per_count, rad_per_count, rel_tol=_SLACK):
        yield (
            f"one count of the emulated potentiometer is {true.rad_per_count:.6g} rad, sensor.calibration says "
            f"{rad_per_count:.6g} rad: every position and K will come out {rad_per_count / true.rad_per_count:.4g} "
            "times the true one"
        )
    if not isclose(true.centre_counts, centre_counts, rel_tol=_SLACK):
        yield (
            f"the emulated potentiometer reads {true.centre_counts:g} counts at position 0, sensor.calibration says "
            f"{centre_counts:g}: every position is off by {abs(true.centre_counts - centre_counts):.3g} counts"
        )
    bent_counts = max(abs(centre_counts + rad / rad_per_count - counts) for counts, rad in d.sensor.points)
    if bent_counts > _BENT_COUNTS:
        yield (
            f"sensor.calibration is a table that bends by up to {bent_counts:.3g} counts, but the emulated "
            "potentiometer is straight: K will come out too large where the table is too steep, too small where it is "
            "too flat"
        )
    if d.sensor.encoder is None and true.counts_max != d.sensor.counts_max:
        yield (
            f"the emulated potentiometer reads 0 to {true.counts_max} counts, sensor.counts_max is "
            f"{d.sensor.counts_max}: describe it in emulated.potentiometer"
        )


def _shares(dead: DeadBand | None) -> str:
    return "" if dead is None else f"{dead.plus:.3g} and {dead.minus:.3g} of full duty"


_UNSEEN_COUNTS = 66  # of travel, until a board has seen that one channel of an encoder is loose: docs/encoder.md


def plan(e: Experiment) -> Iterator[str]:
    """The lines, for an experiment whose keys are in range."""
    d = e.device
    backend = backend_of(d)
    yield f"backend: {backend.words(d)}, every {e.period_s * 1e3:g} ms"
    yield from _stage_lines(e)
    full_V = e.drive.supply_V - e.drive.bridge_drop_V
    yield (
        f"limits: {_travel_words(d)}; "
        f"{e.limits.max_speed_rad_s:g} rad/s; {e.drive.max_V:g} V of the {full_V:g} V that the bridge can give"
    )
    if e.sensor.encoder is not None and e.sensor.servo is None:
        yield f"encoder: one loose channel is seen after {_UNSEEN_COUNTS * abs(e.sensor.curve.lsb_rad):.2f} rad"
    if e.limits.is_endless:
        yield f"stopping {stopping.stopping_sum(d)}, wherever that is; a person must be able to reach the e-stop"
    else:
        yield f"stopping {stopping.stopping_sum(d)}; room from the centre of travel: {stopping.room_rad(d):.3f} rad"
    room_s = stopping.room_for_delay_s(e)
    if 0.0 < room_s < math.inf:
        yield (
            f"delay: a drive may show in the reading up to {1e3 * room_s:.0f} ms later than its own tick; "
            "the breakaway check looks"
        )
    if words := stopping.watchdog_words(e):
        yield words
    yield from backend.plan(d)
    yield backend.failsafe_words(d)
    for note in notes(d):
        yield f"note: {note}"


def _travel_words(d: DeviceSetup) -> str:
    if d.limits.is_endless:
        turns = d.limits.turns
        bound = "no travel limits" if turns is None else f"{turns:g} turns either way, no travel limits"
        return f"{bound}; zero is where a command finds the shaft"
    soft, hard = bracketed(d.limits.soft_rad), bracketed(d.limits.hard_rad)
    if d.sensor.servo is not None:
        return f"soft {soft} rad, hard {hard} rad, from {d.sensor.servo.zero_counts} counts of the servo"
    if d.sensor.encoder is not None:
        return f"soft {soft} rad, hard {hard} rad, from the zero that `rig home` sets"
    return f"soft {soft} rad, hard {hard} rad, sensor {bracketed(d.sensor.range_rad)} rad"


def notes(d: DeviceSetup) -> Iterator[str]:
    """What you must know to read the results. `rig check` says it before a run, the run with its results."""
    backend = backend_of(d)
    yield from differences(d)
    yield from backend.notes(d)
    low, high = d.limits.soft_rad
    counts_from_start = d.limits.is_endless  # zero is where the command finds the shaft
    if d.emulated is not None and not counts_from_start and not low <= d.emulated.motor.start_rad <= high:
        yield "the emulated shaft starts outside the soft limits: bring it inside with `rig jog`, else a run refuses"
    if d.emulated is not None and not backend.is_emulated(d):
        yield backend.not_emulated_words(d)


def _check_ends_by(watchdog_s: float, d: DeviceSetup) -> str:
    """The worst case for which the bound on unseen travel holds, in words."""
    time = f"{1e3 * watchdog_s:.3g} ms"
    watchdog = backend_of(d).watchdog(d)
    if watchdog.time_s is None or (not watchdog.certain and d.daq.accept_no_watchdog):
        return f"even if a tick comes {time} late; but if the host dies nothing bounds it: the device has no watchdog"
    if watchdog.unit_s is None:
        return f"even if the host dies in a stroke: the device's own watchdog ends it after {time}"
    return f"even if the host dies in a stroke: in this check the device's watchdog ends it after {time}"


class _Stage(NamedTuple):
    """The lines of a stage, and its longest time, s, as far as it is known."""

    lines: Sequence[str]
    longest_s: float = 0.0


def _stage_lines(e: Experiment) -> Iterator[str]:
    """The stages with the longest times to expect."""
    if e.law is not None:
        yield from _breakaway(e).lines
        yield (
            f"stage law: {e.law.name}{'' if e.law.name in OWN else ', a law of your own'}, for at most "
            f"{e.law.duration_s:g} s, within the limits; "
            "no relay test, nothing is identified"
        )
        return
    for stage in _stages(e):
        yield from stage.lines
    unknown = "" if _relay_tests_are_bounded(e) else ", and the relay tests"
    clock = " of virtual time" if backend_of(e.device).in_virtual_time(e.device) else ""
    total_s = sum(stage.longest_s for stage in _stages(e))
    yield f"together at most about {total_s:.0f} s{clock}{unknown}, plus settling and rests"


def _stages(e: Experiment) -> tuple[_Stage, ...]:
    return (_breakaway(e), _relay_tests(e), _hysteretic_runs(e), _IDENTIFY, _survey(e), _verify(e))


def _relay_tests_are_bounded(e: Experiment) -> bool:
    return (e.relay.target is not None or e.relay.until is not None) and e.relay.hysteretic is None


def lasts_s(e: Experiment) -> float | None:
    """About how long a run drives at most, s, without settling and rests; None if nothing bounds its tests."""
    if e.law is not None:
        return _breakaway(e).longest_s + e.law.duration_s
    return sum(stage.longest_s for stage in _stages(e)) if _relay_tests_are_bounded(e) else None


def _breakaway(e: Experiment) -> _Stage:
    b = e.breakaway
    longest_s = 2.0 * b.rest_s + 2.0 * b.max_V / b.ramp_V_s
    strokes = None if e.motor is None else breakaway_strokes(e)
    if strokes is None:
        return _Stage((), longest_s)
    longest_s = 2.0 * b.rest_s + strokes.longest_s(b.max_V)
    longest, shortest = (1e3 * f(strokes.strokes_s) for f in (max, min))
    lengths = f"{longest:.3g} ms" if longest == shortest else f"{longest:.3g} ms at first and {shortest:.3g} ms at last"
    lines = (
        f"stage breakaway: strokes to and fro, {lengths}, each {1e3 * strokes.step_V:.3g} mV stronger than the one "
        f"before, up to {b.max_V:g} V; at most about {longest_s:.0f} s",
        f"stage breakaway, with a stuck or uncoupled sensor: the shaft turns at most {strokes.unseen_rad:.2f} rad, "
        "if motor.no_load_speed_rad_s is true and friction each way is within "
        f"{percent(FRICTION_DIFFERS)} of the mean of both ways. That holds "
        f"{_check_ends_by(strokes.watchdog_s, e.device)}",
    )
    return _Stage(lines, longest_s)


def _relay_tests(e: Experiment) -> _Stage:
    """The search for the target's gains and the tests with them, or the tests with the given gains."""
    r = e.relay
    if r.until is not None:
        u = r.until
        lines = (
            "stage search: a relay whose gains grow from the breakaway level, within "
            f"{stopping.swing_rad(e.device):.3g} rad and {e.limits.max_speed_rad_s:g} rad/s; with `--model` it is left "
            "out",
            "stages relay, strokes: the tests that tell most, by simulation on the estimate so far; they end when tau, "
            f"K and f_c are known to {u.interval_percent:g} %, after {u.longest_s:g} s at the latest, or "
            f"{u.most_cycles} swings",
        )
        return _Stage(lines, u.longest_s)
    if r.target is not None:
        amplitudes = r.target.amplitude_rad, r.target.amplitude_rad * r.second_ratio
        tests_s = 2.0 * r.cycles * r.target.period_s
        speed = stopping.peak_speed_rad_s(max(amplitudes), r.target.period_s)
        lines = (
            f"stage search: searches gains for {amplitudes[0]:.3g} rad every {r.target.period_s:g} s, "
            f"+-{percent(r.target.tolerance)}, and for {amplitudes[1]:.3g} rad; at most {r.search.timeout_s:g} s each",
            f"stage relay: {r.cycles} settled cycles with each, up to about {speed:.2g} rad/s; about {tests_s:.0f} s "
            "and the settling",
        )
        return _Stage(lines, 2.0 * r.search.timeout_s + tests_s)
    if r.gains is not None:
        pairs = ", ".join(f"({g.h1_V:g}, {g.h2_V:g})" for g in r.gains)
        return _Stage(
            (f"stage relay: {r.cycles} settled cycles at each of (h1, h2) = {pairs} V; their period is not known yet",)
        )
    return _Stage(())


def _hysteretic_runs(e: Experiment) -> _Stage:
    d = e.device
    if e.relay.hysteretic is None:
        return _Stage(())
    pairs = ", ".join(f"({h.d_V:+g}, {h.eps_rad:g})" for h in e.relay.hysteretic)
    widest_rad = max(h.eps_rad for h in e.relay.hysteretic)
    overshoot = sum(rad for _, rad in stopping.overshoot_terms(d))
    horizon_s = sum(rad for _, rad in stopping.stopping_terms(d)) / e.limits.max_speed_rad_s
    line = (
        f"stage hysteretic: each run starts from rest at zero, (d, eps) = {pairs} V, rad; "
        f"at most to {widest_rad + overshoot:.3g} rad; the guard would brake above "
        f"{(stopping.room_rad(d) - widest_rad) / horizon_s:.3g} rad/s; every d must exceed the breakaway level, which "
        "the breakaway stage measures"
    )
    return _Stage((line,))


def _survey(e: Experiment) -> _Stage:
    """The sweeps of a thorough run, or of `rig survey` where the config has a section for it."""
    if not e.relay.has_tests:
        return _Stage(())
    if e.identify.thorough:
        begin = "stage survey, if the relay tests leave the motor's law open: a relay test of a third amplitude, then"
    elif "survey" in e.model_fields_set:
        begin = "stage survey, with `rig survey` alone:"
    else:
        return _Stage(())
    try:
        plan = stopping.expected_sweeps(e)
    except TooShortError as error:
        return _Stage((f"stage survey: left out, since {error}",))
    speeds = ", ".join(f"{v:.2g}" for v in plan.speeds_rad_s)
    line = (
        f"{begin} sweeps from {plan.low_rad:.3g} to {plan.high_rad:.3g} rad and back, at about {speeds} rad/s "
        f"(faster ones if the sensor is noisy); at most about {e.survey.longest_s:g} s"
    )
    return _Stage((line,), e.survey.longest_s if e.identify.thorough else 0.0)


_IDENTIFY = _Stage(("stage identify: every method, no motion",))


def _verify(e: Experiment) -> _Stage:
    if e.tracking is None:
        return _Stage(("stage verify: left out, since the config has no section `tracking`",))
    longest_s = len(e.tracking.methods) * e.tracking.duration_s
    line = (
        f"stage verify: tracking with the models of {', '.join(e.tracking.methods)}"
        + ("" if e.relay.until is None else ", as far as the tests give each")
        + f"; {e.tracking.duration_s:g} s each, {'' if e.relay.until is None else 'at most '}{longest_s:.0f} s"
    )
    return _Stage((line,), longest_s)
