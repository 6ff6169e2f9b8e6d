"""What an experiment would do, and whether it may: pure arithmetic on the config, no device is touched.

Here is what several keys say together; what one key says by itself is the schema's. A rule says nothing where
another has already refused what it builds on, so that one mistake gives one line.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise
from math import isclose, log

from rig.config.link_budget import BAUD_RATES, BITS_PER_BYTE, FRAME_BYTES, LINK_SHARE, link_budget
from rig.config.modbus import EMULATED_PORTS as MODBUS_EMULATED_PORTS
from rig.config.modbus import is_tcp
from rig.config.modbus_rules import modbus_rules
from rig.config.problems import Path, Problem, printable
from rig.config.schema import BUILT_IN_DRIVERS, Experiment, Gains, RelayTarget

Rule = Callable[[Experiment], Iterator[Problem]]

# A relay in the device: every 10 of its 1 ms ticks a BLOCK of 10 (reading, drive) comes unasked
_BLOCK_BODY_BYTES = 10 + 10 * 4
_BLOCK_S = 0.010
_DRIVE_UNITS = 799  # at full duty

_WATCHDOG_PERIODS = (3, 10)
_REACTION_PERIODS = 3  # of the loop: one until the next tick, two by which the guard's velocity lags
_VELOCITY_LAG_S = 0.02  # by which it lags at least: half of its window
_BLOCK_AGE_PERIODS = 2  # of the loop: the rows of a device's block are older than a reply, by its length and its way
_SHORTEST_CYCLE_PERIODS = 30  # theory section 5: a shorter cycle is delay hunting
_SMALLEST_CYCLE_COUNTS = 20  # theory section 5
_MOTION_COUNTS = 3  # below this the sensor's last digit would pass for motion
_SLACK = 1e-9  # relative: 0.1 s is ten periods of 0.01 s, whatever the binary fractions say


CHIP_PORTS = ("emulated-chip", "emulated-chip-realtime")
EMULATED_PORTS = ("emulated", *CHIP_PORTS)
CHIP_BAUDS = (115200, 1_000_000)  # that the Uno's firmware is built for


@dataclass(frozen=True)
class Preflight:
    """``lines``: what the experiment would do, for people; ``problems``: why it must not, empty if it may."""

    lines: tuple[str, ...]
    problems: tuple[Problem, ...]


def preflight(experiment: Experiment) -> Preflight:
    """Check an experiment offline. The problems have paths but no places: ``rig.config.check`` adds these."""
    problems = tuple(problem for rule in _RULES for problem in rule(experiment))
    return Preflight(tuple(_lines(experiment)), problems)


def is_plug_in(experiment: Experiment) -> bool:
    """Whether the driver comes from another package: offline nothing is known of its link and its failsafe."""
    return experiment.daq.driver not in BUILT_IN_DRIVERS


def unknown_driver(name: str, installed: Collection[str] = ()) -> Problem:
    """What to say of a driver that is neither built in nor, as a plug-in, among those ``installed``."""
    plug_ins = ", ".join(sorted(installed)) or "none"
    close = get_close_matches(name, [*BUILT_IN_DRIVERS, *sorted(installed)], n=1)
    return _problem(
        "daq.driver",
        f"no driver {printable(name)!r}; built in: {', '.join(BUILT_IN_DRIVERS)}; plug-ins installed: {plug_ins}",
        f"did you mean '{close[0]}'?" if close else "install the package that offers it (docs/plug-in-driver.md)",
    )


def reaction_periods(experiment: Experiment) -> int:
    """Periods of the loop until it can have reacted to what the shaft does."""
    return (
        _REACTION_PERIODS
        + (_BLOCK_AGE_PERIODS if experiment.relay.where == "device" else 0)
        + (1 if writes_first(experiment) else 0)
    )


def reaction_s(experiment: Experiment) -> float:
    """Time until the loop can have reacted to what the shaft does, s."""
    return reaction_periods(experiment) * experiment.period_s + _further_lag_s(experiment)


def _further_lag_s(e: Experiment) -> float:
    """Of the guard's velocity, beyond two periods, where the period is short."""
    return max(_VELOCITY_LAG_S - 2.0 * e.period_s, 0.0)


def writes_first(experiment: Experiment) -> bool:
    """Whether what a tick decides goes out with the next one: a Modbus device asked by FC23; a plug-in's may."""
    modbus = experiment.daq.modbus
    asked_by_fc23 = experiment.daq.driver == "modbus" and modbus is not None and modbus.requests == "read-write"
    return asked_by_fc23 or is_plug_in(experiment)


def device_watchdog_s(experiment: Experiment) -> float:
    """Silence of the host after which the device drives 0 V, s."""
    modbus = experiment.daq.modbus
    fixed_s = modbus.device_watchdog_s if modbus is not None else None
    return experiment.daq.watchdog_s if fixed_s is None else fixed_s


# ---------------------------------------------------------------------- the link


def _backend(e: Experiment) -> Iterator[Problem]:
    d = e.daq
    if d.driver == "simulated" and d.port is not None:
        yield _problem("daq.port", "`driver: simulated` has no port", "remove it, or set daq.driver to serial")
    if d.driver == "serial" and d.port is None:
        yield _problem("daq.port", "`driver: serial` needs a port", "e.g. port: /dev/ttyACM0, or port: emulated")
    if e.emulated is None and d.driver == "simulated":
        yield _problem("emulated", "`driver: simulated` needs this section", "describe the bench: see config/demo.yaml")
    if e.emulated is None and d.driver == "serial" and d.port in EMULATED_PORTS:
        yield _problem("emulated", f"`port: {d.port}` needs this section", "describe the bench: see config/demo.yaml")
    if d.port in CHIP_PORTS and d.baud not in CHIP_BAUDS:
        yield _problem("daq.baud", f"the Uno's firmware does not speak {d.baud} baud", "115200 or 1000000")
    if is_plug_in(e):
        for key in ("port", "modbus"):
            if getattr(d, key) is not None:
                yield _problem(f"daq.{key}", f"is of built-in drivers, not of `{d.driver}`", "see daq.options")
    elif d.options is not None:
        yield _problem("daq.options", f"is of plug-in drivers, `driver: {d.driver}` has none", "remove it")


def _link_sum(e: Experiment) -> str:
    return f"{link_budget(e).written}; {LINK_SHARE:.0%} of the period is {LINK_SHARE * e.period_s * 1e3:.2f} ms"


def _fits(e: Experiment, baud: int) -> bool:
    return link_budget(e, baud).total_s <= LINK_SHARE * e.period_s * (1 + _SLACK)


def _link_budget(e: Experiment) -> Iterator[Problem]:
    if not link_budget(e).terms or _fits(e, e.daq.baud):
        return
    fitting = [] if is_tcp(e.daq.port) else [baud for baud in BAUD_RATES if _fits(e, baud)]
    way_out = f"daq.baud {fitting[0]} fits, or " if fitting else ""
    period_s = link_budget(e).total_s / LINK_SHARE
    hint = f"{way_out}period_s of {period_s:.2g} and more" if period_s <= 0.1 else way_out.removesuffix(", or ")
    key = "period_s" if is_tcp(e.daq.port) else "daq.baud"
    yield _problem(key, f"too slow for the period: {_link_sum(e)}", hint)


def _spin(e: Experiment) -> Iterator[Problem]:
    if 1e-6 * e.loop.spin_us > 0.5 * e.period_s * (1 + _SLACK):
        yield _problem(
            "loop.spin_us",
            f"{e.loop.spin_us:g} us of spinning is more than half the period of {1e3 * e.period_s:g} ms",
            f"at most {0.5e6 * e.period_s:g}",
        )


def _stream_sum(e: Experiment) -> str:
    count = _BLOCK_BODY_BYTES + FRAME_BYTES
    wire_s = count * BITS_PER_BYTE / e.daq.baud
    return (
        f"BLOCK {count} bytes x {BITS_PER_BYTE} bits / {e.daq.baud} baud = {wire_s * 1e3:.2f} ms "
        f"of every {_BLOCK_S * 1e3:g} ms"
    )


def _device_relay(e: Experiment) -> Iterator[Problem]:
    if e.relay.where != "device":
        return
    if e.daq.driver in ("simulated", "modbus"):
        without = "has no device" if e.daq.driver == "simulated" else "knows of no relay in the device"
        yield _problem(
            "relay.where", f"`driver: {e.daq.driver}` {without}", "set it to host, or daq.driver to serial with a port"
        )
        return
    if is_plug_in(e):
        return  # whether its device has a relay, the driver itself tells
    bits = (_BLOCK_BODY_BYTES + FRAME_BYTES) * BITS_PER_BYTE
    if bits > LINK_SHARE * _BLOCK_S * e.daq.baud:
        fitting = next(baud for baud in BAUD_RATES if bits <= LINK_SHARE * _BLOCK_S * baud)
        yield _problem(
            "daq.baud",
            f"too slow for the samples of a relay in the device: {_stream_sum(e)}; {LINK_SHARE:.0%} may be used",
            f"daq.baud {fitting} fits, or relay.where: host",
        )
    points = sorted((p.counts, p.rad) for p in e.sensor.calibration)
    (c0, r0), (c1, r1) = points[0], points[-1]
    bend_rad = max(abs(r - r0 - (c - c0) * (r1 - r0) / (c1 - c0)) for c, r in points)
    if bend_rad > 0.5 * _count_rad(e):
        yield _problem(
            "sensor.calibration",
            f"bends by {bend_rad / _count_rad(e):.1f} counts, but a relay in the device integrates counts",
            "a straight line within half a count, or relay.where: host",
        )


def _device_drives(e: Experiment) -> Iterator[str]:
    """How a relay in the device is fed, and what given gains become in whole units of the drive."""
    if e.relay.where != "device":
        return
    if is_plug_in(e):
        yield "relay in the device: as the plug-in driver runs it; a search runs in the host"
        return
    yield f"relay in the device: decides every ms; {_stream_sum(e)}; a search runs in the host"
    full_V, dead = e.drive.supply_V - e.drive.bridge_drop_V, e.drive.dead_band_duty.plus
    for g in e.relay.gains or ():
        outer, inner = (
            round(_DRIVE_UNITS * (dead + (1.0 - dead) * u_V / full_V))
            for u_V in (g.h1_V + g.h2_V, abs(g.h2_V - g.h1_V))
        )
        yield f"  at ({g.h1_V:g}, {g.h2_V:g}) V it drives +-{outer} and +-{inner} of {_DRIVE_UNITS} units"


def _watchdog(e: Experiment) -> Iterator[Problem]:
    least_s, most_s = (n * e.period_s for n in _WATCHDOG_PERIODS)
    watchdog_s = e.daq.watchdog_s
    if not least_s * (1 - _SLACK) <= watchdog_s <= most_s * (1 + _SLACK):
        yield _problem(
            "daq.watchdog_s",
            f"must be {_WATCHDOG_PERIODS[0]} to {_WATCHDOG_PERIODS[1]} periods of {e.period_s:g} s, "
            f"not {watchdog_s / e.period_s:.3g}",
            f"between {least_s:g} and {most_s:g} seconds",
        )
    elif e.daq.timeout_s + e.period_s > watchdog_s * (1 + _SLACK):
        yield _problem(
            "daq.timeout_s",
            f"one lost reply would set off the watchdog: {e.daq.timeout_s:g} s time-out + {e.period_s:g} s period "
            f"is more than daq.watchdog_s {watchdog_s:g}",
            f"at most {watchdog_s - e.period_s:g} seconds",
        )


# ---------------------------------------------------------------------- travel


def _limits_are_ordered(e: Experiment) -> bool:
    (soft_low, soft_high), (hard_low, hard_high) = e.limits.soft_rad, e.limits.hard_rad
    return hard_low < soft_low < 0.0 < soft_high < hard_high


def _limits(e: Experiment) -> Iterator[Problem]:
    soft, hard = e.limits.soft_rad, e.limits.hard_rad
    if not soft[0] < 0.0 < soft[1]:
        yield _problem(
            "limits.soft_rad",
            f"must enclose 0 rad, the centre of travel: {_interval(soft)} rad does not",
            "put the zero of the calibration at the centre of travel",
        )
    elif not _limits_are_ordered(e):
        yield _problem("limits.soft_rad", f"{_interval(soft)} rad is not inside limits.hard_rad {_interval(hard)} rad")
    low, high = _sensor_range_rad(e)
    if not (low <= hard[0] and hard[1] <= high):
        yield _problem(
            "limits.hard_rad",
            f"{_interval(hard)} rad is not inside the calibrated range of the sensor between its rails, "
            f"{_interval((low, high))} rad",
            "lower the limits, or calibrate farther out",
        )


def _sensor_range_rad(e: Experiment) -> tuple[float, float]:
    """Positions within the calibration's points and between the rails, rad; (inf, -inf) where there are none."""
    points = sorted((p.counts, p.rad) for p in e.sensor.calibration)
    rail_low, rail_high = e.sensor.rail_counts
    low, high = max(points[0][0], rail_low + 1), min(points[-1][0], rail_high - 1)
    if low > high:
        return float("inf"), float("-inf")

    def position(counts: int) -> float:
        for (c0, r0), (c1, r1) in pairwise(points):
            if counts <= c1:
                return r0 + (counts - c0) * (r1 - r0) / (c1 - c0)
        return points[-1][1]

    ends = sorted((position(low), position(high)))
    return ends[0], ends[1]


def _count_rad(e: Experiment) -> float:
    """Mean size of one count over the calibration, rad."""
    points = sorted((p.counts, p.rad) for p in e.sensor.calibration)
    return abs((points[-1][1] - points[0][1]) / (points[-1][0] - points[0][0]))


def _stopping_terms(e: Experiment) -> tuple[tuple[str, float], ...]:
    """What the shaft travels from the largest speed if the host dies, term by term: words, rad.

    Coasting is at 0 V, terminals shorted, without the help of friction: speed times time constant. Each term is at the
    largest speed: the guard ends anything faster while the host lives. What the drive adds to it between the host's
    death and the device's watchdog depends on K and tau, which the experiment has yet to find: no sum over a config can
    count it, and the device's own hard limit is what ends such a drive.
    """
    v = e.limits.max_speed_rad_s
    lag_s = _further_lag_s(e)
    return (
        (f"{reaction_periods(e)} periods", v * reaction_periods(e) * e.period_s),
        *((("velocity window", v * lag_s),) if lag_s > 0.0 else ()),
        ("reply time-out", v * e.daq.timeout_s),
        ("watchdog", v * device_watchdog_s(e)),
        ("coasting", v * e.limits.coast_tau_s),
    )


def _stopping_sum(e: Experiment) -> str:
    terms = _stopping_terms(e)
    written = " + ".join(f"{rad:.3f} {words}" for words, rad in terms)
    return f"at {e.limits.max_speed_rad_s:g} rad/s: {written} = {sum(rad for _, rad in terms):.3f} rad"


def _room_rad(e: Experiment) -> float:
    """Distance from the centre of travel, about which the relay oscillates, to the nearer hard limit, rad."""
    return min(e.limits.hard_rad[1], -e.limits.hard_rad[0])


def _room_to_stop(e: Experiment) -> Iterator[Problem]:
    if not _limits_are_ordered(e):
        return
    room = _room_rad(e)
    distance = sum(rad for _, rad in _stopping_terms(e))
    if distance <= room:
        return
    slower = e.limits.max_speed_rad_s * room / distance
    yield _problem(
        "limits.max_speed_rad_s",
        f"no room to stop: {_stopping_sum(e)}, but from the centre of travel (0 rad) "
        f"the nearer hard limit is {room:.3f} rad away",
        f"at most {_floor(slower):g} rad/s, or a shorter daq.watchdog_s, or wider limits.hard_rad",
    )


# ---------------------------------------------------------------------- drive


def _drive(e: Experiment) -> Iterator[Problem]:
    d = e.drive
    full_V = d.supply_V - d.bridge_drop_V
    if d.max_V > full_V:
        yield _problem(
            "drive.max_V",
            f"{d.max_V:g} V is more than the {full_V:g} V that the bridge can give "
            f"({d.supply_V:g} V supply - {d.bridge_drop_V:g} V drop)",
            f"at most {full_V:g} volts" if full_V > 0.0 else "the supply must exceed the drop",
        )
    if e.breakaway.max_V > d.max_V:
        yield _problem(
            "breakaway.max_V", f"{e.breakaway.max_V:g} V is more than drive.max_V {d.max_V:g} V", _at_most(d.max_V)
        )


def _breakaway(e: Experiment) -> Iterator[Problem]:
    if e.breakaway.rest_s < 10.0 * e.period_s * (1 - _SLACK):
        yield _problem(
            "breakaway.rest_s",
            f"{e.breakaway.rest_s:g} s is {e.breakaway.rest_s / e.period_s:.3g} periods of the loop: too few for "
            "the noise",
            f"at least {10.0 * e.period_s:g} seconds",
        )
    least_rad = _MOTION_COUNTS * _count_rad(e)
    if e.breakaway.motion_rad < least_rad:
        yield _problem(
            "breakaway.motion_rad",
            f"{e.breakaway.motion_rad:g} rad is less than {_MOTION_COUNTS} counts of the sensor ({least_rad:.3g} rad)",
            "noise would pass for motion: at least that",
        )


# ---------------------------------------------------------------------- relay


def _gains(e: Experiment) -> Iterator[Problem]:
    s = e.relay.search
    if e.relay.gains is None and e.relay.target is None:
        return
    if e.relay.gains is None:
        start = Gains(h1_V=s.h1_start_V, h2_V=s.h2_start_V)
        pairs: list[tuple[Path, Gains, str]] = [(("relay", "search"), start, "_start_V")]
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
                "the relay must never saturate: lower the gains or raise drive.max_V",
            )


def _peak_speed_rad_s(amplitude_rad: float, period_s: float) -> float:
    """Largest speed of a limit cycle, rad/s: of two parabolas, a little more than the true arcs reach."""
    return 8.0 * amplitude_rad / period_s


def _largest_amplitude_rad(e: Experiment, target: RelayTarget) -> float:
    """Amplitude of the larger of the two tests: the second has ``second_ratio`` times the first's, rad."""
    return target.amplitude_rad * max(1.0, e.relay.second_ratio)


def _target(e: Experiment) -> Iterator[Problem]:
    target = e.relay.target
    if target is None:
        return
    shortest_s = _SHORTEST_CYCLE_PERIODS * e.period_s
    if target.period_s < shortest_s * (1 - _SLACK):
        yield _problem(
            "relay.target.period_s",
            f"{target.period_s:g} s is {target.period_s / e.period_s:.3g} periods of the loop; a shorter cycle than "
            f"{_SHORTEST_CYCLE_PERIODS} is delay hunting",
            f"at least {shortest_s:g} seconds, or a shorter period_s",
        )
    smallest_rad = target.amplitude_rad * min(1.0, e.relay.second_ratio)
    least_rad = _SMALLEST_CYCLE_COUNTS * _count_rad(e)
    if smallest_rad < least_rad:
        yield _problem(
            "relay.target.amplitude_rad",
            f"the smaller test's {smallest_rad:.3g} rad is less than {_SMALLEST_CYCLE_COUNTS} counts of the sensor "
            f"({least_rad:.3g} rad)",
            "raise the amplitude",
        )
    if not _limits_are_ordered(e):
        return
    reach_rad = _reach_rad(e)
    amplitude_rad = _largest_amplitude_rad(e, target)
    largest_rad = amplitude_rad * (1.0 + target.tolerance)
    if largest_rad > reach_rad:
        yield _problem(
            "relay.target.amplitude_rad",
            f"the larger test's {amplitude_rad:.3g} rad + {target.tolerance:.0%} tolerance = {largest_rad:.3g} rad "
            f"leaves the soft limits ({reach_rad:g} rad from the centre of travel)",
            "lower the amplitude",
        )
        return
    stop_rad = _predicted_stop_rad(e, largest_rad, target.period_s)
    if stop_rad > _room_rad(e):
        yield _problem(
            "relay.target.amplitude_rad",
            f"the guard would brake within the cycle: its predicted stop reaches {stop_rad:.3g} rad, the nearer hard "
            f"limit is {_room_rad(e):.3g} rad from the centre of travel",
            "lower the amplitude, lengthen relay.target.period_s, or widen limits.hard_rad",
        )
        return
    speed = _peak_speed_rad_s(amplitude_rad, target.period_s)
    if speed > e.limits.max_speed_rad_s:
        yield _problem(
            "relay.target.amplitude_rad",
            f"{amplitude_rad:.3g} rad every {target.period_s:g} s peaks at about 8 x amplitude / period = "
            f"{speed:.3g} rad/s, above limits.max_speed_rad_s {e.limits.max_speed_rad_s:g}",
            "lower the amplitude or lengthen relay.target.period_s",
        )


def _hysteretic(e: Experiment) -> Iterator[Problem]:
    """Drives within the largest one; bands that the sensor sees, and that the shaft does not overshoot too far."""
    overshoot = sum(rad for _, rad in _overshoot_terms(e))
    for k, run in enumerate(e.relay.hysteretic or ()):
        path: Path = ("relay", "hysteretic", k)
        if abs(run.d_V) > e.drive.max_V * (1 + _SLACK):
            yield Problem(
                (*path, "d_V"),
                f"{abs(run.d_V):g} V is more than drive.max_V {e.drive.max_V:g} V",
                _at_most(e.drive.max_V),
            )
        least_rad = _SMALLEST_CYCLE_COUNTS * _count_rad(e)
        if run.eps_rad < least_rad:
            yield Problem(
                (*path, "eps_rad"),
                f"{run.eps_rad:g} rad is less than {_SMALLEST_CYCLE_COUNTS} counts of the sensor ({least_rad:.3g} rad)",
                "widen it: the transient up to it is all that the method sees",
            )
        elif _limits_are_ordered(e) and run.eps_rad + overshoot > _reach_rad(e):
            written = " + ".join(f"{rad:.3f} {words}" for words, rad in _overshoot_terms(e))
            room = _reach_rad(e) - overshoot
            yield Problem(
                (*path, "eps_rad"),
                f"{run.eps_rad:g} rad and the overshoot, at most {written} = {overshoot:.3f} rad at "
                f"{e.limits.max_speed_rad_s:g} rad/s, leave the soft limits ({_reach_rad(e):g} rad from the centre of "
                "travel)",
                (f"at most {_floor(room):g} rad, or " if room > least_rad else "")
                + "lower limits.max_speed_rad_s if the shaft is slower, or widen limits.soft_rad",
            )


def _overshoot_terms(e: Experiment) -> tuple[tuple[str, float], ...]:
    """How far the shaft goes on, at most, once it is beyond the hysteresis: words, rad.

    From a speed v that drive d has given it, -d stops it within v tau (1 - ln 2), the more friction the sooner.
    """
    v = e.limits.max_speed_rad_s
    periods = 3 if writes_first(e) else 2
    return (
        (f"{periods} periods", periods * v * e.period_s),
        ("reversing", v * e.limits.coast_tau_s * (1.0 - log(2.0))),
    )


def _predicted_stop_rad(e: Experiment, amplitude_rad: float, period_s: float) -> float:
    """Largest stop that the guard predicts within a cycle, rad.

    A cycle of constant accelerations, y = A (1 - s^2) with v = 8 A s/T at s = 0..1 from its top, is faster than the
    motor's; its largest y + v r is A (1 + (4 r/T)^2) within the arc, else 8 A r/T at the centre.
    """
    r = sum(rad for _, rad in _stopping_terms(e)) / e.limits.max_speed_rad_s
    s = 4.0 * r / period_s
    return amplitude_rad * (1.0 + s * s if s < 1.0 else 2.0 * s)


def _reach_rad(e: Experiment) -> float:
    """Distance from the centre of travel to the nearer soft limit, rad."""
    return min(-e.limits.soft_rad[0], e.limits.soft_rad[1])


# ---------------------------------------------------------------------- tracking, emulated bench


def _tracking(e: Experiment) -> Iterator[Problem]:
    if e.tracking is None or not _limits_are_ordered(e):
        return
    terms = [(abs(s.amplitude_rad), s.omega_rad_s) for s in e.tracking.trajectory]
    peak_rad = sum(a for a, _ in terms)
    speed = sum(a * w for a, w in terms)
    if peak_rad > _reach_rad(e):
        written = " + ".join(f"{a:g}" for a, _ in terms)
        yield _problem(
            "tracking.trajectory",
            f"its peak, at most {written} = {peak_rad:.3g} rad, leaves the soft limits "
            f"({_reach_rad(e):g} rad from the centre of travel)",
            "lower the amplitudes",
        )
    if speed > e.limits.max_speed_rad_s:
        written = " + ".join(f"{a:g} x {w:g}" for a, w in terms)
        yield _problem(
            "tracking.trajectory",
            f"its speed, at most {written} = {speed:.3g} rad/s, is above limits.max_speed_rad_s "
            f"{e.limits.max_speed_rad_s:g}",
            "lower amplitudes or frequencies",
        )


def _emulated(e: Experiment) -> Iterator[Problem]:
    if e.emulated is None:
        return
    m = e.emulated.motor
    for side, static_V, moving_V in (("plus", m.fs_plus_V, m.fc_plus_V), ("minus", m.fs_minus_V, m.fc_minus_V)):
        if static_V is not None and static_V < moving_V:
            yield _problem(
                f"emulated.motor.fs_{side}_V",
                f"static friction {static_V:g} V is less than the moving friction fc_{side}_V {moving_V:g} V",
                "raise it, or leave it out: as the moving friction",
            )
    falls = any(
        static_V is not None and static_V > moving_V
        for static_V, moving_V in ((m.fs_plus_V, m.fc_plus_V), (m.fs_minus_V, m.fc_minus_V))
    )
    if m.stribeck_rad_s > 0.0 and not falls:
        yield _problem(
            "emulated.motor.stribeck_rad_s",
            "has no effect: static friction is nowhere above moving friction",
            "raise fs_plus_V and fs_minus_V, or leave it out",
        )
    for name, (low, high) in (("mechanical stops", m.stop_rad), ("hard limits", e.limits.hard_rad)):
        if not low <= m.start_rad <= high:
            yield _problem(
                "emulated.motor.start_rad",
                f"{m.start_rad:g} rad is outside the {name} {_interval((low, high))} rad",
                "start inside",
            )
            break
    if e.emulated.tachometer and e.tachometer is None:
        yield _problem("emulated.tachometer", "needs the section `tachometer`, which says how it is scaled")


_RULES: tuple[Rule, ...] = (
    _backend,
    modbus_rules,
    _spin,
    _link_budget,
    _device_relay,
    _watchdog,
    _limits,
    _room_to_stop,
    _drive,
    _breakaway,
    _gains,
    _target,
    _hysteretic,
    _tracking,
    _emulated,
)


# ---------------------------------------------------------------------- what would happen


def _lines(e: Experiment) -> Iterator[str]:
    yield f"backend: {_backend_words(e)}, every {e.period_s * 1e3:g} ms"
    yield from _stage_lines(e)
    soft, hard = _interval(e.limits.soft_rad), _interval(e.limits.hard_rad)
    full_V = e.drive.supply_V - e.drive.bridge_drop_V
    yield (
        f"limits: soft {soft} rad, hard {hard} rad, sensor {_interval(_sensor_range_rad(e))} rad; "
        f"{e.limits.max_speed_rad_s:g} rad/s; {e.drive.max_V:g} V of the {full_V:g} V that the bridge can give"
    )
    yield f"stopping {_stopping_sum(e)}; room from the centre of travel: {_room_rad(e):.3f} rad"
    if link_budget(e).terms:
        yield f"link: {_link_sum(e)}"
    if is_plug_in(e):
        yield "link: the budget of a plug-in driver is not known; `rig doctor` measures it"
    yield from _device_drives(e)
    yield _failsafe(e)
    if e.emulated is not None and _is_emulated(e) and not isclose(e.emulated.supply_V, full_V):
        yield (
            f"note: the emulated bridge gives {e.emulated.supply_V:g} V, the config believes {full_V:g} V: "
            "K and f_c will come out scaled"
        )
    if e.emulated is not None and _is_emulated(e) and e.emulated.potentiometer.counts_max != e.sensor.counts_max:
        yield (
            f"note: the emulated potentiometer reads 0 to {e.emulated.potentiometer.counts_max} counts, "
            f"sensor.counts_max is {e.sensor.counts_max}: describe it in emulated.potentiometer"
        )
    low, high = e.limits.soft_rad
    if e.emulated is not None and not low <= e.emulated.motor.start_rad <= high:
        yield "note: the emulated shaft starts outside the soft limits: a run refuses until `rig jog` has it inside"
    if e.emulated is not None and not _is_emulated(e):
        if is_plug_in(e):
            yield "note: section `emulated` counts as the truth only if the driver says that its device is emulated"
        else:
            yield f"note: section `emulated` is not used with port {e.daq.port}"


def _failsafe(e: Experiment) -> str:
    """What stops the drive when the host is silent."""
    modbus = e.daq.modbus
    if e.daq.driver == "modbus" and modbus is not None and modbus.registers.watchdog is None:
        if modbus.device_watchdog_s is None:
            then = "a run drives all the same" if e.daq.accept_no_watchdog else "a run is refused"
            return f"failsafe: none: no register sets the device's output time-out, nor is it given: {then}"
        return (
            f"failsafe: the device sets 0 V after {modbus.device_watchdog_s * 1e3:g} ms of silence, as set on it "
            "(daq.modbus.device_watchdog_s): try it, pull the plug at 0.3 V"
        )
    if not is_plug_in(e):
        return (
            f"failsafe: the device sets 0 V after {e.daq.watchdog_s * 1e3:g} ms of silence "
            f"({e.daq.watchdog_s / e.period_s:.3g} periods), latched until it is armed again"
        )
    accepted = e.daq.accept_no_watchdog
    return "failsafe: the plug-in driver's; where its device has none, a run " + (
        "drives all the same (daq.accept_no_watchdog: true): have the motor's supply in reach"
        if accepted
        else "is refused"
    )


def _is_emulated(e: Experiment) -> bool:
    ports = MODBUS_EMULATED_PORTS if e.daq.driver == "modbus" else EMULATED_PORTS
    return e.daq.driver == "simulated" or e.daq.port in ports


def _backend_words(e: Experiment) -> str:
    if e.daq.driver == "simulated":
        return "a simulation in virtual time, no device, nothing moves"
    if e.daq.driver == "modbus":
        return _modbus_words(e)
    if e.daq.port == "emulated-chip":
        return f"the Uno's emulated chip with its firmware, {e.daq.baud} baud, virtual time, nothing moves"
    if e.daq.port == "emulated-chip-realtime":
        return f"the Uno's emulated chip with its firmware, {e.daq.baud} baud, real time, nothing moves"
    if e.daq.port == "emulated":
        return f"an emulated device behind a pseudo-terminal, {e.daq.baud} baud, real time, nothing moves"
    if is_plug_in(e):
        return f"plug-in driver {e.daq.driver}: take it for a REAL MOTOR"
    return f"a REAL MOTOR behind the serial port {e.daq.port}, {e.daq.baud} baud"


def _modbus_words(e: Experiment) -> str:
    unit = 1 if e.daq.modbus is None else e.daq.modbus.unit
    if e.daq.port == "emulated-tcp":
        return f"an emulated I/O block, Modbus TCP on this machine, unit {unit}, real time, nothing moves"
    rtu = f"Modbus RTU, unit {unit}, {e.daq.baud} baud"
    if e.daq.port == "emulated-virtual":
        return f"an emulated I/O block, {rtu}, virtual time, nothing moves"
    if e.daq.port == "emulated":
        return f"an emulated I/O block behind a pseudo-terminal, {rtu}, real time, nothing moves"
    link = f"Modbus TCP, unit {unit}" if is_tcp(e.daq.port) else rtu
    return f"a REAL MOTOR behind {e.daq.port}, {link}"


def _stage_lines(e: Experiment) -> Iterator[str]:
    """The stages with the longest times to expect; strokes and pauses double the time of a ramp."""
    b, r = e.breakaway, e.relay
    breakaway_s = 3.0 * b.rest_s + 2.0 * 2.0 * b.max_V / b.ramp_V_s
    total_s = breakaway_s
    yield f"stage breakaway: {b.ramp_V_s:g} V/s each way, up to {b.max_V:g} V; at most about {breakaway_s:.0f} s"
    if r.target is not None:
        amplitudes = r.target.amplitude_rad, r.target.amplitude_rad * r.second_ratio
        tests_s = 2.0 * r.cycles * r.target.period_s
        speed = _peak_speed_rad_s(max(amplitudes), r.target.period_s)
        yield (
            f"stage excite: searches gains for {r.target.amplitude_rad:g} rad every {r.target.period_s:g} s, "
            f"+-{r.target.tolerance:.0%}; at most {r.search.timeout_s:g} s"
        )
        yield (
            f"stage relay: {r.cycles} settled cycles at {amplitudes[0]:.3g} and at {amplitudes[1]:.3g} rad, "
            f"up to about {speed:.2g} rad/s; about {tests_s:.0f} s and the settling"
        )
        total_s += r.search.timeout_s + tests_s
    elif r.gains is not None:
        pairs = ", ".join(f"({g.h1_V:g}, {g.h2_V:g})" for g in r.gains)
        yield f"stage relay: {r.cycles} settled cycles at each of (h1, h2) = {pairs} V; their period is not known yet"
    if r.hysteretic is not None:
        pairs = ", ".join(f"({h.d_V:+g}, {h.eps_rad:g})" for h in r.hysteretic)
        widest_rad = max(h.eps_rad for h in r.hysteretic)
        overshoot = sum(rad for _, rad in _overshoot_terms(e))
        horizon_s = sum(rad for _, rad in _stopping_terms(e)) / e.limits.max_speed_rad_s
        yield (
            f"stage hysteretic: from rest at zero, where the shaft is brought before each, (d, eps) = {pairs} V, rad; "
            f"at most to {widest_rad + overshoot:.3g} rad; the guard would brake above "
            f"{(_room_rad(e) - widest_rad) / horizon_s:.3g} rad/s; every d must exceed the breakaway level, which is "
            "measured first"
        )
    yield "stage identify: by every method, no motion"
    if e.tracking is None:
        yield "stage verify: left out, there is no section `tracking`"
    else:
        verify_s = len(e.tracking.methods) * e.tracking.duration_s
        total_s += verify_s
        yield (
            f"stage verify: tracking with the models of {', '.join(e.tracking.methods)}, "
            f"{e.tracking.duration_s:g} s each; {verify_s:.0f} s"
        )
    unknown = "" if r.target is not None and r.hysteretic is None else ", and the relay tests"
    clock = " of virtual time" if e.daq.driver == "simulated" else ""
    yield f"together: at most about {total_s:.0f} s{clock}{unknown}, and settling and rests"


# ---------------------------------------------------------------------- words


def _problem(key: str, message: str, hint: str = "") -> Problem:
    return Problem(tuple(key.split(".")), message, hint)


def _interval(interval: tuple[float, float]) -> str:
    return f"[{interval[0]:.4g}, {interval[1]:.4g}]"


def _at_most(volts: float) -> str:
    return f"at most {volts:g} volts"


def _floor(value: float) -> float:
    """Three digits, rounded down: a hint that is followed must pass."""
    return float(f"{value * 0.995:.3g}")
