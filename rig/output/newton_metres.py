"""Newton metres of a volt, from what a stated mass on an arm does to a motor (docs/servo.md, Newton metres). Pure.

Gravity turns the shaft by g m l, and the motor shows it as A volts: a = g m l / A. The mass adds m l^2 to the inertia,
and the motor shows it as more tau/K: a = m l^2 / (tau/K with it - tau/K without). Volts are the bench's own in both,
so an error of the supply is in neither the comparison, nor J, nor the friction; it is in kt.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from rig.core.estimators import MAIN
from rig.run_folder.results import Answer, FoundLawResult, JsonObject, known

GRAVITY_M_S2: Final = 9.81
_STEP: Final = 1e-4  # of a half width, for a derivative
_OVER_POSITION: Final = "force_over_position"
_OTHER_K: Final = 0.1  # by which K may differ with the load beyond all intervals, as where friction grows with torque

Inputs = Mapping[str, "Quantity"]
Formula = Callable[[Mapping[str, float]], float]


class Quantity(NamedTuple):
    """A number and its half width at 95 %, in the same unit."""

    value: float
    u95: float = 0.0

    @property
    def percent(self) -> float:
        """Its half width, % of it; inf where it is 0."""
        return 100.0 * self.u95 / abs(self.value) if self.value else math.inf


@dataclass(frozen=True)
class Load:
    """A small mass at the end of an arm, on a shaft that lies level.

    mass_kg   of the mass, > 0
    arm_m     from the axis to its centre, > 0
    rod_kg    of the arm, an even rod from the axis to the mass; 0: it weighs nothing
    Raises ValueError on numbers out of range.
    """

    mass_kg: Quantity
    arm_m: Quantity
    rod_kg: float = 0.0

    def __post_init__(self) -> None:
        least = min(self.mass_kg.value - self.mass_kg.u95, self.arm_m.value - self.arm_m.u95)
        halves = (self.mass_kg.u95, self.arm_m.u95, self.rod_kg)
        if not (least > 0.0 and all(0.0 <= one < math.inf for one in halves)):
            raise ValueError("mass and arm must be > 0 by more than their errors, and no error or rod is negative")


@dataclass(frozen=True)
class NewtonMetres:
    """What the load tells. None: not known.

    torque_N_m_V    a, of a volt of the bench; by the narrower of both ways
    by_gravity, by_inertia   a by each way, N m/V
    difference      their difference over a, with what both share left out, 1
    swing_m         length of the pendulum whose inertia and moment the motor shows, m: no mass is in it
    stated_swing_m  the same of the stated load
    inertia_kg_m2   J of the motor without the load, at the shaft
    friction_N_m    Coulomb friction; with no run without the load, with it
    damping_N_m_s_rad  what is proportional to speed: b + kt^2/R
    kt_N_m_A        a R; with the error of the supply
    verdict         ok; doubtful; refused: then there is no torque
    """

    verdict: str
    reasons: tuple[str, ...]
    torque_N_m_V: Quantity | None = None
    by_gravity: Quantity | None = None
    by_inertia: Quantity | None = None
    difference: Quantity | None = None
    swing_m: Quantity | None = None
    stated_swing_m: float | None = None
    inertia_kg_m2: Quantity | None = None
    friction_N_m: Quantity | None = None
    damping_N_m_s_rad: Quantity | None = None
    kt_N_m_A: Quantity | None = None

    def as_json(self) -> JsonObject:
        """All of it; null: not known."""
        found: JsonObject = {"ok": self.verdict == "ok", "verdict": self.verdict, "reasons": list(self.reasons)}
        for name in list(self.__dataclass_fields__)[2:]:
            value = getattr(self, name)
            found[name] = value._asdict() if isinstance(value, Quantity) else value
        return found


def newton_metres(
    loaded: Answer, load: Load, bare: Answer | None = None, R_ohm: Quantity | None = None
) -> NewtonMetres:
    """What a volt of this motor is in N m, by the run with the load, and by the one without it.

    loaded   with the load on the shaft, which lies level
    bare     without it; None: then gravity alone tells
    R_ohm    of the winding, measured; None: no kt
    Raises ValueError for an R that is not > 0.
    """
    if R_ohm is not None and not 0.0 < R_ohm.value < math.inf:
        raise ValueError("R must be a resistance, > 0 ohm")
    runs = {"with the load": loaded} | ({} if bare is None else {"without it": bare})
    unusable = [
        f"the run {which} has no usable answer" for which, one in runs.items() if one.is_refused or not _is_whole(one)
    ]
    if unusable:
        return NewtonMetres("refused", tuple(unusable))
    reasons = [f"the run {which} is doubtful" for which, one in runs.items() if one.verdict != "ok"]
    if bare is not None and (other := _other_motor(loaded, bare)) > 0.0:
        reasons.insert(0, _other_K(loaded, bare))
        if other > _OTHER_K:
            return NewtonMetres("refused", tuple(reasons))
    inputs = _inputs(loaded, load, bare, R_ohm)
    by_gravity, by_inertia = _by_gravity(inputs, reasons), _by_inertia(inputs, reasons)
    ways = [(way, formula) for way, formula in ((by_gravity, _gravity), (by_inertia, _inertia)) if way is not None]
    if not ways:
        return NewtonMetres("refused", tuple(reasons))
    torque, a = min(ways, key=lambda one: one[0].percent)
    difference = swing = None
    stated_m = _load_inertia(_values(inputs)) / (_load_moment(_values(inputs)) / GRAVITY_M_S2)
    if by_gravity is not None and by_inertia is not None:
        difference = _of(lambda x: (_gravity(x) - _inertia(x)) / _inertia(x), inputs)
        swing = _of(lambda x: GRAVITY_M_S2 * (x["with_V"] - x["without_V"]) / x["pull_V"], inputs)
        if abs(difference.value) > difference.u95:
            reasons.insert(0, _disagree(by_gravity, by_inertia, swing, stated_m))
            return NewtonMetres("refused", tuple(reasons), None, by_gravity, by_inertia, difference, swing, stated_m)
    else:
        reasons.append("one way alone: nothing shows whether it is right")
    return NewtonMetres(
        "doubtful" if reasons else "ok",
        tuple(reasons),
        torque,
        by_gravity,
        by_inertia,
        difference,
        swing,
        stated_m,
        _own_inertia(inputs, a),
        _of(lambda x: a(x) * x["fc_V"], inputs),
        _of(lambda x: a(x) / x["K"], inputs),
        None if R_ohm is None else _of(lambda x: a(x) * x["R_ohm"] / x["volt"], inputs),
    )


def _is_whole(answer: Answer) -> bool:
    """Whether it has the numbers of a motor, each with an interval: what has none is not exact."""
    tau_s, K, fc_V = (known(answer.value(name)) for name in MAIN)
    is_motor = 0.0 < tau_s < math.inf and 0.0 < K < math.inf and 0.0 <= fc_V < math.inf
    return is_motor and all(answer.at_95(name) is not None for name in MAIN)


def _other_motor(loaded: Answer, bare: Answer) -> float:
    """By how much K differs beyond both intervals, as a share of it: a load leaves K as it is."""
    one, other = (_number(answer, "K_rad_s_V") for answer in (loaded, bare))
    return (abs(one.value - other.value) - one.u95 - other.u95) / other.value - 1e-9


def _other_K(loaded: Answer, bare: Answer) -> str:
    with_it, without = (_number(answer, "K_rad_s_V") for answer in (loaded, bare))
    return (
        f"K is {with_it.value:.4g} (rad/s)/V with the load, {without.value:.4g} without it, and a load leaves K as it "
        "is: are both runs of one motor, with the same gear and supply"
    )


def _inputs(loaded: Answer, load: Load, bare: Answer | None, R_ohm: Quantity | None) -> dict[str, Quantity]:
    """All that the formulas take, by name; a name that is missing is not known."""
    alone = loaded if bare is None else bare
    inputs = {
        "mass_kg": load.mass_kg,
        "arm_m": load.arm_m,
        "rod_kg": Quantity(load.rod_kg),
        "with_V": inertia_V_s2_rad(loaded),
        "fc_V": _number(alone, "fc_V"),
        "K": _number(alone, "K_rad_s_V"),
        "volt": Quantity(1.0, _supply_error(alone)),
    }
    if bare is not None:
        inputs["without_V"] = inertia_V_s2_rad(bare)
    pull = _pull_of(loaded)
    if pull is not None and known(pull.value) > 0.0:
        low, high = map(known, pull.ci95 or (None, None))
        inputs["pull_V"] = Quantity(known(pull.value), math.hypot(0.5 * (high - low), _own_pull_V(bare)))
    if R_ohm is not None:
        inputs["R_ohm"] = R_ohm
    return inputs


def _pull_of(answer: Answer) -> FoundLawResult | None:
    return next((law for law in answer.law or () if law.name == _OVER_POSITION), None)


def _own_pull_V(bare: Answer | None) -> float:
    """Force over position without the load, V: nobody knows whether it adds to the load's, or takes from it."""
    own = None if bare is None else _pull_of(bare)
    return 0.0 if own is None else known(own.value)


def inertia_V_s2_rad(answer: Answer) -> Quantity:
    """tau/K: what the inertia takes of the drive, V s2/rad, of a usable answer.

    The scatter of tau and K counts with its correlation; what the tests do not exclude, without: its signs are unknown.
    """
    tau, gain = _number(answer, "tau_s"), _number(answer, "K_rad_s_V")
    share, halves = 0.0, []
    for name, one in (("tau_s", tau), ("K_rad_s_V", gain)):
        low, high = answer.interval(name) or (one.value, one.value)
        scatter = min(0.5 * (high - low), one.u95)
        halves.append(scatter / one.value)
        share += (one.u95**2 - scatter**2) / one.value**2
    correlation = answer.correlation_of("tau_s", "K_rad_s_V") or 0.0
    share += halves[0] ** 2 + halves[1] ** 2 - 2.0 * correlation * halves[0] * halves[1]
    ratio = tau.value / gain.value
    return Quantity(ratio, ratio * math.sqrt(max(share, 0.0)))


def _number(answer: Answer, name: str) -> Quantity:
    value = known(answer.value(name))
    low, high = answer.at_95(name) or (value, value)
    return Quantity(value, 0.5 * (high - low))


def _supply_error(answer: Answer) -> float:
    """By how much a volt of the bench may be off, 1: what u95_absolute of K has beyond scatter."""
    low, high = answer.interval("K_rad_s_V") or (0.0, 0.0)
    more = known((answer.u95_absolute or {}).get("K_rad_s_V")) ** 2 - (0.5 * (high - low)) ** 2
    return math.sqrt(more) / known(answer.K_rad_s_V) if more > 0.0 else 0.0


def _values(inputs: Inputs) -> dict[str, float]:
    return {name: one.value for name, one in inputs.items()}


def _of(formula: Formula, inputs: Inputs) -> Quantity:
    """A formula of the inputs, to first order: each is independent of the others."""
    values, square = _values(inputs), 0.0
    for name, one in inputs.items():
        if one.u95 > 0.0:
            step = _STEP * one.u95
            up, down = (formula(values | {name: one.value + s}) for s in (step, -step))
            square += ((up - down) / (2.0 * _STEP)) ** 2
    return Quantity(formula(values), math.sqrt(square))


def _load_moment(x: Mapping[str, float]) -> float:
    return GRAVITY_M_S2 * (x["mass_kg"] + 0.5 * x["rod_kg"]) * x["arm_m"]


def _load_inertia(x: Mapping[str, float]) -> float:
    return (x["mass_kg"] + x["rod_kg"] / 3.0) * x["arm_m"] ** 2


def _gravity(x: Mapping[str, float]) -> float:
    return _load_moment(x) / x["pull_V"]


def _inertia(x: Mapping[str, float]) -> float:
    return _load_inertia(x) / (x["with_V"] - x["without_V"])


def _by_gravity(inputs: Inputs, reasons: list[str]) -> Quantity | None:
    pull = inputs.get("pull_V")
    if pull is None:
        reasons.append("the run with the load shows no force over position: does the shaft lie level, and does it turn")
        return None
    if not pull.value > pull.u95:
        reasons.append("the interval of the pull, in volts, is not known, or has 0 in it")
        return None
    return _of(_gravity, inputs)


def _by_inertia(inputs: Inputs, reasons: list[str]) -> Quantity | None:
    if "without_V" not in inputs:
        return None
    more = _of(lambda x: x["with_V"] - x["without_V"], inputs)
    if not more.value > more.u95:
        reasons.append(
            f"tau/K is {more.value:.3g} V s2/rad more with the load, ± {more.u95:.2g}: take a larger mass, or more arm"
        )
        return None
    return _of(_inertia, inputs)


def _own_inertia(inputs: Inputs, a: Formula) -> Quantity | None:
    if "without_V" in inputs:
        return _of(lambda x: a(x) * x["without_V"], inputs)
    own = _of(lambda x: a(x) * x["with_V"] - _load_inertia(x), inputs)
    return own if own.value > 0.0 else None


def _disagree(by_gravity: Quantity, by_inertia: Quantity, swing: Quantity, stated_m: float) -> str:
    return (
        f"{by_gravity.value:.4g} N m/V by gravity, {by_inertia.value:.4g} by inertia: the motor shows a pendulum of "
        f"{swing.value:.3g} m (the mass does not count), and the stated load is one of {stated_m:.3g} m; so measure "
        "the arm again, and look whether a cable pulls. Else friction grows with the torque: then it has no newton "
        "metres"
    )
