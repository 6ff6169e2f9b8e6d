"""The breakaway check on random motors: what the shaft turns unseen, and whether it is seen where the sensor is sound.

    python tools/unseen_travel.py [MOTORS]

K and tau are those of the campaign's grid, friction is 0.05 to 1.0 V and differs by up to a tenth between the ways;
breakaway.max_V is 2.4 times friction, reached in 3 s each way, as in config/demo.yaml.

Each motor whose sensor is stuck runs again with one tick late, at the two worst places, by as much as the device's
watchdog lets pass, and with a host that dies there.
"""

from __future__ import annotations

import math
import random
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rig import config
from rig.campaign.random_motors import draw
from rig.config.schema import MotorSection as DataSheet
from rig.control.breakaway import BreakawayCheck
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.model.friction import Friction
from rig.model.motor import Motor, State
from rig.running.experiment.stages import breakaway_check
from rig.running.preflight.breakaway_strokes import FRICTION_DIFFERS, UNSEEN_RAD, breakaway_strokes

ROOT = Path(__file__).resolve().parent.parent
FRICTION_V = (0.05, 1.0)
MAX_OVER_FRICTION = 2.4
RAMP_S = 3.0
NOISE_RAD, LSB_RAD = 0.003, 4.2 / 1024
LATENCY_S = 0.0012


class Trial(NamedTuple):
    """One motor, and the config that suits its friction."""

    motor: Motor
    experiment: config.Experiment


class Stroke(NamedTuple):
    """A stroke as it ran: its last tick; where the shaft stood before, rad; its way, +1 or -1; its largest drive, V."""

    last_tick: int
    from_rad: float
    way: int
    level_V: float


class Seen(NamedTuple):
    """How a check ended, and how far the shaft was from the start.

    end         the fault's code, or "moves"
    time_s      that it took
    travel_rad  the farthest from the start
    left_rad    where it stands at the end
    law         the check
    strokes     in order
    """

    end: str
    time_s: float
    travel_rad: float
    left_rad: float
    law: BreakawayCheck
    strokes: tuple[Stroke, ...]


def trials(motors: int, seed: int = 1) -> Iterator[Trial]:
    """Random motors, each with its config."""
    demo = config.load(ROOT / "config/demo.yaml")
    grid = config.load_campaign(ROOT / "config/campaign.yaml")
    rng = np.random.default_rng(seed)
    for number in range(motors):
        one = draw(grid, number)
        friction_V = float(rng.uniform(*FRICTION_V))
        plus_V = friction_V * (1.0 + FRICTION_DIFFERS * float(rng.uniform(-1.0, 1.0)))
        minus_V = 2.0 * friction_V - plus_V
        motor = Motor(one.tau_s, one.K_rad_s_V, Friction(plus_V, minus_V, plus_V, minus_V))
        yield Trial(motor, suited(demo, one.K_rad_s_V * (demo.drive.supply_V - friction_V), friction_V))


def suited(demo: config.Experiment, no_load_speed_rad_s: float, friction_V: float) -> config.Experiment:
    """The demo's config for a motor of that speed and friction."""
    max_V = MAX_OVER_FRICTION * friction_V
    return demo.model_copy(
        update={
            "motor": DataSheet(no_load_speed_rad_s=no_load_speed_rad_s),
            "breakaway": demo.breakaway.model_copy(update={"max_V": max_V, "ramp_V_s": max_V / RAMP_S}),
        }
    )


def check(
    motor: Motor,
    law: BreakawayCheck,
    period_s: float,
    seed: int,
    *,
    stuck: bool,
    late: Mapping[int, float] | None = None,
    watchdog_s: float = math.inf,
    freezes_s: float = math.inf,
    lost: Callable[[int, int], bool] = lambda stroke, tick: False,
) -> Seen:
    """Run a breakaway law on a motor in virtual time, its potentiometer sound or ``stuck``.

    late        tick, and by how much it comes late, s; the ticks after it come when they are due
    watchdog_s  silence of the host after which the device sets 0 V, latched: the check ends with DEVICE_WATCHDOG
    freezes_s   time from which on a sound sensor shows the same reading; travel then counts from there
    lost        whether the device never takes the drive of a stroke's tick, by numbers from 0; it holds the last one
    """
    noise, late = random.Random(seed), late or {}
    state, u_V, t_u_s, tick, low, high, end = State(), 0.0, math.nan, 0, 0.0, 0.0, "moves"
    frozen_rad, from_rad, was_V, begun = None, 0.0, 0.0, 0
    strokes: list[Stroke] = []

    def advance(drive_V: float, time_s: float) -> None:
        nonlocal state, low, high
        state = motor.advance(state, drive_V, time_s)
        low, high = min(low, state.y), max(high, state.y)

    try:
        while not law.finished:
            y_rad = (0.0 if stuck else state.y) + noise.gauss(0.0, NOISE_RAD)
            y_rad = math.floor(y_rad / LSB_RAD + 0.5) * LSB_RAD if not stuck else 0.0
            t_s = tick * period_s + late.get(tick, 0.0)
            if t_s >= freezes_s and frozen_rad is None:
                frozen_rad, from_rad = y_rad, state.y
                low = high = state.y
            y_rad = y_rad if frozen_rad is None else frozen_rad
            asked_V = law.step(Sample(t_s, y_rad, 512, math.nan, t_u_s, u_V, tick))
            if asked_V != 0.0 and was_V == 0.0:
                begun = tick
                strokes.append(Stroke(tick, state.y, 1 if asked_V > 0.0 else -1, 0.0))
            if asked_V != 0.0:
                strokes[-1] = strokes[-1]._replace(last_tick=tick, level_V=abs(asked_V))
            loses = asked_V != 0.0 and lost(len(strokes) - 1, tick - begun)
            tick += 1
            while tick * period_s <= t_s:  # skipped, as the loop does
                tick += 1
            until_s = tick * period_s + late.get(tick, 0.0)
            advance(u_V, LATENCY_S)
            was_V = asked_V
            if not loses:
                u_V, t_u_s = asked_V, t_s + LATENCY_S
            silent = u_V != 0.0 and until_s - t_s >= watchdog_s
            advance(u_V, min(until_s - t_s, watchdog_s if silent else math.inf) - (0.0 if silent else LATENCY_S))
            if silent:
                raise Fault("DEVICE_WATCHDOG")
    except Fault as fault:
        end = fault.code
        advance(0.0, 40.0 * motor.tau_s)
    return Seen(end, tick * period_s, max(high - from_rad, from_rad - low), state.y, law, tuple(strokes))


def worst_places(motor: Motor, seen: Seen, late_s: float) -> list[int]:
    """The ticks that end the two strokes which reach farthest if they last so much longer."""

    def reach_rad(stroke: Stroke) -> float:
        friction = motor.friction
        friction_V = friction.static_plus_V if stroke.way > 0 else friction.static_minus_V
        return abs(stroke.from_rad + stroke.way * motor.K_rad_s_V * max(stroke.level_V - friction_V, 0.0) * late_s)

    farthest = sorted(seen.strokes, key=reach_rad, reverse=True)
    return [stroke.last_tick + 1 for stroke in farthest[:2]]


def with_late_tick(motor: Motor, e: config.Experiment, seed: int, seen: Seen) -> list[Seen]:
    """The check of a stuck sensor, with one tick late by what the watchdog lets pass, and with a host that dies."""
    strokes = breakaway_strokes(e)
    assert strokes is not None
    most_s = strokes.watchdog_s - e.period_s - 0.0001
    return [
        check(
            motor, breakaway_check(e), e.period_s, seed, stuck=True, late={tick: late_s}, watchdog_s=strokes.watchdog_s
        )
        for tick in worst_places(motor, seen, most_s)
        for late_s in (0.4 * e.period_s, 0.6 * e.period_s, most_s, 1.0)
    ]


def main(motors: int) -> int:
    """Print the numbers; 1 where a shaft turns farther than it may."""
    refused = 0
    ends: Counter[str] = Counter()
    unseen, late, over, times = [], [], [], []
    for number, (motor, e) in enumerate(trials(motors)):
        if breakaway_strokes(e) is None:
            refused += 1
            continue
        stuck = check(motor, breakaway_check(e), e.period_s, number, stuck=True)
        sound = check(motor, breakaway_check(e), e.period_s, number, stuck=False)
        unseen.append(stuck.travel_rad)
        late.append(max(run.travel_rad for run in with_late_tick(motor, e, number, stuck)))
        ends[sound.end] += 1
        if sound.end == "moves":
            times.append(sound.time_s)
            friction = motor.friction
            over += [sound.law.plus_V - friction.static_plus_V, sound.law.minus_V - friction.static_minus_V]
    print(f"{motors} motors, {refused} configs refused")
    for what, travels_rad in (
        ("sensor stuck", unseen),
        ("and a tick late, or a host that dies, at the worst place", late),
    ):
        print(
            f"  {what}: turned at most {max(travels_rad):.3f} rad unseen, median {np.median(travels_rad):.3f} rad;",
            end=" ",
        )
        print(f"more than {UNSEEN_RAD:g} rad: {sum(x > UNSEEN_RAD for x in travels_rad)}")
    print(f"  sensor sound: {', '.join(f'{end} {count}' for end, count in ends.items())};", end=" ")
    print(f"levels above static friction by {1e3 * np.median(over):.0f} mV (median),", end=" ")
    print(f"{1e3 * np.quantile(over, 0.9):.0f} mV (90 %); {np.median(times):.1f} s (median)")
    return int(max(*unseen, *late) > UNSEEN_RAD)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 500))
