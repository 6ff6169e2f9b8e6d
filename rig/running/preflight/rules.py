"""Whether an experiment may run: arithmetic on the config; no device is touched.

Here are the rules about several keys together. The schema has the rules about one key, and each device its own. A rule
says nothing if another rule has already refused a key that it needs, so that one mistake gives one line.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from difflib import get_close_matches

from pydantic import ValidationError

from rig.backends.registry import backend_of
from rig.backends.registry import rules as device_rules
from rig.config.load import Given, load_with_places, read
from rig.config.messages import unplaced
from rig.config.problems import ConfigError, Path, Problem, bracketed, printable, wrong
from rig.config.schema import DeviceSetup, Experiment, RelayGainsSection
from rig.control.law import named_law, registered
from rig.control.sweep_plan import TooShortError
from rig.core.plug_ins import OptionError, PlugInError
from rig.core.signals import percent, plain
from rig.running.preflight import room_to_stop as stopping
from rig.running.preflight.attached import attached_rules
from rig.running.preflight.breakaway_strokes import UNSEEN_RAD, breakaway_strokes, has_strokes
from rig.running.preflight.plan import plan

Rule = Callable[[Experiment], Iterator[Problem]]


def _of_device(rule: Callable[[DeviceSetup], Iterator[Problem]]) -> Rule:
    """A rule that sees what the device sees."""
    return lambda e: rule(e.device)


_WATCHDOG_PERIODS = (3, 10)  # the least, and the most where that is longer than LONGEST_WATCHDOG_S
_SHORTEST_CYCLE_PERIODS = 30  # docs/theory.md 4.3: a shorter cycle is delay hunting
_SMALLEST_CYCLE_COUNTS = 20  # docs/theory.md 4.3
_FEWEST_PAIRS = 8  # of strokes in the breakaway check
_LARGEST_MOTION_RAD = 0.1
_MOTION_COUNTS = 3  # below this, noise of the last digit would look like motion
_SLACK = 1e-9  # relative: 0.1 s is ten periods of 0.01 s, whatever the binary fractions say


@dataclass(frozen=True)
class Preflight:
    """``lines``: what the experiment will do, for people; ``problems``: why it must not run, empty if it may."""

    lines: tuple[str, ...]
    problems: tuple[Problem, ...]


def preflight(experiment: Experiment) -> Preflight:
    """Check an experiment offline. The problems have paths but no places: ``check`` adds these."""
    if unread := tuple(_own_section(experiment.device)):
        return Preflight((), unread)  # the device's rules need this section
    problems = tuple(problem for rule in _RULES for problem in rule(experiment))
    return Preflight(tuple(plain(line) for line in plan(experiment)), problems)


# ---------------------------------------------------------------------- the device


def _own_section(d: DeviceSetup) -> Iterator[Problem]:
    """Problems of the device's own section, if it has one."""
    backend = backend_of(d)
    if backend.section is not None:
        try:
            backend.options(d, backend.section)
        except ValidationError as error:
            yield from unplaced(error.errors(include_url=False), backend.section, ("daq", "options"))


def _spin(d: DeviceSetup) -> Iterator[Problem]:
    if 1e-6 * d.spin_us > 0.5 * d.period_s * (1 + _SLACK):
        yield wrong(
            "loop.spin_us",
            f"{d.spin_us:g} us of spinning is more than half the period of {1e3 * d.period_s:g} ms",
            f"at most {0.5e6 * d.period_s:g}",
        )


def _watchdog(d: DeviceSetup) -> Iterator[Problem]:
    least_s, most_s = (n * d.period_s for n in _WATCHDOG_PERIODS)
    most_s = max(most_s, stopping.LONGEST_WATCHDOG_S)
    watchdog_s = d.daq.watchdog_s
    if not least_s * (1 - _SLACK) <= watchdog_s <= most_s * (1 + _SLACK):
        yield wrong(
            "daq.watchdog_s",
            f"must be {_WATCHDOG_PERIODS[0]} periods of {d.period_s:g} s at least, and {most_s:g} s at most, "
            f"not {watchdog_s:g} s",
            f"between {least_s:g} and {most_s:g} seconds",
        )
    elif d.daq.timeout_s + d.period_s > watchdog_s * (1 + _SLACK):
        yield wrong(
            "daq.timeout_s",
            f"one lost reply would set off the watchdog: {d.daq.timeout_s:g} s time-out + {d.period_s:g} s period "
            f"is more than daq.watchdog_s {watchdog_s:g}",
            f"at most {watchdog_s - d.period_s:g} seconds",
        )


# ---------------------------------------------------------------------- travel


def _limits(d: DeviceSetup) -> Iterator[Problem]:
    if d.limits.is_endless:
        if d.sensor.encoder is None:
            yield wrong(
                "limits.travel",
                "a shaft that turns without end needs `sensor.encoder`: a potentiometer has ends",
                "give soft_rad and hard_rad",
            )
        return
    soft, hard = d.limits.soft_rad, d.limits.hard_rad
    if not soft[0] < 0.0 < soft[1]:
        yield wrong(
            "limits.soft_rad",
            f"must enclose 0 rad, the centre of travel: {bracketed(soft)} rad does not",
            "put the zero of the calibration at the centre of travel",
        )
    elif not stopping.limits_are_ordered(d):
        yield wrong("limits.soft_rad", f"{bracketed(soft)} rad is not inside limits.hard_rad {bracketed(hard)} rad")
    low, high = d.sensor.range_rad
    if not (low <= hard[0] and hard[1] <= high):
        yield wrong(
            "limits.hard_rad",
            f"{bracketed(hard)} rad is not inside the calibrated range of the sensor between its rails, "
            f"{bracketed((low, high))} rad",
            "lower the limits, or calibrate farther out",
        )


def _room_to_stop(d: DeviceSetup) -> Iterator[Problem]:
    if not stopping.limits_are_ordered(d):
        return
    room = stopping.room_rad(d)
    distance = stopping.stopping_rad(d)
    if distance <= room:
        return
    slower = d.limits.max_speed_rad_s * room / distance
    yield wrong(
        "limits.max_speed_rad_s",
        f"no room to stop: {stopping.stopping_sum(d)}, but from the centre of travel (0 rad) "
        f"the nearer hard limit is {room:.3f} rad away",
        f"at most {_floor(slower):g} rad/s"
        + (", or a shorter daq.watchdog_s" if backend_of(d).watchdog(d).time_s is not None else "")
        + ", or wider limits.hard_rad",
    )


# ---------------------------------------------------------------------- drive


def _drive(e: Experiment) -> Iterator[Problem]:
    d = e.drive
    full_V = d.supply_V - d.bridge_drop_V
    if d.max_V > full_V:
        yield wrong(
            "drive.max_V",
            f"{d.max_V:g} V is more than the {full_V:g} V that the bridge can give "
            f"({d.supply_V:g} V supply - {d.bridge_drop_V:g} V drop)",
            f"at most {full_V:g} volts" if full_V > 0.0 else "the supply must exceed the drop",
        )
    if e.breakaway.max_V > d.max_V:
        yield wrong(
            "breakaway.max_V", f"{e.breakaway.max_V:g} V is more than drive.max_V {d.max_V:g} V", _at_most(d.max_V)
        )


def _breakaway(e: Experiment) -> Iterator[Problem]:
    if e.breakaway.rest_s < 10.0 * e.period_s * (1 - _SLACK):
        yield wrong(
            "breakaway.rest_s",
            f"{e.breakaway.rest_s:g} s is {e.breakaway.rest_s / e.period_s:.3g} periods of the loop: too few to "
            "measure the noise",
            f"at least {10.0 * e.period_s:g} seconds",
        )
    least_rad = _MOTION_COUNTS * e.sensor.curve.lsb_rad
    if e.breakaway.motion_rad < least_rad:
        yield wrong(
            "breakaway.motion_rad",
            f"{e.breakaway.motion_rad:g} rad is less than {_MOTION_COUNTS} counts of the sensor ({least_rad:.3g} rad)",
            "at least that, else noise looks like motion",
        )
    elif e.breakaway.motion_rad > _LARGEST_MOTION_RAD:
        yield wrong(
            "breakaway.motion_rad",
            f"{e.breakaway.motion_rad:g} rad is more than {_LARGEST_MOTION_RAD:g} rad: the strokes of the breakaway "
            "check are too short for it, and the guard would think that a turning shaft stands still",
            f"{_floor(max(2.0 * least_rad, 0.02)):g} to {_LARGEST_MOTION_RAD:g} rad",
        )
    yield from _unseen_travel(e)


def _unseen_travel(e: Experiment) -> Iterator[Problem]:
    """How far the shaft may turn in the breakaway check while the sensor does not show it."""
    b = e.breakaway
    if e.motor is None:
        yield wrong(
            "motor",
            "motor.no_load_speed_rad_s is missing: without it nothing bounds how far the shaft turns in the breakaway "
            "check if the sensor is stuck or uncoupled",
            "add the section: the data sheet's no-load speed at drive.supply_V, behind the gear, in rad/s",
        )
        return
    if b.max_V > e.drive.max_V:
        return
    strokes = breakaway_strokes(e)
    if strokes is None:
        top_rad_s = e.motor.no_load_speed_rad_s * b.max_V / e.drive.supply_V
        largest_V = _largest(lambda max_V: has_strokes(e, max_V), b.max_V)
        yield wrong(
            "breakaway.max_V",
            f"{b.max_V:g} V is too much: if the sensor is stuck or uncoupled, the shaft could turn more than "
            f"{UNSEEN_RAD:g} rad in the breakaway check before rig notices. By motor.no_load_speed_rad_s it reaches "
            f"{top_rad_s:.3g} rad/s, and a stroke is at least one period ({1e3 * e.period_s:g} ms) and at most the "
            "device's watchdog long",
            (f"at most {_floor(largest_V):g} volts, or " if largest_V > 0.0 else "")
            + "a shorter period_s, or a faster breakaway.ramp_V_s"
            + ("" if _own_watchdog_s(e.device) is None else ", or a shorter time-out of the device's output"),
        )
    elif strokes.levels(b.max_V) < _FEWEST_PAIRS:
        slower = b.ramp_V_s * (b.max_V / _FEWEST_PAIRS) / strokes.step_V
        yield wrong(
            "breakaway.ramp_V_s",
            f"{b.ramp_V_s:g} V/s reaches breakaway.max_V in {strokes.levels(b.max_V)} strokes each way: too few to "
            "measure static friction",
            f"at most {_floor(0.75 * slower):g} V/s",
        )


def _own_watchdog_s(d: DeviceSetup) -> float | None:
    """Time of a watchdog that arming does not set, s; None where there is none, or where arming sets it."""
    watchdog = backend_of(d).watchdog(d)
    return watchdog.time_s if watchdog.unit_s is None else None


def _largest(fits: Callable[[float], bool], below: float) -> float:
    """Largest value that fits, below one that does not fit; to the three digits that a hint shows."""
    low, high = 0.0, below
    while high - low > 5e-4 * high and high > 1e-9 * below:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


# ---------------------------------------------------------------------- relay


def _gains(e: Experiment) -> Iterator[Problem]:
    s = e.relay.search
    if e.relay.gains is None and e.relay.target is None:
        return  # `until` starts from the breakaway level
    if e.relay.gains is None:
        start = RelayGainsSection(h1_V=s.h1_start_V, h2_V=s.h2_start_V)
        pairs: list[tuple[Path, RelayGainsSection, str]] = [(("relay", "search"), start, "_start_V")]
    else:
        pairs = [(("relay", "gains", k), g, "_V") for k, g in enumerate(e.relay.gains)]
    for path, gains, ending in pairs:
        for name, h_V in (("h1", gains.h1_V), ("h2", gains.h2_V)):
            if h_V > s.h_max_V:
                message = f"{h_V:g} V is more than relay.search.h_max_V {s.h_max_V:g} V"
                yield Problem((*path, name + ending), message, _at_most(s.h_max_V))
        if gains.h1_V + gains.h2_V > e.drive.max_V * (1 + _SLACK):
            yield Problem(
                path,
                f"h1 + h2 = {gains.h1_V:g} + {gains.h2_V:g} = {gains.h1_V + gains.h2_V:g} V "
                f"is more than drive.max_V {e.drive.max_V:g} V",
                "lower the gains or raise drive.max_V: the relay must never saturate",
            )


def _target(e: Experiment) -> Iterator[Problem]:
    d = e.device
    target = e.relay.target
    if target is None:
        return
    shortest_s = _SHORTEST_CYCLE_PERIODS * e.period_s
    if target.period_s < shortest_s * (1 - _SLACK):
        yield wrong(
            "relay.target.period_s",
            f"{target.period_s:g} s is {target.period_s / e.period_s:.3g} periods of the loop; a shorter cycle than "
            f"{_SHORTEST_CYCLE_PERIODS} is delay hunting",
            f"at least {shortest_s:g} seconds, or a shorter period_s",
        )
    smallest_rad = target.amplitude_rad * min(1.0, e.relay.second_ratio)
    within_rad = smallest_rad * (1.0 - target.tolerance)
    least_rad = _SMALLEST_CYCLE_COUNTS * e.sensor.curve.lsb_rad
    if within_rad < least_rad:
        yield wrong(
            "relay.target.amplitude_rad",
            f"the smaller test's {smallest_rad:.3g} rad - {percent(target.tolerance)} tolerance = {within_rad:.3g} rad "
            f"is less than {_SMALLEST_CYCLE_COUNTS} counts of the sensor ({least_rad:.3g} rad), which is delay hunting",
            f"at least {target.amplitude_rad * least_rad / within_rad:.3g} rad",
        )
    if not stopping.limits_are_ordered(d):
        return
    soft_rad = stopping.reach_rad(d)
    amplitude_rad = target.amplitude_rad * max(1.0, e.relay.second_ratio)  # of the larger of both tests
    largest_rad = amplitude_rad * (1.0 + target.tolerance)
    if largest_rad > soft_rad:
        yield wrong(
            "relay.target.amplitude_rad",
            f"the larger test's {amplitude_rad:.3g} rad + {percent(target.tolerance)} tolerance = {largest_rad:.3g} "
            f"rad leaves the soft limits ({soft_rad:g} rad from the centre of travel)",
            "lower the amplitude",
        )
        return
    stop_rad = stopping.predicted_stop_rad(d, largest_rad, target.period_s)
    if stop_rad > stopping.room_rad(d):
        yield wrong(
            "relay.target.amplitude_rad",
            f"the guard would brake within the cycle: its predicted stop reaches {stop_rad:.3g} rad, the nearer hard "
            f"limit is {stopping.room_rad(d):.3g} rad from the centre of travel",
            "lower the amplitude, lengthen relay.target.period_s, or widen limits.hard_rad",
        )
        return
    speed = stopping.peak_speed_rad_s(amplitude_rad, target.period_s)
    if speed > e.limits.max_speed_rad_s:
        yield wrong(
            "relay.target.amplitude_rad",
            f"{amplitude_rad:.3g} rad every {target.period_s:g} s peaks at about 8 x amplitude / period = "
            f"{speed:.3g} rad/s, above limits.max_speed_rad_s {e.limits.max_speed_rad_s:g}",
            "lower the amplitude or lengthen relay.target.period_s",
        )


def _hysteretic(e: Experiment) -> Iterator[Problem]:
    """Drives within the largest one; bands that the sensor sees, and that the shaft does not overshoot too far."""
    d = e.device
    overshoot = sum(rad for _, rad in stopping.overshoot_terms(d))
    for k, run in enumerate(e.relay.hysteretic or ()):
        path: Path = ("relay", "hysteretic", k)
        if abs(run.d_V) > e.drive.max_V * (1 + _SLACK):
            yield Problem(
                (*path, "d_V"),
                f"{abs(run.d_V):g} V is more than drive.max_V {e.drive.max_V:g} V",
                _at_most(e.drive.max_V),
            )
        least_rad = _SMALLEST_CYCLE_COUNTS * e.sensor.curve.lsb_rad
        if run.eps_rad < least_rad:
            yield Problem(
                (*path, "eps_rad"),
                f"{run.eps_rad:g} rad is less than {_SMALLEST_CYCLE_COUNTS} counts of the sensor ({least_rad:.3g} rad)",
                "widen it: the method sees only the transient up to it",
            )
        elif stopping.limits_are_ordered(d) and run.eps_rad + overshoot > stopping.reach_rad(d):
            written = " + ".join(f"{rad:.3f} ({words})" for words, rad in stopping.overshoot_terms(d))
            room = stopping.reach_rad(d) - overshoot
            yield Problem(
                (*path, "eps_rad"),
                f"{run.eps_rad:g} rad and the overshoot, at most {written} = {overshoot:.3f} rad at "
                f"{e.limits.max_speed_rad_s:g} rad/s, leave the soft limits ({stopping.reach_rad(d):g} rad from the "
                "centre of travel)",
                (f"at most {_floor(room):g} rad, or " if room > least_rad else "")
                + "lower limits.max_speed_rad_s if the shaft is slower, or widen limits.soft_rad",
            )


# ---------------------------------------------------------------------- tracking, emulated bench


def _tracking(e: Experiment) -> Iterator[Problem]:
    d = e.device
    if e.tracking is None or not stopping.limits_are_ordered(d):
        return
    terms = [(abs(s.amplitude_rad), s.omega_rad_s) for s in e.tracking.trajectory]
    turn_rad_s = abs(e.tracking.turn_rad_s)
    if turn_rad_s and not e.limits.is_endless:
        yield wrong("tracking.turn_rad_s", "a shaft that turns on needs limits.travel: none", "remove it")
        return
    peak_rad = sum(a for a, _ in terms)
    speed = sum(a * w for a, w in terms) + turn_rad_s
    if peak_rad > stopping.reach_rad(d):
        written = " + ".join(f"{a:g}" for a, _ in terms)
        yield wrong(
            "tracking.trajectory",
            f"its peak, at most {written} = {peak_rad:.3g} rad, leaves the soft limits "
            f"({stopping.reach_rad(d):g} rad from the centre of travel)",
            "lower the amplitudes",
        )
    turned_rad = turn_rad_s * e.tracking.duration_s + peak_rad
    if turn_rad_s and turned_rad > e.limits.soft_rad[1]:
        yield wrong(
            "tracking.turn_rad_s",
            f"a check turns up to {turn_rad_s:g} rad/s x {e.tracking.duration_s:g} s + {peak_rad:.3g} rad = "
            f"{turned_rad:.3g} rad: limits.turns {e.limits.turns:g} leaves {e.limits.soft_rad[1]:.3g} rad",
            "turn more slowly, or allow more turns",
        )
    if speed > e.limits.max_speed_rad_s:
        written = " + ".join([*(f"{a:g} x {w:g}" for a, w in terms), *([f"{turn_rad_s:g}"] if turn_rad_s else [])])
        yield wrong(
            "tracking.trajectory",
            f"its speed, at most {written} = {speed:.3g} rad/s, is above limits.max_speed_rad_s "
            f"{e.limits.max_speed_rad_s:g}",
            "lower amplitudes or frequencies",
        )


def _survey(e: Experiment) -> Iterator[Problem]:
    """Speeds that are given must fit into the travel and the time; without any, a survey takes what fits."""
    if e.limits.is_endless:
        if e.identify.thorough or "survey" in e.model_fields_set:
            yield wrong(
                "limits.travel",
                "a survey sweeps between two limits, and there are none",
                "leave out section survey and identify.thorough",
            )
        return
    if e.survey.speeds_rad_s is None or not stopping.limits_are_ordered(e.device):
        return
    try:
        stopping.expected_sweeps(e)
    except TooShortError as error:
        yield wrong(
            "survey.speeds_rad_s", str(error), "other speeds, wider limits.soft_rad, or a larger survey.longest_s"
        )


def _law(e: Experiment) -> Iterator[Problem]:
    """The law is constructed, so that it refuses its options here, not before a motor."""
    if e.law is None:
        return
    try:
        named_law(e.law.name, e.law.options)
    except LookupError:
        names = sorted(registered())
        near = get_close_matches(e.law.name, names, n=1)
        yield wrong(
            "law.name",
            f"no law {printable(e.law.name)!r}; installed: {', '.join(names) or 'none'}",
            f"did you mean '{near[0]}'?" if near else "install the package that offers it (docs/api.md)",
        )
    except OptionError as error:
        yield Problem(("law", "options", *([error.key] if error.key else [])), str(error))
    except PlugInError as error:
        yield wrong("law.name", str(error), "see docs/api.md, or ask its author")


def _emulated(d: DeviceSetup) -> Iterator[Problem]:
    if d.emulated is None:
        return
    m = d.emulated.motor
    sides = (("plus", m.fs_plus_V, m.fc_plus_V), ("minus", m.fs_minus_V, m.fc_minus_V))
    above_V = [0.0 if static_V is None else static_V - moving_V for _, static_V, moving_V in sides]
    for side, static_V, moving_V in sides:
        if static_V is not None and static_V < moving_V:
            yield wrong(
                f"emulated.motor.fs_{side}_V",
                f"static friction {static_V:g} V is less than the moving friction fc_{side}_V {moving_V:g} V",
                "raise it, or leave it out: then it is the moving friction",
            )
    if m.stribeck_rad_s > 0.0 and not max(above_V) > 0.0:
        yield wrong(
            "emulated.motor.stribeck_rad_s",
            "has no effect: static friction is nowhere above moving friction",
            "raise fs_plus_V and fs_minus_V, or leave it out",
        )
    if m.parts is not None and abs(above_V[0] - above_V[1]) > 1e-12:
        yield wrong(
            "emulated.motor.parts",
            f"static friction is above moving friction by {above_V[0]:g} V one way and {above_V[1]:g} V the other",
            "a motor with parts needs the same both ways: change fs_plus_V or fs_minus_V",
        )
    ends = {"mechanical stops": m.stop_rad}
    if not d.limits.is_endless:  # else they count from where the command finds the shaft
        ends["hard limits"] = d.limits.hard_rad
    for name, (low, high) in ends.items():
        if not low <= m.start_rad <= high:
            yield wrong(
                "emulated.motor.start_rad",
                f"{m.start_rad:g} rad is outside the {name} {bracketed((low, high))} rad",
                "start inside",
            )
            break
    fault = d.emulated.wiring.sensor
    foreign = _NO_ENCODER_HAS if d.sensor.encoder is not None else _ENCODERS_ALONE
    if fault in foreign:
        yield wrong("emulated.wiring.sensor", f"this sensor has no fault `{fault}`", "another, or ok")
    if d.emulated.tachometer and d.tachometer is None:
        yield wrong("emulated.tachometer", "needs the section `tachometer` with its scale")


_NO_ENCODER_HAS = ("broken_low", "broken_high", "noisy")
_ENCODERS_ALONE = ("still", "still_a")

_RULES: tuple[Rule, ...] = (
    _of_device(device_rules),
    _of_device(_spin),
    _of_device(_watchdog),
    _of_device(_limits),
    _of_device(_room_to_stop),
    attached_rules,
    _drive,
    _breakaway,
    _gains,
    _target,
    _hysteretic,
    _tracking,
    _survey,
    _law,
    _of_device(_emulated),
)


# ---------------------------------------------------------------------- words


def _at_most(volts: float) -> str:
    return f"at most {volts:g} volts"


def _floor(value: float) -> float:
    """Three digits, rounded down: a value from a hint must pass."""
    return float(f"{value * 0.995:.3g}")


def check(path: Given, passing: Collection[str] = (), pace: float | None = None) -> tuple[Experiment, Preflight]:
    """``load``, and ``preflight`` on it: the experiment, and what it would do.

    pace     in place of loop.pace; None: as the file says
    passing  keys, written with dots, whose problems do not count; for commands that drive nothing
    Raises ConfigError as ``load`` does, and also if the experiment must not be run: with line and key of each problem.
    """
    experiment, document = load_with_places(read(path, takes_pipe=True))
    experiment = experiment.at_pace(pace)
    found = preflight(experiment)
    problems = [problem for problem in found.problems if problem.key not in passing]
    if problems:
        raise ConfigError(map(document.located, problems))
    return experiment, found
