"""The laws that a real motor may have beyond the plain one (docs/theory.md 12): a row each, with its sentences.

Their numbers are in the table of ``rig.core.motor_numbers``. A row says in words what the law may come from and what
tells it apart, and its bounds as multiples of the bench's drive, speed, friction and travel.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

from rig.core.motor_numbers import PARTS
from rig.identification.departures.departure import Bench, Departure, Start

EVEN, APART = 8, 1.05  # sizes of a dead band, evenly up to the largest; each over the one before, at least
VISCOUS, MOST_VISCOUS = 0.1, 0.9  # of 1/K: the rest is back-EMF
MOST_PER_RAD = 30.0
LONG_DELAY_S = 0.015
TAKEN = 0.19  # of the largest drive, at 95 %: a bridge of bipolar transistors takes 1.8 V (L298N, at 1 A) of 9.5 V
OF_POLES = 3.0  # per radian: from there on it is the poles, or teeth; below it is a shaft behind a gear, a cam, a cable
ROW_RAD = 1.5  # of a wave, from one row to the next at the mean speed: at twice that speed, more is beyond the samples
MOST_SLOW = 90  # starts below it: over a longer travel they would be too many
WAVES_PER_RAD = 6.0  # most of a friction over position
FREQUENCIES_HZ = (6.0, 7.5, 9.0, 11.0, 13.0, 16.0, 19.0, 28.0)  # slower ones are seen by eye
FREQUENCIES_RAD_S = tuple(2.0 * math.pi * hertz for hertz in FREQUENCIES_HZ)
DAMPINGS = (0.1, 0.25)  # of a belt alone; with what the motor's back-EMF takes where the load is half the mass
FREE = (0.4, 1.1)  # of 1/K, the back-EMF in it: a bridge brakes or does not; no viscous friction, and what a fit is off
_COASTING = "coasting at 0 V from several speeds, and a large drive that falls to a smaller one"
_SWEEPS = "slow sweeps over the travel both ways"
_REVERSALS = "drives of several sizes, with reversals; or the supply's voltage beside them"


def _from(law: str, *starts: float) -> Sequence[Start]:
    """Starts of a law of one number; 0 is a start without it."""
    (name,) = PARTS[law]
    return [{name: start} if start else {} for start in starts]


def _friction_V(bench: Bench) -> float:
    return max(bench.fc_V, min(0.02, bench.half_drive_V))


def _half_friction_V(bench: Bench) -> float:
    return max(0.5 * bench.fc_V, min(0.02, bench.half_drive_V))


def _sag_per_V(bench: Bench) -> float:
    """3 % per volt, and 15 % at the largest drive."""
    return min(0.03, 0.15 / bench.largest_V)


def _lags(bench: Bench) -> Sequence[Start]:
    """At 0 a lag is a delay, and a long delay may be a lag."""
    found = _from("lag", 0.003, 0.010)
    return found if bench.delay_s < LONG_DELAY_S else [*found, {"lag_s": bench.delay_s, "delay_s": 0.0}]


def _dead_bands(bench: Bench) -> Sequence[float]:
    """Where a drive is smaller than it may be: even steps, and close to each such drive, before and behind it."""
    largest = _least_pulse_V(bench)
    near = [share * drive for drive in bench.small_drives_V if drive < largest for share in (0.9, 1.1)]
    if not near:
        return ()
    even = (largest * (k + 0.5) / EVEN for k in range(EVEN))
    sizes = sorted([*(size for size in near if size < largest), *even])
    kept = sizes[:1]
    for size in sizes[1:]:  # between two that are nearly one, what a number moves by has no slope
        kept += [size] * (size > APART * kept[-1])
    return kept


def _least_pulse_V(bench: Bench) -> float:
    return min(0.1, bench.half_drive_V)


def _wave_V(bench: Bench) -> float:
    """Of friction over position: a fifth of the friction."""
    return max(0.2 * bench.fc_V, min(0.01, bench.half_drive_V))


def _free_between(bench: Bench, size: float) -> Start:
    """So large by the largest drive of the record, at which the motor stays as it is: at full drive it has less K."""
    by_full = size * bench.full_V / bench.largest_V
    brakes = 1.0 - size + by_full  # at full drive, over what brakes at the largest one
    found = {"free_between": by_full / brakes, "full_drive_V": bench.full_V}
    return found | {"tau_s": bench.tau_s / brakes, "K_rad_s_V": bench.K_rad_s_V / brakes}


def _most_per_rad(bench: Bench) -> float:
    return min(MOST_PER_RAD, ROW_RAD / max(bench.path_per_row_rad, 1e-9))


def _slow_orders(bench: Bench) -> list[float]:
    """Orders below those of poles; none where a radian or two of travel, or very many turns, do not show them."""
    step = 1.5 / bench.half_travel_rad
    count = math.ceil((OF_POLES - 2.0 * step) / step)
    return [(2 + k) * step for k in range(count)] if 0 < count <= MOST_SLOW else []


def orders(bench: Bench) -> list[float]:
    """Orders, 1/rad, from one period over the travel on, closer than half a period over it, as far as samples go.

    Beyond one turn those of poles are whole: a shaft's poles come again after each turn.
    """
    step, most = 1.5 / bench.half_travel_rad, _most_per_rad(bench)
    slow = [order for order in _slow_orders(bench) if order < min(OF_POLES, most)]
    if bench.half_travel_rad > math.pi:
        return slow + [float(order) for order in range(math.ceil(OF_POLES), int(most))]
    first = max(OF_POLES, 2.0 * step)
    return slow + [first + k * step for k in range(math.ceil((most - first) / step))]


def _order_limits(bench: Bench) -> Mapping[str, tuple[float, float]]:
    """Fewer are a force over position; more are beyond the samples."""
    fewest = min(_slow_orders(bench), default=max(OF_POLES, 3.0 / bench.half_travel_rad))
    return {"cogging_per_rad": (fewest, max(fewest, _most_per_rad(bench)))}


def _bristles(bench: Bench, *shares: float) -> list[float]:
    """V/rad of bristles that are bent fully by these shares of the half travel."""
    return [_friction_V(bench) / (share * bench.half_travel_rad) for share in shares]


DEPARTURES: list[Departure] = [
    Departure(
        "dead_band", "dead band of the drive", "a bridge whose transistors need a least pulse?",
        _least_pulse_V,  # a duty of 1 % at 12 V
        "a relay test with drives against the motion: h1 nearly as large as h2",
        # from sizes, too, that swallow a small drive whole: that is no longer linear
        trials=lambda bench: _from("dead_band", 0.0, 0.02 * bench.largest_V, 0.05 * bench.largest_V),
        sizes=_dead_bands, untold=lambda bench: TAKEN * bench.largest_V,
        shown=lambda bench: not bench.goes_along,  # where the drive always pushes, a dead band is friction
    ),
    Departure(
        "gain_by_sign", "gain that differs by sign",
        "two half bridges that are not alike? Or an encoder that loses counts one way?",
        lambda bench: 0.05, "two relay tests, one of them with an offset", both_ways=True,
    ),
    Departure("sag", "sag of the drive", "a supply with long leads, or a bridge that heats?", _sag_per_V),
    Departure(
        "lag", "lag of the drive", "an inductance, or a filter before the bridge, or of the readings?",
        lambda bench: 0.010, "faster samples, with the times at which the drive acts (t_u_s)",
        trials=_lags, largest=0.3,
    ),
    Departure(
        "viscous_by_direction", "viscous friction that differs by direction",
        "a gear or a screw under load? Or an encoder that loses counts one way?",
        lambda bench: 0.2 / bench.K_rad_s_V, both_ways=True,
    ),
    Departure(
        "static", "static friction", "a motor that has to be broken away?", _half_friction_V,
        "slow breakaway ramps both ways (`rig relay` with breakaway)",
        # from sizes, too: whether a shaft sticks has no derivative
        trials=lambda bench: _from("static", *(share * bench.fc_V for share in (0.0, 0.1, 0.25, 0.6)))
        if bench.fc_V > 0.0 else _from("static", 0.0),
        leaps=True,
    ),
    Departure(
        "stribeck", "Stribeck effect", "a bearing or a gear that runs dry?", _half_friction_V,
        "slow motion (a small relay test, or slow ramps)",
        trials=lambda bench: [{"stribeck_rad_s": share * bench.top_rad_s} for share in (0.03, 0.1, 0.3)],
        limits=lambda bench: {"stribeck_rad_s": (0.003 * bench.top_rad_s, bench.top_rad_s)},
    ),
    Departure(
        "drag", "drag with the square of the speed", "a fan, or oil?",
        lambda bench: 0.1 / (bench.K_rad_s_V * bench.top_rad_s),  # a tenth of the viscous friction, at top speed
    ),
    Departure(
        "bristle", "friction that yields before it slides", "a seal, a belt, or grease?",
        lambda bench: 100.0, "a small relay test with a fine sensor",
        trials=lambda bench: _from("bristle", *_bristles(bench, 0.03, 0.006)),
        # stiffer ones cannot be told from Coulomb friction
        limits=lambda bench: {name: (low, high) for name in PARTS["bristle"] for low, high in
                              [_bristles(bench, 0.3, 0.001)]},
    ),
    Departure(
        "force_over_position", "force over position", "an unbalanced load, a pendulum, or a cable?",
        lambda bench: min(0.1, bench.half_drive_V), _SWEEPS, over_position=True,
    ),
    Departure(
        "friction_over_position", "friction over position", "a shaft or a gear that is not true?", _wave_V, _SWEEPS,
        over_position=True,
    ),
    Departure(
        "cogging", "cogging", "the poles of the motor, the teeth of a gear, or a load behind one?",
        lambda bench: min(0.05, bench.half_drive_V), _SWEEPS,
        trials=lambda bench: [{"cogging_per_rad": order} for order in orders(bench)], limits=_order_limits,
        shown=lambda bench: bool(orders(bench)), over_position=True,
    ),
    Departure(
        "backlash", "backlash", "play between the motor and the sensor?", lambda bench: 0.010, "a finer sensor"
    ),
    Departure(
        "linearity", "linearity of the sensor", "a potentiometer, or its calibration?",
        lambda bench: bench.linearity_rad, "a calibration at more angles, or relay tests at two speeds",
        shown=lambda bench: bench.linearity_rad > 0.0,  # an encoder has none
    ),
    Departure(
        "drift", "drift of the friction", "a bench that warms up?", lambda bench: 0.15,
        "the same relay test again, after the bench has warmed up",
    ),
    Departure(
        "load_friction", "friction that grows with the torque", "a gear of several stages, or a worm?",
        lambda bench: 0.1, "strokes of several drives, with coasting at 0 V between them",
        # of the motor's torque alone, and of a force on the shaft as well
        trials=lambda bench: [{"viscous_share": VISCOUS, "load_outside": share} for share in (0.0, 1.0)],
        limits=lambda bench: {"viscous_share": (0.0, MOST_VISCOUS), "load_outside": (0.0, 1.0)},
        largest=0.6,  # of the torque: a gear that loses more hardly drives back
        valley=True,  # under one size of drive
        may_hide=False,  # few benches have it: beside a dead band it would make f_c of every relay test unknown to 1 %
    ),
    Departure(
        "source", "resistance of the supply", "a weak supply, long leads or a thin connector?",
        lambda bench: 0.05 / bench.largest_V**2, _REVERSALS,
        trials=lambda bench: [{"viscous_share": VISCOUS}],
        limits=lambda bench: {"viscous_share": (0.0, MOST_VISCOUS)},
        may_hide=False,  # a sag by the current is its line: see ``outside``
    ),
    Departure(
        "runs_free", "bridge that lets the motor run free at 0 V", "one that is switched off there?", lambda bench: 1.0,
        _COASTING, trials=lambda bench: _from("runs_free", 0.8), limits=lambda bench: {"runs_free": FREE},
        largest=FREE[1],
    ),
    Departure(
        "no_brake", "bridge that does not brake", "PWM at the enable of an L298, or a single transistor?",
        lambda bench: 1.0, _COASTING, trials=lambda bench: _from("no_brake", 0.8),
        limits=lambda bench: {"no_brake": FREE}, largest=FREE[1],
    ),
    Departure(
        "free_between", "bridge that lets the motor run free between its pulses", "slow PWM at the enable of an L298?",
        lambda bench: 0.1, "drives of several sizes, with coasting at 0 V between them",
        trials=lambda bench: [_free_between(bench, size) for size in (0.4, 0.8)],
        limits=lambda bench: {"free_between": (0.0, FREE[1])}, largest=FREE[1], held=("full_drive_V",), may_hide=False,
    ),
]  # fmt: skip

DRIFT_EACH: Final = Departure(
    "drift_each", "drift of the friction in the course of each recording",
    "a bench that warms up, and cools down between them?", lambda bench: 0.15,
    "one long recording after the bench has warmed up", numbers=PARTS["drift"], unit="1",
)  # fmt: skip
LEVEL_EACH: Final = "level_each"


def level_each(recordings: int) -> Departure:
    """A level of friction of its own in each recording, the mean is f_c: the drift of frames by ``Cut.with_levels``."""
    return Departure(
        LEVEL_EACH, "level of friction in each recording of its own, at most", "recordings of different days?",
        lambda bench: 0.15, "all of it in one recording", numbers=PARTS["drift"], unit="1", costs=recordings - 1,
        beyond=10.0,  # something else that differs between recordings may look like it: a dead band, another amplitude
    )  # fmt: skip


# Laws that a bench may have and the motor's model has not: lines of the budget only, see ``outside``.
SAG_BY_CURRENT: Final = Departure(
    "sag_by_current", "sag of the drive by the current", "a supply with long leads?", _sag_per_V, _REVERSALS,
    numbers=("sag_per_V",), unit="1/V", one_sided=True,
)  # fmt: skip
BEND: Final = Departure(
    "bend", "another bend of the drive", "a stage that gives less than its largest drive?",
    lambda bench: _sag_per_V(bench) / bench.largest_V, "drives of several sizes",
    numbers=("bend_per_V2",), unit="1/V2",
)  # fmt: skip
SOFT_COUPLING: Final = Departure(  # its size is one over the square of its frequency
    "soft_coupling", "soft coupling", "a belt, or a long shaft?", lambda bench: FREQUENCIES_RAD_S[0] ** -2,
    "quick reversals, with rows of a few milliseconds", numbers=("soft_coupling_s2",), unit="s2", one_sided=True,
    often=4.0,  # what turns with a motor hangs on a belt, a gear or a shaft
)  # fmt: skip
FRICTION_WAVE: Final = Departure(
    "friction_wave", "friction over position with a period of its own", "a gear, a cam or a cable?", _wave_V, _SWEEPS,
    numbers=("friction_wave_sin_V", "friction_wave_cos_V"), unit="V", over_position=True,
)  # fmt: skip
OUTSIDE: list[Departure] = [SAG_BY_CURRENT, BEND, SOFT_COUPLING, FRICTION_WAVE]
BY_NAME: dict[str, Departure] = {law.name: law for law in (*DEPARTURES, DRIFT_EACH, level_each(2), *OUTSIDE)}  # all
