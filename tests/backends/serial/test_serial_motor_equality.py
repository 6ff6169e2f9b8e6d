"""The bench in C equals the bench in Python: motion, stops, potentiometer, wiring."""

from __future__ import annotations

import ctypes
import itertools
import math
import random
import statistics
from dataclasses import replace
from statistics import fmean, pstdev
from typing import Any

import pytest
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from real_motors import CASES, FRAME, relay, with_parts

from rig.backends.emulated.errors import EmulationError
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.frames import Code, Kind, Setup, encode, pack_ack, pack_arm, pack_drive
from rig.core.calibration import DriveMap
from rig.model.bench import BenchModel, BenchParameters, DriveWiring, SensorWiring
from rig.model.friction import Friction, coulomb, tustin
from rig.model.motor import Motor, State
from rig.model.real_motor import Frame, MovingMotor, RealMotor

WHERE, REAL = ctypes.POINTER(ctypes.c_double), ctypes.c_double
NO_STOPS = (-1e6, 1e6)


class Board(VirtualBoard):
    """A board whose bench and sensor can be asked by themselves."""

    def motion(self, v_rad_per_s: float, y_rad: float, u_V: float, dt_s: float) -> tuple[float, float]:
        """Velocity and position after ``dt_s`` of constant drive, by the motor alone; the board is untouched."""
        v, y = ctypes.c_double(v_rad_per_s), ctypes.c_double(y_rad)
        error = self._of("virtual_motion", ctypes.c_char_p, WHERE, WHERE, REAL, REAL)(
            self._board, ctypes.byref(v), ctypes.byref(y), u_V, dt_s
        )
        if error is not None:
            raise EmulationError(error.decode())
        return v.value, y.value

    def real_motion(
        self, state: tuple[float, ...] | None, u_V: float, t_s: float, dt_s: float
    ) -> tuple[tuple[float, ...], float]:
        """State and reading of a motor with parts ``dt_s`` after ``t_s`` of constant drive; the board is untouched.

        state   v, y, f, w and x, as in ``rig.core.motor_numbers``; None: at rest at the start
        """
        numbers = (ctypes.c_double * 6)(*(state or ()))
        when = (ctypes.c_double * 2)(t_s, dt_s)
        error = self._of("virtual_real_motion", ctypes.c_char_p, WHERE, ctypes.c_int32, REAL, WHERE)(
            self._board, numbers, state is not None, u_V, when
        )
        if error is not None:
            raise EmulationError(error.decode())
        return tuple(numbers[:5]), numbers[5]

    def position_counts(self) -> int:
        """One conversion of the position channel now; takes a number from the noise."""
        counts: int = self._of("virtual_position_counts", ctypes.c_int32)(self._board)
        return counts

    def _of(self, name: str, result: Any, *arguments: Any) -> Any:
        """A function of the library (firmware/boards/host/virtual.c)."""
        function = getattr(self._library, name)
        function.restype, function.argtypes = result, [ctypes.c_void_p, *arguments]
        return function


@st.composite
def motors(draw: st.DrawFn) -> Motor:
    plus, minus = draw(st.floats(0.0, 2.0)), draw(st.floats(0.0, 2.0))
    ratio = draw(st.floats(1.0, 2.0))
    stribeck = draw(st.sampled_from([0.0, 0.0, 0.03, 0.3, 3.0]))
    viscous = draw(st.sampled_from([0.0, 0.02, 0.3]))
    friction = Friction(plus, minus, plus * ratio, minus * ratio, stribeck, viscous)
    return Motor(draw(st.floats(0.02, 2.0)), draw(st.floats(0.1, 50.0)), friction, draw(st.floats(-0.5, 0.5)))


steps = st.lists(st.tuples(st.floats(-12.0, 12.0), st.floats(0.0, 3.0)), min_size=1, max_size=8)


@settings(max_examples=examples(100), deadline=None)
@given(motors(), st.floats(-20.0, 20.0), st.floats(-2.0, 2.0), steps)
def test_motion_with_stops_equals_small_steps_of_the_python_bench(
    motor: Motor, v0: float, y0: float, sequence: list[tuple[float, float]]
) -> None:
    """The Python bench meets a stop at the end of a step, up to one step late; the C one at the exact instant."""
    parameters = BenchParameters(motor, stop_rad=(-2.1, 2.3), supply_V=12.0, drive_counts=32767)
    board = Board(parameters)
    bench = BenchModel(parameters, 1)
    bench.state = State(v0, y0)
    v, y = v0, y0
    total_s = sum(dt_s for _, dt_s in sequence)
    n = 100
    fastest = abs(v0) + motor.K_rad_s_V * 15.0
    for u_V, dt_s in sequence:
        bench.pin_counts = round(u_V / 12.0 * 32767)
        v, y = board.motion(v, y, bench.motor_V, dt_s)
        for _ in range(n):
            bench.advance(dt_s / n)
    assert -2.1 <= y <= 2.3
    assert abs(y - bench.state.y) <= 2.0 * fastest * total_s / n + 1e-9


def test_a_stop_is_met_at_the_exact_instant_and_left_at_once() -> None:
    motor = Motor(0.2, 5.0)
    board = Board(BenchParameters(motor, stop_rad=(-1.0, 1.0)))
    # from rest at 0 under 1 V: y = 5 (t - 0.2 (1 - exp(-t/0.2))) reaches 1 rad here
    t_s = 0.0
    for _ in range(60):
        t_s -= (5.0 * (t_s - 0.2 * (1.0 - math.exp(-t_s / 0.2))) - 1.0) / (5.0 * (1.0 - math.exp(-t_s / 0.2)) or 1.0)
    assert board.motion(0.0, 0.0, 1.0, t_s * (1 - 1e-9))[0] > 0.0
    assert board.motion(0.0, 0.0, 1.0, t_s * (1 + 1e-9)) == (0.0, 1.0)
    assert board.motion(0.0, 0.0, 1.0, 100.0) == (0.0, 1.0)  # pressed against it
    inward = board.motion(0.0, 1.0, -1.0, 0.3)
    expected = motor.advance(State(0.0, 1.0), -1.0, 0.3)
    assert inward == pytest.approx((expected.v, expected.y), abs=1e-12)
    # a shaft that arrives against inward drive is stopped dead, then driven off, within one call
    v, y = board.motion(20.0, 0.9, -1.0, 0.5)
    assert y < 1.0 and v < 0.0


def board_with(real: RealMotor, frame: Frame, **bench: Any) -> Board:
    """A board whose motor has the parts of ``real``."""
    at_rest_V = real.fc_V + real.static_V + real.stribeck_V
    friction = tustin(real.fc_V, at_rest_V, real.stribeck_rad_s)
    plain_motor = Motor(real.tau_s, real.K_rad_s_V, friction, real.bias_V)
    return Board(BenchParameters(plain_motor, real=real, frame=frame, **bench))


@pytest.mark.parametrize("names", CASES.values(), ids=CASES)
def test_a_motor_with_parts_in_c_is_the_one_of_the_model(names: tuple[str, ...]) -> None:
    real, frame = with_parts(*names)._replace(delay_s=0.0), FRAME._replace(start_s=0.0)
    if "stribeck" in names:  # the bench has one level at rest
        real = real._replace(static_V=0.0)
    board, moving = board_with(real, frame, start_rad=0.1, stop_rad=NO_STOPS), MovingMotor(real, frame, 0.1)
    edges, levels = relay(2.0)
    state: tuple[float, ...] | None = None
    for (begin, end), u_V in zip(itertools.pairwise([*edges, 2.5]), levels, strict=True):
        for now, after in itertools.pairwise([begin, begin + 0.3 * (end - begin), end]):
            state, reading = board.real_motion(state, float(u_V), float(now), float(after - now))
            moving.advance(float(u_V), float(now), float(after - now))
            assert state == pytest.approx(tuple(moving.state), rel=1e-9, abs=1e-9)
            assert reading == pytest.approx(moving.reading_rad, rel=1e-9, abs=1e-9)


def test_a_motor_with_parts_is_stopped_at_a_stop_and_driven_off_it() -> None:
    real = with_parts("backlash", "lag", "force_over_position")
    board = board_with(real, FRAME, stop_rad=(-1.0, 1.0))
    state, reading = board.real_motion(None, 3.0, 0.0, 1.0)
    assert state[:2] == (0.0, 1.0)
    assert reading == pytest.approx(1.0 - 0.5 * real.backlash_rad, abs=1e-12)
    state, reading = board.real_motion(state, -3.0, 1.0, 0.1)
    assert state[0] < 0.0 and state[1] < 1.0
    assert reading == pytest.approx(state[1] + 0.5 * real.backlash_rad, abs=1e-12)


def test_a_board_reads_the_sensors_side_of_the_backlash() -> None:
    real = with_parts("backlash")
    board = board_with(real, FRAME, rad_per_count=1e-4, counts_max=65535, centre_counts=30000.0)
    assert board.position_counts() == 30000
    board.place(0.5, 0.0)
    assert board.position_counts() == 30000 + 5000 - 100


def _board_at(y_rad: float, **parameters: Any) -> Board:
    motor = Motor(0.17, 6.5, coulomb(0.5))
    return Board(replace(BenchParameters(motor, start_rad=y_rad), **parameters), 3)


@settings(max_examples=examples(100), deadline=None)
@given(
    st.floats(-2.6, 2.6),
    st.floats(-0.3, 0.3),
    st.sampled_from([4.2 / 1024, -4.2 / 1024, 0.001, 0.1]),
    st.floats(0.0, 4095.0),
    st.sampled_from([255, 1023, 4095]),
)
def test_quantisation_is_the_python_benchs(
    y_rad: float, offset_rad: float, rad_per_count: float, centre: float, counts_max: int
) -> None:
    parameters = BenchParameters(
        Motor(0.17, 6.5, coulomb(0.5)),
        start_rad=y_rad,
        offset_rad=offset_rad,
        rad_per_count=rad_per_count,
        centre_counts=centre,
        counts_max=counts_max,
    )
    assert Board(parameters).position_counts() == BenchModel(parameters, 1).read_counts()


def test_noise_of_the_potentiometer() -> None:
    lsb, sigma, n = 4.2 / 1024, 0.006, 40_000
    y_rad, offset_rad = 0.3217, 0.02
    board = _board_at(y_rad, noise_rad=sigma, offset_rad=offset_rad)
    readings = [board.position_counts() for _ in range(n)]
    position = [(counts - 512.0) * lsb for counts in readings]
    sd = math.sqrt(sigma**2 + lsb**2 / 12.0)
    assert abs(statistics.fmean(position) - (y_rad + offset_rad)) < 4.5 * sd / math.sqrt(n)
    assert statistics.pstdev(position) == pytest.approx(sd, rel=4.5 / math.sqrt(2 * n))
    mean = statistics.fmean(position)
    lag_1 = sum((a - mean) * (b - mean) for a, b in itertools.pairwise(position)) / (n * sd**2)
    assert abs(lag_1) < 4.5 / math.sqrt(n)  # white
    fourth = sum((x - mean) ** 4 for x in position) / (n * sd**4)
    assert fourth == pytest.approx(3.0, abs=0.15)  # normal


def test_noise_repeats_with_its_seed() -> None:
    parameters = BenchParameters(Motor(0.17, 6.5, coulomb(0.5)), noise_rad=0.02)

    def readings(seed: int) -> list[int]:
        board = Board(parameters, seed)
        return [board.position_counts() for _ in range(200)]

    assert readings(5) == readings(5)
    assert readings(5) != readings(6)


@pytest.mark.parametrize(("y_rad", "rail"), [(2.55, 1023), (-2.55, 0)])
def test_readings_end_at_the_rails(y_rad: float, rail: int) -> None:
    board = _board_at(y_rad, noise_rad=0.003)
    assert {board.position_counts() for _ in range(200)} == {rail}


@pytest.mark.parametrize(
    ("drive", "sensor"),
    [
        *((drive, "ok") for drive in ("ok", "reversed", "dead", "stuck_on")),
        *(("ok", sensor) for sensor in ("reversed", "broken_low", "broken_high", "stuck", "jumped")),
        ("reversed", "reversed"),
    ],
)
@pytest.mark.parametrize("fault_after_s", [0.0, 0.0437])
def test_wiring_is_the_python_benchs(drive: DriveWiring, sensor: SensorWiring, fault_after_s: float) -> None:
    """The same drives at the same instants: motor voltage, motion and readings agree, before and after the fault."""
    friction = Friction(0.45, 0.5, 0.5, 0.55)
    parameters = BenchParameters(
        Motor(0.17, 6.5, friction, 0.03),
        start_rad=0.2,
        drive=drive,
        sensor=sensor,
        fault_after_s=fault_after_s,
        rad_per_count=-4.2 / 1024,
    )
    board, bench = Board(parameters), BenchModel(parameters, 1)
    board.write(encode(Kind.SETUP, 1, Setup(1, 2, 1021, 0, 1023, 512, 799, 1000, 1).pack()))
    board.write(encode(Kind.ACK, 1, pack_ack(Code.RESET)))
    board.sleep_until(0.01)
    arm = encode(Kind.ARM, 2, pack_arm(1))
    board.write(arm)
    armed_s = 0.01 + len(arm) * round(11e9 / 115200) * 1e-9
    board.sleep_until(armed_s)
    assert board.truth().armed
    bench.advance(armed_s)
    bench.arm()
    last_s = armed_s
    rng = random.Random(4)
    for k in range(12):
        units = rng.randint(-150, 150)
        frame = encode(Kind.DRIVE, 3 + k, pack_drive(units))
        board.write(frame)
        board.sleep_until(last_s + 0.010)
        truth = board.truth()
        if not truth.armed:  # a broken wire: the firmware stops by itself
            assert sensor in ("broken_low", "broken_high") and truth.pin_V == 0.0
            break
        bench.advance(truth.pin_changed_s - last_s)
        bench.pin_counts = units
        bench.advance(board.now_s() - truth.pin_changed_s)
        last_s = board.now_s()
        assert truth.motor_V == bench.motor_V
        assert truth.y_rad == pytest.approx(bench.state.y, abs=1e-9)
        assert truth.v_rad_per_s == pytest.approx(bench.state.v, abs=1e-9)
        if sensor != "stuck":  # which holds the first reading that each takes after the fault, at its own instant
            assert board.position_counts() == bench.read_counts()
    else:
        assert sensor not in ("broken_low", "broken_high")
        assert bench.faulty


def test_a_coasting_bridge_is_the_python_benchs() -> None:
    """Motion under drives of every share, 0 V among them."""
    friction = Friction(0.45, 0.5, 0.5, 0.55, 0.0, 0.02)
    parameters = BenchParameters(Motor(0.17, 6.5, friction, 0.03), start_rad=0.2, coasting=True, bridge_drop_V=1.4)
    board, bench = Board(parameters), BenchModel(parameters, 1)
    board.write(encode(Kind.SETUP, 1, Setup(1, 2, 1021, 0, 1023, 512, 799, 1000, 1).pack()))
    board.write(encode(Kind.ACK, 1, pack_ack(Code.RESET)))
    board.sleep_until(0.01)
    board.write(encode(Kind.ARM, 2, pack_arm(1)))
    board.sleep_until(0.02)
    bench.advance(0.02)
    last_s = 0.02
    for k, units in enumerate((90, 0, -150, -1, 0, 200, 0)):
        board.write(encode(Kind.DRIVE, 3 + k, pack_drive(units)))
        board.sleep_until(last_s + 0.04)
        truth = board.truth()
        assert truth.armed
        bench.advance(truth.pin_changed_s - last_s)
        bench.pin_counts = units
        bench.advance(board.now_s() - truth.pin_changed_s)
        last_s = board.now_s()
        assert truth.y_rad == pytest.approx(bench.state.y, abs=1e-9)
        assert truth.v_rad_per_s == pytest.approx(bench.state.v, abs=1e-9)


@pytest.mark.parametrize("turned", [False, True])
def test_the_bridge_is_the_python_benchs(turned: bool) -> None:
    """Drop, dead bands and direction: the same voltage at the motor for every drive, to the last digit."""
    parameters = BenchParameters(
        Motor(0.17, 6.5, Friction(0.45, 0.5, 0.5, 0.55)),
        supply_V=10.0,
        bridge_drop_V=1.4,
        dead_band_plus=0.03,
        dead_band_minus=0.05,
        reversed=turned,
    )
    board, bench = Board(parameters), BenchModel(parameters, 1)
    believed = DriveMap(10.0, 1.4, 0.03, 0.05, reversed=turned)
    board.write(encode(Kind.SETUP, 1, Setup(1, 2, 1021, 0, 1023, 512, 799, 1000, 1).pack()))
    board.write(encode(Kind.ACK, 1, pack_ack(Code.RESET)))
    board.sleep_until(0.01)
    board.write(encode(Kind.ARM, 2, pack_arm(1)))
    board.sleep_until(0.02)
    for k, units in enumerate((0, 1, 23, 24, 40, 200, -1, -39, -40, -200)):
        board.write(encode(Kind.DRIVE, 3 + k, pack_drive(units)))
        board.sleep_until(board.now_s() + 0.010)
        bench.pin_counts = units
        assert board.truth().armed
        assert board.truth().motor_V == bench.motor_V
        assert bench.motor_V == pytest.approx(believed.to_volts(units), rel=1e-12)
        assert board.truth().pin_V == pytest.approx(units / 799 * 10.0)


def test_a_noisy_sensor_spreads_by_25_counts_in_both_benches() -> None:
    board = _board_at(0.2)
    board.rewire(sensor="noisy")
    bench = BenchModel(
        BenchParameters(Motor(0.17, 6.5, Friction(0.5, 0.5, 0.5, 0.5)), start_rad=0.2, sensor="noisy"), 1
    )
    bench.arm()
    for reading in (board.position_counts, bench.read_counts):
        counts = [reading() for _ in range(4000)]
        assert fmean(counts) == pytest.approx(512 + 0.2 / (4.2 / 1024), abs=2.0)
        assert pstdev(counts) == pytest.approx(25.0, rel=0.05)


def test_a_stuck_sensor_holds_its_reading() -> None:
    board = _board_at(0.2)
    board.rewire(sensor="stuck")
    held = board.position_counts()
    board.place(-0.7)
    assert board.position_counts() == held
    board.rewire()
    assert board.position_counts() != held


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"start_rad": 3.0}, "between"),
        ({"drive_counts": 40000}, "drive-counts"),
        ({"noise_rad": -1.0}, "noise-rad"),
        ({"noise_rad": math.nan}, "finite"),
        ({"counts_max": 100_000}, "counts-max"),
    ],
)
def test_parameters_out_of_range_are_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(EmulationError, match=words):
        _board_at(0.0, **changes)
