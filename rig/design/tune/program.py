"""What a tuned loop is asked to do, in simulation and on a bench: a move, a step and back, a trajectory."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rig.control.set_point import InTurn
from rig.control.tuned import program_of
from rig.design.tune.tuning import Tuned, TuneError
from rig.run_folder.results import JsonObject

REST_S = 0.2  # before the step
FADE_S = 1.5  # of the trajectory
SHARE = 0.8  # of the travel that a trial may use
SINES_SHARE = 0.2  # of the travel: amplitude of the trajectory if none is given
TRACKING_S = 6.0
EDGE_S = 0.1  # of the trajectory's end that does not count: a smoothed speed has no rows beyond it


@dataclass(frozen=True)
class Room:
    """Where a trial takes place.

    low_rad, high_rad  the shaft's travel
    sines              pairs (amplitude rad, angular frequency rad/s) about 0 rad to track; empty: one in the middle
    """

    low_rad: float
    high_rad: float
    sines: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Trial:
    """A program, and where in it the step and the trajectory are.

    parts       as ``rig.control.tuned.program_of`` reads them
    step_s      begin and end of the step, s from the program's start
    tracking_s  begin and end of the trajectory, without its fading in and its last rows; None: there is none
    """

    parts: tuple[JsonObject, ...]
    step_s: tuple[float, float]
    tracking_s: tuple[float, float] | None = None

    def program(self) -> InTurn:
        """The set-points, made anew."""
        return program_of(self.parts)


def steps_alone(tuned: Tuned) -> Trial:
    """A rest, the step and the way back; of a speed: to, fro, and to rest."""
    parts = _steps(tuned)
    return Trial(tuple(parts), (REST_S, REST_S + tuned.each_s))


def whole_trial(tuned: Tuned, room: Room) -> Trial:
    """The shaft moves to where the step begins, rests, steps and steps back, and tracks.

    The step is in the middle of the travel. Raises TuneError where the travel is too short for it.
    """
    size, each_s = tuned.wish.step, tuned.each_s
    way_rad = size if tuned.wish.loop == "position" else size * each_s
    travel_rad = room.high_rad - room.low_rad
    if way_rad > SHARE * travel_rad:
        unit = "rad" if tuned.wish.loop == "position" else "rad/s"
        raise TuneError(
            f"the step takes {way_rad:.3g} rad, and the trial may use {SHARE * travel_rad:.3g} rad of the travel",
            f"give a smaller one: --step {0.95 * size * SHARE * travel_rad / way_rad:.2g} ({unit})",
        )
    centre_rad = 0.5 * (room.low_rad + room.high_rad)
    begin_rad = centre_rad - 0.5 * way_rad
    slow_1_s = _slow(tuned, travel_rad)
    move_s = 12.0 / slow_1_s
    tracking: JsonObject = {"kind": "sines", "duration_s": TRACKING_S, "fade_s": FADE_S}
    tracking["components"] = [list(one) for one in room.sines or _sines(tuned, travel_rad)]
    tracking["centre_rad"] = 0.0 if room.sines else centre_rad
    before_s = move_s + REST_S
    steps = _steps(tuned)
    after_s = move_s + sum(_lasts(part) for part in steps)
    parts: tuple[JsonObject, ...] = (
        {"kind": "move", "to_rad": begin_rad, "bandwidth_1_s": slow_1_s, "duration_s": move_s},
        *steps,
        tracking,
    )
    return Trial(parts, (before_s, before_s + each_s), (after_s + FADE_S, after_s + TRACKING_S - EDGE_S))


def _steps(tuned: Tuned) -> list[JsonObject]:
    bandwidth, each_s, size = tuned.bandwidth_1_s, tuned.each_s, tuned.wish.step
    rest: JsonObject = {"kind": "step", "step_rad": 0.0, "bandwidth_1_s": bandwidth, "duration_s": REST_S}
    if tuned.wish.loop == "position":
        both: list[JsonObject] = [
            {"kind": "step", "step_rad": one, "bandwidth_1_s": bandwidth, "duration_s": each_s} for one in (size, -size)
        ]
        return [rest, *both]
    return [rest, {"kind": "speeds", "speeds_rad_s": [size, -size, 0.0], "each_s": each_s, "bandwidth_1_s": bandwidth}]


def _lasts(part: Mapping[str, Any]) -> float:
    """How long a part lasts, s."""
    if part["kind"] == "speeds":
        return float(part["each_s"] * len(part["speeds_rad_s"]))
    return float(part["duration_s"])


def _slow(tuned: Tuned, travel_rad: float) -> float:
    """Bandwidth of the first move, rad/s: wherever it begins, it takes half the speed that the motor has at the drive
    that friction leaves.
    """
    linear, plain = tuned.motor.linear, tuned.motor.framed.motor
    spare_V = tuned.sensing.largest_V - plain.fc_V - abs(plain.bias_V)
    top_rad_s = 0.5 * min(linear.K_rad_s_V * spare_V, tuned.wish.top_rad_s)
    # a step of the model has its largest speed, step w / e, at 1/w
    return min(0.64 * math.e * top_rad_s / travel_rad, 0.5 * tuned.bandwidth_1_s, 0.5 / linear.tau_s)


def _sines(tuned: Tuned, travel_rad: float) -> Sequence[tuple[float, float]]:
    """A slow sine within the travel, at a fifth of the bandwidth, or less where the speed is bounded."""
    amplitude = SINES_SHARE * travel_rad
    return ((amplitude, min(0.2 * tuned.bandwidth_1_s, 0.4 * tuned.wish.top_rad_s / amplitude, 3.0)),)
