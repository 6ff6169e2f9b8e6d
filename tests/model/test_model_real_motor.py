"""Real motors: each part held to scipy's solver of differential equations, derivatives to differences."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from real_motors import CASES, EACH, FRAME, PLAIN, relay, with_parts
from scipy.integrate import solve_ivp
from synthetic import motor as plain_motor

from rig.core.motor_numbers import NUMBERS
from rig.model.friction import tustin
from rig.model.motor import Motor, State
from rig.model.real_motor import PARTS, Frame, MovingMotor, RealMotor, index, plain
from rig.model.sensitivity import Theta, position_and_jacobian
from shared.pieces import Pieces, response, response_and_jacobian

Record = tuple[tuple[np.ndarray, np.ndarray], np.ndarray, Pieces]

DURATION_S = 5.0


class Reference:
    """The equations of docs/theory.md 12.1 as they stand there, by DOP853 with events."""

    def __init__(self, motor: RealMotor, frame: Frame) -> None:
        self.m, self.frame = motor, frame

    def drive(self, u: float) -> float:
        m = self.m
        after = math.copysign(max(abs(u) - m.dead_band_V, 0.0), u)
        after *= 1.0 + m.gain_by_sign * np.sign(after)
        return float(after * (1.0 - m.sag_per_V * abs(after)))

    def level(self, speed: float, y: float, t: float) -> float:
        m, f = self.m, self.frame
        mean = math.sin(f.half_travel_rad) / f.half_travel_rad
        q = y - f.centre_rad
        total = m.fc_V * (1.0 + m.drift * ((t - f.start_s) / f.duration_s - 0.5))
        total += m.friction_sin_V * math.sin(q) + m.friction_cos_V * (math.cos(q) - mean)
        return total + (m.stribeck_V * math.exp(-speed / m.stribeck_rad_s) if m.stribeck_V else 0.0)

    def force(self, y: float) -> float:
        m, f = self.m, self.frame
        mean = math.sin(f.half_travel_rad) / f.half_travel_rad
        q = y - f.centre_rad
        total = m.force_sin_V * math.sin(q) + m.force_cos_V * (math.cos(q) - mean)
        return (
            total
            + m.cogging_sin_V * math.sin(m.cogging_per_rad * y)
            + m.cogging_cos_V * math.cos(m.cogging_per_rad * y)
        )

    def torque(self, w: float, v: float) -> float:
        m = self.m
        off = 1.0 - min(abs(w) / m.full_drive_V, 1.0) if m.free_between > 0.0 else 0.0
        drives = w - (1.0 - m.free_between * off) * (1.0 - m.viscous_share) * v / m.K_rad_s_V
        passed = 1.0 - m.runs_free if w == 0.0 else 1.0
        passed *= 1.0 - m.no_brake if w * drives <= 0.0 else 1.0
        return passed * drives / (1.0 + m.source_per_V2 * w * w)

    def load(self, w: float, v: float, y: float) -> float:
        return self.m.load_friction * abs(self.torque(w, v) + self.m.load_outside * self.force(y))

    def rate(self, t: float, x: np.ndarray, sign: float, D: float) -> list[float]:
        m = self.m
        v, y, f, w = x
        drive = w if m.lag_s else D
        friction = f if m.bristle_V_rad else sign * self.level(sign * v, y, t)
        pull = self.torque(drive, v) + (1.0 - m.viscous_share) * v / m.K_rad_s_V - sign * self.load(drive, v, y)
        pull += m.bias_V - self.force(y) - friction
        pull -= m.viscous_by_direction_V_s_rad * sign * v + m.drag_V_s2_rad2 * sign * v * v
        bend = m.bristle_V_rad and m.bristle_V_rad * (v - sign * v * f / self.level(sign * v, y, t))
        lag = (D - w) / m.lag_s if m.lag_s else 0.0
        return [(m.K_rad_s_V * pull - v) / m.tau_s, v, bend, lag]

    def pull_at_rest(self, x: np.ndarray, D: float) -> float:
        drive = x[3] if self.m.lag_s else D
        return self.torque(drive, 0.0) + self.m.bias_V - self.force(x[1])

    def direction(self, t: float, x: np.ndarray, D: float) -> float:
        if x[0] != 0.0:
            return float(np.sign(x[0]))
        pull = self.pull_at_rest(x, D)
        if self.m.bristle_V_rad:
            pull -= x[2]
            if abs(pull) < 1e-13:
                pull = D - x[3] if self.m.lag_s else 0.0
            return float(np.sign(pull)) if abs(pull) > 1e-13 else 0.0
        held = self.level(0.0, x[1], t) + self.m.static_V + self.load(x[3] if self.m.lag_s else D, 0.0, x[1])
        return float(np.sign(pull)) if abs(pull) > held else 0.0

    def sensed(self, x: np.ndarray) -> np.ndarray:
        m, f = self.m, self.frame
        share = (x - f.centre_rad) / f.half_travel_rad
        line = 3.0 / math.pi
        return np.asarray(
            x
            + m.linearity_sin1_rad * (np.sin(math.pi * share) - line * share)
            + m.linearity_cos1_rad * np.cos(math.pi * share)
            + m.linearity_sin2_rad * (np.sin(2.0 * math.pi * share) + 0.5 * line * share)
            + m.linearity_cos2_rad * np.cos(2.0 * math.pi * share)
        )

    def readings(self, edges: np.ndarray, levels: np.ndarray, t_s: np.ndarray, y0: float) -> np.ndarray:
        """Readings from rest at ``y0``, the play in its middle, the bristles in balance with the drive."""
        m = self.m
        bounds = [t_s[0], *[e + m.delay_s for e in edges if t_s[0] < e + m.delay_s < t_s[-1]], t_s[-1] + 1e-9]
        w = self.drive(levels[0])
        at = np.array([0.0, y0, 0.0, w])
        if m.bristle_V_rad:
            at[2] = self.pull_at_rest(at, w)
            assert abs(at[2]) < self.level(0.0, y0, t_s[0])
        out, side = np.empty(t_s.size), y0
        for now, end in pairwise(bounds):
            last = int(np.searchsorted(edges + m.delay_s, 0.5 * (now + end), side="right")) - 1
            D = self.drive(levels[max(last, 0)])
            while now < end:
                sign = self.direction(now, at, D)
                if sign == 0.0:
                    now, at = self.held((now, end), at, D, (t_s, out, side))
                    continue
                now, at, side = self.moving((now, end), at, D, sign, (t_s, out, side))
        return self.sensed(out)

    def held(
        self, span: tuple[float, float], at: np.ndarray, D: float, record: tuple[np.ndarray, np.ndarray, float]
    ) -> tuple[float, np.ndarray]:
        (now, end), (t_s, out, side) = span, record
        m = self.m
        until = end

        def at_time(t: float) -> np.ndarray:
            w = D + (at[3] - D) * math.exp(-(t - now) / m.lag_s) if m.lag_s else D
            return np.array([0.0, at[1], at[2], w])

        if not m.bristle_V_rad and (m.lag_s or m.drift):
            grid = np.linspace(now, end, 4001)
            free = [t for t in grid if self.direction(t, at_time(t), D) != 0.0]
            if free:
                low, high = max(now, free[0] - (grid[1] - grid[0])), free[0]
                for _ in range(60):
                    middle = 0.5 * (low + high)
                    low, high = (low, middle) if self.direction(middle, at_time(middle), D) != 0.0 else (middle, high)
                until = high
        after = at_time(until)
        rows = (t_s >= now) & (t_s < until)
        out[rows] = side
        return until, after

    def moving(
        self, span: tuple[float, float], at: np.ndarray, D: float, sign: float,
        record: tuple[np.ndarray, np.ndarray, float],
    ) -> tuple[float, np.ndarray, float]:  # fmt: skip
        (now, end), (t_s, out, side) = span, record

        def stops(t: float, x: np.ndarray) -> float:
            return float(x[0]) if t > now + 1e-9 else sign

        stops.terminal, stops.direction = True, -sign  # type: ignore[attr-defined]
        solved = solve_ivp(
            lambda t, x: self.rate(t, x, sign, D), (now, end), at, "DOP853", dense_output=True, events=stops,
            rtol=1e-11, atol=1e-13, max_step=0.02,
        )  # fmt: skip
        until, after = float(solved.t[-1]), solved.y[:, -1].copy()
        if solved.status == 1:
            after[0] = 0.0
        rows = (t_s >= now) & (t_s < until)
        half = 0.5 * self.m.backlash_rad
        if rows.any():
            assert solved.sol is not None
            y = solved.sol(t_s[rows])[1]
            out[rows] = np.maximum(side, y - half) if sign > 0.0 else np.minimum(side, y + half)
        side = max(side, after[1] - half) if sign > 0.0 else min(side, after[1] + half)
        return until, after, side


@pytest.mark.parametrize(
    "names",
    [
        pytest.param(names, id=case, marks=[pytest.mark.evidence] if k % 8 else [])
        for k, (case, names) in enumerate(CASES.items())
    ],
)
def test_readings_are_those_of_scipy(names: tuple[str, ...]) -> None:
    motor = with_parts(*names)
    edges, levels = relay(DURATION_S)
    t_s = np.arange(0.0, DURATION_S, 0.01)
    y = response(motor, FRAME, (edges, levels), t_s, Pieces.one(0.0, 0.1))
    assert np.ptp(y) > 0.5
    assert y == pytest.approx(Reference(motor, FRAME).readings(edges, levels, t_s, 0.1), abs=1e-6)


def three_pieces(rows: int) -> Pieces:
    """A record that starts at rest, and goes on twice in motion, once each way."""
    starts = np.array([0, rows // 3, 2 * rows // 3]), np.array([0.0, 2.0, -1.0]), np.array([0.1, 0.3, 0.2])
    way = np.array([0.0, 1.0, -1.0])
    return Pieces(*starts, way, way)


def difference(motor: RealMotor, place: int, record: Record) -> np.ndarray:
    """Derivative of the readings by one number: central; from one side, of second order, at the end of its range."""
    size = 1e-4 if place == index("bristle_V_rad") else 1e-7 * max(1.0, abs(motor[place]))

    def at(steps: float) -> np.ndarray:
        numbers = list(motor)
        numbers[place] += steps * size
        return response(RealMotor(*numbers), FRAME, *record)

    if motor[place] < size and NUMBERS[RealMotor._fields[place]].least == 0.0:
        return np.asarray((4.0 * at(1.0) - 3.0 * at(0.0) - at(2.0)) / (2.0 * size))
    return np.asarray((at(1.0) - at(-1.0)) / (2.0 * size))


ABSENT = PLAIN._replace(stribeck_rad_s=0.3, cogging_per_rad=12.0, full_drive_V=2.5)
NO_SLOPE_AT_ZERO = ("bristle_V_rad", "stribeck_rad_s", "cogging_per_rad")


@pytest.mark.parametrize("names", [*CASES.values(), ()], ids=[*CASES, "no part yet"])
def test_derivatives_are_those_of_differences(names: tuple[str, ...]) -> None:
    motor = with_parts(*names) if names else ABSENT
    free = [k for k, name in enumerate(motor._fields) if (motor[k] if names else name not in NO_SLOPE_AT_ZERO)]
    t_s = np.arange(0.0, 3.0, 0.01)
    pieces = three_pieces(t_s.size)
    drive = relay(3.0)
    readings = response_and_jacobian(motor, FRAME, drive, t_s, pieces, free)
    assert readings.y_rad == pytest.approx(response(motor, FRAME, drive, t_s, pieces), abs=1e-9)
    for column, place in enumerate(free):
        slope = readings.by_number[:, column]
        numeric = difference(motor, place, (drive, t_s, pieces))
        assert slope == pytest.approx(numeric, abs=1e-4 * np.abs(slope).max() + 1e-7), motor._fields[place]
    moving = slice(int(pieces.first_row[1]), None)  # the first piece is held: its start decides whether it is
    for column, key in enumerate(("v0_rad_per_s", "y0_rad")):
        above, below = (
            response(motor, FRAME, drive, t_s, replace(pieces, **{key: getattr(pieces, key) + step}))
            for step in (1e-6 * np.sign(pieces.v0_rad_per_s), -1e-6 * np.sign(pieces.v0_rad_per_s))
        )
        numeric = (above - below)[moving] / 2e-6 * np.repeat([1.0, -1.0], t_s.size // 3)
        slope = readings.by_start[moving, column]
        assert slope == pytest.approx(numeric, abs=1e-4 * np.abs(slope).max()), key


def test_of_a_sagging_stage_more_drive_gives_no_less() -> None:
    motor, place = PLAIN._replace(sag_per_V=0.4), index("sag_per_V")
    t_s = np.arange(0.0, 3.0, 0.01)
    pieces, (edges, levels) = three_pieces(t_s.size), relay(3.0)
    found = response_and_jacobian(motor, FRAME, (edges, levels), t_s, pieces, [place])
    most = edges, np.clip(levels, -1.25, 1.25)
    assert found.y_rad == pytest.approx(response(motor, FRAME, most, t_s, pieces), abs=1e-9)
    numeric = difference(motor, place, ((edges, levels), t_s, pieces))
    assert found.by_number[:, 0] == pytest.approx(numeric, abs=1e-4 * np.abs(numeric).max())


@pytest.mark.parametrize(
    "names", [("dead_band",), ("bristle", "lag"), ("stribeck", "force_over_position")], ids="-".join
)
def test_waves_of_the_force_are_the_cogging_of_each_order(names: tuple[str, ...]) -> None:
    motor, drive, orders = with_parts(*names), relay(3.0), (3.0, 7.5, 12.0)
    t_s = np.arange(0.0, 3.0, 0.01)
    pieces = three_pieces(t_s.size)
    fc, *parts = map(RealMotor._fields.index, ("fc_V", "cogging_sin_V", "cogging_cos_V"))
    found = response_and_jacobian(motor, FRAME, drive, t_s, pieces, [fc], orders)
    for k, order in enumerate(orders):
        alone = response_and_jacobian(motor._replace(cogging_per_rad=order), FRAME, drive, t_s, pieces, [fc, *parts])
        columns = found.by_number[:, [0, 1 + 2 * k, 2 + 2 * k]]
        assert columns == pytest.approx(alone.by_number, abs=1e-4 * float(np.abs(alone.by_number).max()))
        assert found.by_start == pytest.approx(alone.by_start, abs=1e-4)
    with pytest.raises(ValueError, match="without cogging"):
        response_and_jacobian(with_parts("cogging"), FRAME, drive, t_s, pieces, [fc], orders)


def test_a_piece_is_the_record_from_its_start_on() -> None:
    motor = with_parts("lag", "sag", "drift", "force_over_position")
    drive = relay(4.0)
    t_s = np.arange(0.0, 4.0, 0.01)
    pieces = three_pieces(t_s.size)
    whole = response(motor, FRAME, drive, t_s, pieces)
    first = int(pieces.first_row[1])
    alone = response(motor, FRAME, drive, t_s[first:], Pieces.one(2.0, 0.3))
    assert whole[first : pieces.first_row[2]] == pytest.approx(alone[: pieces.first_row[2] - first], abs=1e-12)


@settings(max_examples=examples(25), deadline=None)
@given(
    st.floats(0.05, 0.6), st.floats(1.0, 10.0), st.floats(0.0, 0.7), st.floats(-0.1, 0.1), st.floats(0.0, 0.015),
    st.floats(0.2, 3.0), st.integers(0, 1000),
)  # fmt: skip
def test_without_parts_it_is_the_plain_motor(
    tau: float, K: float, fc: float, asym: float, delay: float, v0: float, seed: int
) -> None:
    edges, levels = relay(3.0, seed)
    t_s = np.arange(0.0, 3.0, 0.01)
    y, jacobian = position_and_jacobian(Theta(tau, K, fc, asym, delay, v0, 0.1), edges, levels, t_s)
    real = response_and_jacobian(
        RealMotor(tau, K, fc, asym, delay), FRAME, (edges, levels), t_s, Pieces.one(v0, 0.1), range(5)
    )
    assert real.y_rad == pytest.approx(y, abs=1e-9)
    assert np.hstack((real.by_number, real.by_start)) == pytest.approx(jacobian, abs=1e-7)


def test_a_stribeck_motor_is_the_polynomial_one() -> None:
    other = Motor(0.17, 6.5, tustin(0.4, 0.6, 0.3, 0.01), 0.02)
    edges, levels = relay(5.0)
    t_s = np.arange(0.0, 5.0, 0.01)
    y = response(plain(other), Frame(), (edges, levels), t_s, Pieces.one(0.0, 0.0))
    assert y == pytest.approx(other.response(State(), t_s, edges, levels)[:, 1], abs=1e-7)
    assert plain(plain_motor(fs_V=0.7)).static_V == pytest.approx(0.2)


MIRRORED = (
    "bias_V", "gain_by_sign", "viscous_by_direction_V_s_rad", "force_cos_V", "friction_sin_V", "cogging_cos_V",
    "linearity_cos1_rad", "linearity_cos2_rad",
)  # fmt: skip


@settings(max_examples=examples(20), deadline=None)
@given(st.sets(st.sampled_from(sorted(EACH)), max_size=5), st.integers(0, 1000))
def test_a_mirrored_motor_moves_as_the_mirror_image(names: set[str], seed: int) -> None:
    motor = with_parts(*names)
    mirrored = motor._replace(**{name: -getattr(motor, name) for name in MIRRORED})
    frame = FRAME._replace(centre_rad=0.0)
    edges, levels = relay(2.0, seed)
    t_s = np.arange(0.0, 2.0, 0.01)
    y = response(motor, frame, (edges, levels), t_s, Pieces.one(1.0, 0.2))
    assert response(mirrored, frame, (edges, -levels), t_s, Pieces.one(-1.0, -0.2)) == pytest.approx(-y, abs=1e-7)


@settings(max_examples=examples(20), deadline=None)
@given(st.sampled_from(("stribeck", "drag", "bristle", "friction_over_position", "drift", "cogging")), st.floats(1, 9))
def test_an_undriven_motor_comes_to_rest(name: str, v0: float) -> None:
    motor = with_parts(name)._replace(bias_V=0.0)
    t_s = np.linspace(0.0, 6.0, 600)
    y = response(motor, FRAME, (np.zeros(1), np.zeros(1)), t_s, Pieces.one(v0, 0.0))
    assert np.all(np.abs(y) < v0 * motor.tau_s + 0.02)
    assert y[-1] == pytest.approx(y[-2], abs=1e-6)


@settings(max_examples=examples(40), deadline=None)
@given(st.dictionaries(st.sampled_from(sorted(EACH)), st.floats(-3.0, 1.0), max_size=8), st.integers(0, 1000))
def test_any_mixture_of_parts_of_any_size_gives_numbers(sizes: dict[str, float], seed: int) -> None:
    numbers = {key: value * 10.0**size for name, size in sizes.items() for key, value in EACH[name].items()}
    motor, drive = PLAIN._replace(fc_V=1.0, **numbers), relay(2.0, seed)
    free = [index(name) for name in numbers] + list(range(5))
    t_s = np.arange(0.0, 2.0, 0.01)
    readings = response_and_jacobian(motor, FRAME, drive, t_s, three_pieces(t_s.size), free)
    assert all(np.isfinite(part).all() for part in readings)


def test_stiff_bristles_are_nearly_rigid() -> None:
    drive, t_s = relay(2.0), np.arange(0.0, 2.0, 0.01)
    rigid = response(PLAIN, FRAME, drive, t_s, Pieces.one(0.0, 0.1))
    away = [
        np.abs(response(PLAIN._replace(bristle_V_rad=stiff), FRAME, drive, t_s, Pieces.one(0.0, 0.1)) - rigid).max()
        for stiff in (100.0, 1e5, 1e6)
    ]
    assert away[0] > 2.0 * away[1]  # a shaft at rest swings on them, by some v (tau/(K sigma_0))^(1/2)
    assert away[1] == away[2]  # from 0.1 mrad of bending on they are not stiffer


@pytest.mark.parametrize("period_s", [0.005, 0.1])
def test_steps_are_given_to_what_turns_far_in_a_row_and_not_to_bristles_whose_level_is_nearly_gone(
    period_s: float,
) -> None:
    """A fit that tries such bristles would take hours over a record."""
    t_s, drive = np.arange(0.0, 3.0, period_s), (np.array([0.0, 1.0, 2.0]), np.array([6.0, -6.0, 6.0]))
    cogging = RealMotor(0.05, 10.0, 0.3)._replace(cogging_sin_V=0.1, cogging_per_rad=12.0)
    assert np.all(np.isfinite(response(cogging, FRAME, drive, t_s, Pieces.one())))
    gone = RealMotor(0.04, 9.0, 0.03)._replace(bristle_V_rad=28.0, friction_cos_V=-0.02)
    assert np.all(np.isnan(response(gone, FRAME, drive, t_s, Pieces.one())))


def test_every_part_has_numbers_and_every_number_has_a_part() -> None:
    plain_numbers = ("tau_s", "K_rad_s_V", "fc_V", "bias_V", "delay_s")
    of_parts = dict.fromkeys(name for names in PARTS.values() for name in names)  # two parts share one
    assert (*plain_numbers, *of_parts) == RealMotor._fields
    assert set(EACH) == set(PARTS)


def test_a_motor_that_drives_itself_on_without_end_has_no_readings() -> None:
    """A fit may try it. Without a bound its steps over a force over position become so short that no time passes."""
    runs_away = PLAIN._replace(viscous_by_direction_V_s_rad=-10.0 / PLAIN.K_rad_s_V, force_sin_V=0.01)
    t_s = np.linspace(0.0, 1.7 * PLAIN.tau_s, 100)
    given = runs_away, FRAME, (np.array([0.0]), np.array([3.0])), t_s, Pieces.one()
    assert np.all(np.isnan(response(*given)))
    found = response_and_jacobian(*given, [index("K_rad_s_V")])
    assert np.all(np.isnan(found.y_rad)) and np.all(np.isnan(found.by_number))


def test_a_motor_that_would_take_steps_without_end_is_given_up() -> None:
    stiff = PLAIN._replace(tau_s=1e-9, force_sin_V=0.2)
    t_s = 0.01 * np.arange(5.0)
    assert np.all(np.isnan(response(stiff, FRAME, (t_s, np.full(5, 1.0)), t_s, Pieces.one())))


@pytest.mark.parametrize("name", ["lag", "load_friction", "no_brake"])
def test_rows_many_time_constants_apart_read_as_those_of_closer_ones(name: str) -> None:
    """A step over all of them would lose its weights to rounding, and the torque that turns early in it."""
    motor = with_parts(name)._replace(tau_s=1e-3, fc_V=0.05, bias_V=0.2)
    drive = np.array([0.0, 0.5, 1.0, 1.5, 2.0]), np.array([6.0, -6.0, 0.0, -2.0, 6.0])
    t_s = np.arange(0.0, 3.0, 0.001)
    close, far = (response(motor, FRAME, drive, rows, Pieces.one(0.0, 0.1)) for rows in (t_s, t_s[::500]))
    assert far == pytest.approx(close[::500], abs=1e-6)


def test_numbers_out_of_range_are_refused() -> None:
    record = (np.zeros(1), np.zeros(1)), np.arange(3.0), Pieces.one()
    with pytest.raises(ValueError, match="backlash_rad must be at least 0"):
        response(PLAIN._replace(backlash_rad=-0.1), FRAME, *record)
    with pytest.raises(ValueError, match="finite"):
        response(PLAIN._replace(drift=math.nan), FRAME, *record)
    with pytest.raises(ValueError, match="half_travel_rad must be above 0"):
        response(PLAIN, Frame(half_travel_rad=0.0), *record)
    with pytest.raises(ValueError, match="increase from 0"):
        Pieces(np.array([1]), np.zeros(1), np.zeros(1))
    with pytest.raises(ValueError, match="one entry for each piece"):
        Pieces(np.array([0]), np.zeros(2), np.zeros(1))


@pytest.mark.parametrize("names", CASES.values(), ids=CASES)
def test_a_moving_motor_reads_as_its_response(names: tuple[str, ...]) -> None:
    motor = with_parts(*names)._replace(delay_s=0.0)
    edges, levels = relay(2.0)
    t_s = np.arange(0.0, 2.0, 0.01)
    expected = response(motor, FRAME, (edges, levels), t_s, Pieces.one(0.0, 0.1))
    moving, read = MovingMotor(motor, FRAME, 0.1), []
    for now, after in pairwise([*t_s, 2.0]):
        read.append(moving.reading_rad)
        inside = edges[(edges > now) & (edges < after)]
        for begin, end in pairwise([now, *inside, after]):
            u_V = levels[np.searchsorted(edges, begin, side="right") - 1]
            moving.advance(float(u_V), float(begin), float(end - begin))
    assert read == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("stribeck_rad_s", [1e-4, 0.003, 0.0075, 0.01])
def test_a_stribeck_effect_at_creeping_speeds_moves_as_compiled(stribeck_rad_s: float) -> None:
    """A step that is tried beyond standstill meets a friction of any size: it is cut there, and nothing is raised."""
    motor = PLAIN._replace(stribeck_V=0.03, stribeck_rad_s=stribeck_rad_s, delay_s=0.0)
    k = np.arange(400.0)
    u_V = np.where((k // 100) % 2 == 0, 1.3 * np.sign(np.sin(k / 11.0)), 0.62 * np.sin(k / 23.0))
    t_s = np.asarray(0.01 * k, dtype=np.float64)
    expected = response(motor, FRAME, (t_s, np.asarray(u_V, dtype=np.float64)), t_s, Pieces.one(0.0, 0.1))
    moving, read = MovingMotor(motor, FRAME, 0.1), []
    for tick, volts in enumerate(u_V.tolist()):
        read.append(moving.reading_rad)
        moving.advance(volts, 0.01 * tick, 0.01)
    assert read == pytest.approx(expected, abs=1e-6)


def test_a_motor_that_is_put_elsewhere_takes_its_sensor_along() -> None:
    moving = MovingMotor(with_parts("backlash"), FRAME, 0.0)
    moving.put(0.0, 0.5)
    assert moving.reading_rad == pytest.approx(0.49)
    moving.put(0.0, 0.485)
    assert moving.reading_rad == pytest.approx(0.49)
