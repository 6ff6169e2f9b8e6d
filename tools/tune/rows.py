"""One random motor: identified, a loop tuned on what was found, and that loop on the true motor."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from campaign_real.departing_bench import FASTEST_RAD_S, FORCE_MEMORY_S, LARGEST_V
from campaign_real.departing_motor import MovingShaft
from campaign_real.kinds import Case, Kind, case
from rig.config.campaign import Campaign
from rig.control.state_feedback import Loop
from rig.core.estimators import LEADING
from rig.design.tune.margins import controller_matrices, margins, motor_matrices
from rig.design.tune.prediction import predict, shown_of
from rig.design.tune.program import steps_alone
from rig.design.tune.trial import Sensing, driven
from rig.design.tune.tuning import LEAST, TuneError, Wish, motor_of, observer_of, tune
from rig.design.tune.uncertain import LinearMotor, UncertainMotor
from rig.identification import IdentifyError, identify

LOOPS: tuple[Loop, ...] = ("position", "velocity")
DRIFTS_OVER_S = 60.0
STEPS = {"position": 0.25, "velocity": 1.0}  # rad, rad/s


@dataclass(frozen=True)
class Row:
    """What came of one loop on one motor.

    outcome    tuned, refused (by the identification or by the tuning) or failed; ``reason`` says why
    bandwidth_1_s, bound_by   of the loop
    phase_deg, gain_dB        of the identified loop on the true motor
    promised_deg, promised_dB the worst case that was promised
    keeps      whether the true margins are those asked for
    overshoot_percent, low_percent, high_percent   on the true motor, and the predicted interval
    rise_s, rise_low_s, rise_high_s                the same of the rise
    """

    number: int
    kinds: tuple[str, ...]
    loop: Loop
    outcome: str
    reason: str = ""
    bandwidth_1_s: float | None = None
    bound_by: str = ""
    phase_deg: float | None = None
    gain_dB: float | None = None
    promised_deg: float | None = None
    promised_dB: float | None = None
    keeps: bool | None = None
    overshoot_percent: float | None = None
    low_percent: float | None = None
    high_percent: float | None = None
    rise_s: float | None = None
    rise_low_s: float | None = None
    rise_high_s: float | None = None
    seconds: float = 0.0

    @property
    def held(self) -> bool:
        """Whether the overshoot was inside its predicted interval."""
        if self.overshoot_percent is None or self.low_percent is None or self.high_percent is None:
            return False
        return self.low_percent <= self.overshoot_percent <= self.high_percent

    def as_json(self) -> dict[str, object]:
        """As a line of rows.jsonl."""
        return asdict(self)


class TrueShaft:
    """The true motor with its departures, as a trial drives it. It starts in the middle of the friction's drift."""

    def __init__(self, one: Case, seed: int) -> None:
        self._shaft = MovingShaft(one.motor, one.departures, (0.5 * DRIFTS_OVER_S, DRIFTS_OVER_S))
        self._offset_rad, self._random_V = one.bench.offset_rad, one.departures.random_V
        self._rng = np.random.default_rng(seed)
        self._force_V = 0.0

    def advance(self, u_V: float, t_s: float, dt_s: float) -> None:
        """As ``rig.design.tune.trial.Shaft``."""
        if dt_s <= 0.0:
            return
        if self._random_V > 0.0:
            keep = math.exp(-dt_s / FORCE_MEMORY_S)
            self._force_V *= keep
            self._force_V += math.sqrt(1.0 - keep**2) * self._random_V * self._rng.standard_normal()
        self._shaft.advance(u_V, self._force_V, t_s, dt_s)

    @property
    def reading_rad(self) -> float:
        """What a sensor without noise and steps shows."""
        return self._shaft.reading_rad + self._offset_rad


def rows_of(campaign: Campaign, number: int, kinds: Sequence[Kind]) -> list[Row]:
    """Both loops on motor ``number`` with these departures."""
    began = time.perf_counter()
    names = tuple(kind.name for kind in kinds)
    try:
        one = case(campaign, number, kinds)
        known = motor_of(identify(one.recordings(), (LEADING,)).answer)
    except (IdentifyError, TuneError) as error:
        return [Row(number, names, loop, "refused", error.cause) for loop in LOOPS]
    found = []
    for loop in LOOPS:
        row = _tried(one, known, Row(number, names, loop, "tuned"), campaign.seed)
        found.append(replace(row, seconds=time.perf_counter() - began))
        began = time.perf_counter()
    return found


def _tried(one: Case, known: UncertainMotor, row: Row, seed: int) -> Row:
    bench = one.bench
    sensing = Sensing(bench.period_s, bench.noise_rad, bench.lsb_rad, LARGEST_V)
    try:
        tuned = tune(known, sensing, Wish(row.loop, STEPS[row.loop], top_rad_s=FASTEST_RAD_S))
    except TuneError as error:
        return replace(row, outcome="refused", reason=error.cause)
    truth = LinearMotor(one.truth.tau_s, one.truth.K_rad_s_V, one.departures.lag_s, bench.delay_s)
    true = margins(
        controller_matrices(known.linear, observer_of(known, sensing), tuned.gains, sensing.period_s),
        motor_matrices(truth, sensing.period_s),
        sensing.period_s,
    )
    trial = steps_alone(tuned)
    prediction = predict(tuned, trial)
    program = trial.program()
    record = driven(
        TrueShaft(one, seed + one.number),
        tuned.law(program),
        sensing,
        bench.delay_s,
        program.duration_s,
        seed * 1_000_003 + one.number,
    )
    shown = shown_of(tuned, record, trial)
    overshoot, rise = prediction.overshoot, prediction.ranges["rise_s"]
    return replace(
        row,
        bandwidth_1_s=tuned.bandwidth_1_s,
        bound_by=tuned.bound_by,
        phase_deg=true.phase_deg,
        gain_dB=min(true.gain_dB, 99.0),
        promised_deg=tuned.worst.phase_deg,
        promised_dB=min(tuned.worst.gain_dB, 99.0),
        keeps=true.keep(LEAST),
        overshoot_percent=shown["overshoot_percent"],
        low_percent=overshoot.low,
        high_percent=overshoot.high,
        rise_s=shown["rise_s"],
        rise_low_s=rise.low,
        rise_high_s=rise.high,
    )
