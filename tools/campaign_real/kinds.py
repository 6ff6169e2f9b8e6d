"""The kinds and sizes of departure, and one random motor of each: what is true of it, and its two relay tests."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from campaign_real.before_the_tests import Stretch, before_the_tests
from campaign_real.departing_motor import Bench, Departures, PlainMotor, Record, reading, relay_test
from rig.campaign.random_motors import Draw, draw
from rig.config.campaign import Campaign
from rig.run_folder.recording.recording import Recording, assembled, from_columns

Array = NDArray[np.float64]
Rng = np.random.Generator

SECOND = 0.5  # amplitude of the second test over that of the first
SETTLING, CYCLES = 3, 10  # cycles of each test: left out, and recorded
LONGEST_CYCLE = 1.8  # times the describing function's period
TURN = 2.0 * math.pi


@dataclass(frozen=True)
class Kind:
    """One kind of departure in one size.

    name    in the table
    law     what `rig identify` should name
    size    as a user would say it
    make    departures for a motor (K_rad_s_V, fc_V), random signs and phases
    """

    name: str
    law: str
    size: str
    make: Callable[[Rng, Draw], Departures]


def _sign(rng: Rng) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _phase(rng: Rng) -> float:
    return float(rng.uniform(0.0, TURN))


def _sized(make: Callable[[Rng, Draw, float], Departures], size: float, rng: Rng, one: Draw) -> Departures:
    return make(rng, one, size)


def _kinds() -> list[Kind]:
    found = [Kind("plain", "", "", lambda rng, one: Departures())]

    def add(law: str, sizes: Sequence[float], unit: str, make: Callable[[Rng, Draw, float], Departures]) -> None:
        for size in sizes:
            found.append(Kind(f"{law} {size:g}", law, f"{size:g} {unit}", partial(_sized, make, size)))

    add("dead_band", (0.02, 0.05, 0.1), "V", lambda r, o, s: Departures(dead_band_V=s))
    add("gain_by_sign", (1.0, 3.0, 10.0), "%", lambda r, o, s: Departures(gain_by_sign=0.005 * s * _sign(r)))
    add("sag", (1.0, 3.0), "%/V", lambda r, o, s: Departures(sag_per_V=0.01 * s))
    add("lag", (2.0, 5.0, 10.0), "ms", lambda r, o, s: Departures(lag_s=1e-3 * s))
    add(
        "viscous_by_direction",
        (3.0, 10.0, 20.0),
        "% of 1/K",
        lambda r, o, s: Departures(viscous_V_s_rad=0.01 * s * _sign(r) / o.K_rad_s_V),
    )
    add("static", (0.05, 0.1), "V", lambda r, o, s: Departures(static_V=s))
    add("stribeck", (0.05, 0.15), "V", lambda r, o, s: Departures(stribeck_V=s, stribeck_rad_s=r.uniform(0.1, 0.5)))
    add("drag", (0.01, 0.05), "v|v|/K", lambda r, o, s: Departures(drag_V_s2_rad2=s / o.K_rad_s_V))
    add("bristle", (30.0, 100.0), "V/rad", lambda r, o, s: Departures(bristle_V_rad=s))
    add("force_over_position", (0.02, 0.05, 0.2), "V", lambda r, o, s: Departures(force_V=s, force_phase_rad=_phase(r)))
    add(
        "friction_over_position",
        (5.0, 10.0, 20.0),
        "%",
        lambda r, o, s: Departures(friction_share=0.01 * s, friction_phase_rad=_phase(r)),
    )
    add(
        "cogging",
        (0.02, 0.05, 0.1),
        "V",
        lambda r, o, s: Departures(
            cogging_V=s, cogging_phase_rad=_phase(r), cogging_per_rad=float(r.choice([4.0, 6.0, 12.0]))
        ),
    )
    add("backlash", (3.0, 10.0), "mrad", lambda r, o, s: Departures(backlash_rad=1e-3 * s))
    add(
        "linearity",
        (3.0, 10.0, 30.0),
        "mrad",
        lambda r, o, s: Departures(
            linearity_rad=1e-3 * s, linearity_phase_rad=_phase(r), linearity_per_rad=float(r.uniform(1.0, 3.0))
        ),
    )
    add("drift", (5.0, 15.0), "%", lambda r, o, s: Departures(drift=0.01 * s * _sign(r)))
    add("random_force", (0.01, 0.03), "V", lambda r, o, s: Departures(random_V=s))
    return found


KINDS = _kinds()


@dataclass(frozen=True)
class Truth:
    """What is true of a bench in the units that its record has.

    K is the mean of both signs; f_c is the mean over travel, directions and record; radians are those of the line that
    fits the sensor best over the driven travel.
    """

    tau_s: float
    K_rad_s_V: float
    fc_V: float


@dataclass(frozen=True)
class Case:
    """One random bench.

    kinds     its departures; () for none
    records   two relay tests
    before    what a run drives before them, in times below theirs
    """

    number: int
    kinds: tuple[Kind, ...]
    departures: Departures
    motor: PlainMotor
    bench: Bench
    truth: Truth
    records: tuple[Record, Record]
    before: tuple[Stretch, ...] = ()

    def recordings(self) -> list[Recording]:
        """As `rig identify` reads them from two CSV files without t_u_s."""
        return [
            from_columns(Path(f"case-{self.number}-{k}.csv"), record.t_s, record.u_V, record.y_rad)
            for k, record in enumerate(self.records, 1)
        ]

    def run(self) -> Recording:
        """All records as those of one run, without t_u_s."""
        tests = [Stretch(f"relay-{k}", r.t_s, r.y_rad, r.u_V) for k, r in enumerate(self.records, 1)]
        stretches = [*self.before, *tests]
        columns = {name: np.concatenate([getattr(s, name) for s in stretches]) for name in ("t_s", "y_rad", "u_V")}
        stage = np.concatenate([np.full(s.t_s.size, s.stage) for s in stretches])
        rows = range(1, stage.size + 1)
        names = (*columns, "stage")
        return assembled(Path(f"case-{self.number}"), {**columns, "stage": stage}, rows, columns_present=names)


def case(campaign: Campaign, number: int, kinds: Sequence[Kind], *, whole_run: bool = False) -> Case:
    """Bench ``number`` with the departures of ``kinds``. The same motor has the same number, whatever departs.

    whole_run   whether to simulate the breakaway check and the gain search, too
    """
    one = draw(campaign, number)
    seeds = np.random.SeedSequence(campaign.seed, spawn_key=(number, 77))
    departures = departures_of(campaign, one, kinds)
    motor = PlainMotor(one.tau_s, one.K_rad_s_V, one.fc_V, one.asym_V)
    bench = Bench(
        campaign.sampling.period_s, one.delay_s, campaign.sensor.noise_rad, campaign.sensor.lsb_rad, one.offset_rad
    )
    h2_V = one.fc_V + SECOND * (one.h2_V - one.fc_V)
    gains = ((one.h1_V, one.h2_V), (0.95 * h2_V, h2_V))
    rows = math.ceil((SETTLING + CYCLES + 1) * LONGEST_CYCLE * one.period_s / bench.period_s)
    span = rows * bench.period_s
    first, second = (
        _recorded(relay_test(motor, departures, bench, gain, rows, (k * span, 2.0 * span), seed), k * span)
        for k, (gain, seed) in enumerate(zip(gains, seeds.spawn(2), strict=True))
    )
    seed = np.random.SeedSequence(campaign.seed, spawn_key=(number, 79))
    before = before_the_tests(motor, departures, bench, one, 2.0 * span, seed) if whole_run else ()
    return Case(
        number,
        tuple(kinds),
        departures,
        motor,
        bench,
        _truth(motor, departures, (first, second), before, 2.0 * span),
        (first, second),
        before,
    )


def departures_of(campaign: Campaign, one: Draw, kinds: Sequence[Kind]) -> Departures:
    """The departures of these kinds, with the random signs and phases that this motor has."""
    rng = np.random.default_rng(np.random.SeedSequence(campaign.seed, spawn_key=(one.number, 78)))
    departures = Departures()
    for kind in kinds:
        departures = _joined(departures, kind.make(rng, one))
    return departures


def _recorded(record: Record, begin_s: float) -> Record:
    """The rows of the wanted cycles, after the settling ones. Times are those of the run, which began the test then."""
    z = record.z_rad_s
    falls = np.flatnonzero((z[1:] < 0.0) & (z[:-1] >= 0.0))
    first = int(falls[SETTLING]) if falls.size > SETTLING else 0
    stop = int(falls[SETTLING + CYCLES]) + 2 if falls.size > SETTLING + CYCLES else z.size
    cut = slice(first, stop)
    return Record(
        begin_s + record.t_s[cut],
        record.y_rad[cut],
        record.u_V[cut],
        record.true_y_rad[cut],
        record.true_v_rad_s[cut],
        record.z_rad_s[cut],
    )


def _joined(a: Departures, b: Departures) -> Departures:
    """Both: what differs from the default in ``b`` replaces that of ``a``."""
    blank = Departures()
    changed = {f.name: getattr(b, f.name) for f in fields(b) if getattr(b, f.name) != getattr(blank, f.name)}
    return replace(a, **changed)


def _truth(
    motor: PlainMotor, d: Departures, records: Sequence[Record], before: Sequence[Stretch], whole_s: float
) -> Truth:
    """tau, K and f_c as they are defined for a bench with departures (docs/theory.md 12)."""
    travel = np.concatenate([record.true_y_rad for record in records])
    times_s = np.concatenate([*(stretch.t_s for stretch in before), *(record.t_s for record in records)])
    return truth_of(motor, d, (float(travel.min()), float(travel.max())), float(np.mean(times_s)) / whole_s)


def truth_of(motor: PlainMotor | Draw, d: Departures, travel_rad: tuple[float, float], course: float) -> Truth:
    """The same from the driven travel, rad, and the mean time of the record as a share of the drift's."""
    even = np.linspace(*travel_rad, 2001)
    slope = float(np.polyfit(even, reading(even, d), 1)[0])
    friction = motor.fc_V * (1.0 + d.friction_share * float(np.mean(np.sin(even + d.friction_phase_rad))))
    friction *= 1.0 + d.drift * (course - 0.5)
    return Truth(motor.tau_s, motor.K_rad_s_V * slope, friction)
