"""The serial driver against the compiled firmware, both in virtual time. The truth is read at the pin."""

import math
from typing import Any

import pytest
from evidence import evidence
from raised import fault_of
from virtual_host import BoardOptions

from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.virtual_board import BoardTruth, VirtualBoard
from rig.core.calibration import Calibration, DriveMap, Scaling, TachometerScale
from rig.core.signals import Limits, Sample
from rig.model.bench import BenchParameters
from rig.model.friction import Friction
from rig.model.motor import Motor

MOTOR = Motor(0.17, 6.5, Friction(0.5, 0.46, 0.54, 0.5), 0.01)
RAD_PER_COUNT = 4.2 / 1024
RISING = Calibration([(12, -500 * RAD_PER_COUNT), (1012, 500 * RAD_PER_COUNT)])
FALLING = Calibration([(12, 500 * RAD_PER_COUNT), (1012, -500 * RAD_PER_COUNT)])
DRIVE = DriveMap(supply_V=12.0)
LIMITS = Limits(soft_rad=(-1.1, 1.1), hard_rad=(-1.9, 1.9), max_u_V=3.0, watchdog_s=0.1)
PERIOD_S = 0.01


def make(
    board: VirtualBoard,
    calibration: Calibration = RISING,
    drive_map: DriveMap = DRIVE,
    tachometer: TachometerScale | None = None,
) -> SerialDriver:
    return SerialDriver(board, Scaling(calibration, drive_map, (5, 1018), tachometer=tachometer))


def armed(
    calibration: Calibration = RISING,
    drive_map: DriveMap = DRIVE,
    board_options: BoardOptions | None = None,
    **bench: Any,
) -> tuple[VirtualBoard, SerialDriver]:
    board = VirtualBoard(BenchParameters(MOTOR, **bench), **(board_options or {}))
    driver = make(board, calibration, drive_map)
    driver.open()
    driver.arm(LIMITS)
    return board, driver


def ticks(board: VirtualBoard, driver: SerialDriver, u_V: float, n: int) -> list[tuple[Sample, BoardTruth]]:
    """``n`` ticks of constant drive; their samples, and the truth right after each was read."""
    pairs = []
    for _ in range(n):
        pairs.append((driver.read(), board.truth()))
        driver.write(u_V)
        board.sleep_until(board.now_s() + PERIOD_S)
    return pairs


# ---------------------------------------------------------------------- opening, and time


@pytest.mark.parametrize("ppm", [-20000, 4000, *evidence(-5000, 0, 5000, 20000)])
def test_the_devices_clock_is_found(ppm: int) -> None:
    board = VirtualBoard(BenchParameters(MOTOR), clock_error_ppm=ppm)
    info = make(board).open()
    assert info.clock_ratio == pytest.approx(1.0 + 1e-6 * ppm, abs=10e-6)  # 100 ppm is what is asked for
    assert (info.board, info.reset_cause, info.emulated) == ("host", "power-on", True)


def test_the_cause_of_the_last_reset_is_told() -> None:
    board = VirtualBoard(BenchParameters(MOTOR))
    board.sleep_until(0.5)
    board.reset(8)
    assert make(board).open().reset_cause == "watchdog"


@pytest.mark.parametrize("ppm", [0, 5000])
def test_the_drives_time_is_that_at_the_pin(ppm: int) -> None:
    """Also while the device's 32 bits of microseconds wrap, here in the middle of the run."""
    board, driver = armed(board_options={"clock_error_ppm": ppm, "clock_start_us": 2**32 - 2_000_000})
    for k in range(200):
        driver.write(0.1 if k % 2 else -0.1)
        sample = driver.read()
        truth = board.truth()
        assert sample.t_u_s == pytest.approx(truth.pin_changed_s, abs=20e-6)
        assert sample.t_u_s < sample.t_s < truth.t_s
        assert sample.u_V == truth.pin_V
        board.sleep_until(board.now_s() + PERIOD_S)
    assert board.now_s() > 2.5


# ---------------------------------------------------------------------- a run


@pytest.mark.parametrize(
    ("calibration", "rad_per_count"), [(RISING, RAD_PER_COUNT), (FALLING, -RAD_PER_COUNT)], ids=["rising", "falling"]
)
def test_a_run_agrees_with_the_truth(calibration: Calibration, rad_per_count: float) -> None:
    board, driver = armed(calibration, rad_per_count=rad_per_count)
    assert board.truth().armed
    for sample, truth in ticks(board, driver, 1.5, 20):
        read_later_s = truth.t_s - sample.t_s
        assert 0.0 < read_later_s < 0.004
        lag_rad = abs(truth.v_rad_per_s) * read_later_s
        assert abs(sample.y_rad - truth.y_rad) <= 0.51 * RAD_PER_COUNT + 1.1 * lag_rad
        assert sample.u_V == truth.pin_V
    assert sample.u_V == pytest.approx(1.5, abs=0.5 * 12.0 / 799)
    assert sample.y_rad > 0.3
    assert driver.link_statistics["drives_lost"] == driver.link_statistics["stale_replies"] == 0
    assert driver.link_statistics["bad_frames"] == driver.link_statistics["timeouts"] == 0
    assert board.truth().dropped == 0


def test_a_reversed_bridge_is_turned_back_by_the_config() -> None:
    """Wired the other way round, and said so: positive volts raise the position all the same."""
    board, driver = armed(RISING, DriveMap(supply_V=12.0, reversed=True), drive="reversed")
    samples = [sample for sample, _ in ticks(board, driver, 1.5, 20)]
    assert samples[-1].u_V == pytest.approx(1.5, abs=0.01)
    assert samples[-1].y_rad > 0.3
    assert board.truth().pin_V == pytest.approx(-1.5, abs=0.01)


def test_the_tachometer_gives_the_shafts_velocity() -> None:
    bench = BenchParameters(MOTOR, tachometer_rad_s_per_count=0.2, tachometer_zero_counts=512.0, gear_ratio=9.0)
    board = VirtualBoard(bench)
    driver = make(board, tachometer=TachometerScale(0.2, 512.0, 9.0))
    driver.open()
    driver.arm(LIMITS)
    sample, truth = ticks(board, driver, 1.5, 20)[-1]
    assert truth.v_rad_per_s > 2.0
    assert sample.v_rad_per_s == pytest.approx(truth.v_rad_per_s, abs=0.5 * 0.2 / 9.0 + 0.1)
    fault = fault_of(make(VirtualBoard(BenchParameters(MOTOR)), tachometer=TachometerScale(0.2)).open)
    assert fault.code == "CONFIG_MISMATCH"


def test_a_damaged_drive_is_not_pretended() -> None:
    board, driver = armed()
    ticks(board, driver, 1.0, 3)
    acting_V = board.truth().pin_V
    write = board.write
    board.write = lambda data: write(data[:2] + bytes([data[2] ^ 0x10]) + data[3:])  # type: ignore[method-assign]  # a damaged byte
    driver.write(-1.0)
    board.write = write  # type: ignore[method-assign]  # and the line as it was
    sample = driver.read()
    assert sample.u_V == board.truth().pin_V == acting_V > 0.0
    assert driver.link_statistics["drives_lost"] == 1
    assert board.truth().dropped == 1


# ---------------------------------------------------------------------- faults, with their codes and at the pin


def test_a_fault_is_cleared_by_opening_anew_and_by_nothing_else() -> None:
    board, driver = armed()
    assert not math.isnan(ticks(board, driver, 0.2, 3)[-1][0].t_u_s)
    board.place(1.91)
    board.sleep_until(board.now_s() + 0.002)
    assert fault_of(driver.read).code == "DEVICE_TRAVEL"
    board.place(0.0)
    board.sleep_until(board.now_s() + 0.002)
    driver.safe_stop()
    assert fault_of(driver.arm, LIMITS).code == "DEVICE_TRAVEL"
    assert driver.open().acknowledged == ("DEVICE_TRAVEL",)
    driver.arm(LIMITS)
    samples = [sample for sample, _ in ticks(board, driver, 1.0, 3)]
    assert samples[-1].u_V > 0.9
    assert math.isnan(samples[0].t_u_s)  # nothing written since arming


# ---------------------------------------------------------------------- beyond a limit, and the sign


@pytest.mark.parametrize("falling", [False, True])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_beyond_a_limit_only_inward_drive_passes(falling: bool, turned: bool, side: float) -> None:
    """Whatever way sensor and bridge are turned, once the config says so."""
    calibration = FALLING if falling else RISING
    bench: dict[str, Any] = {
        "start_rad": side * 1.95,
        "rad_per_count": -RAD_PER_COUNT if falling else RAD_PER_COUNT,
        "drive": "reversed" if turned else "ok",
    }
    drive_map = DriveMap(supply_V=12.0, reversed=turned)
    board, driver = armed(calibration, drive_map, **bench)
    driver.write(side * 0.3)  # outward
    assert fault_of(driver.read).code == "DEVICE_TRAVEL"
    assert board.truth().pin_V == 0.0

    driver.open()
    driver.arm(LIMITS)
    samples = [sample for sample, _ in ticks(board, driver, -side * 1.0, 20)]
    assert side * samples[0].y_rad > 1.9
    assert side * samples[-1].y_rad < 1.85
    assert board.truth().recovering == 0
    assert side * samples[-1].u_V < -0.9


# ---------------------------------------------------------------------- stopping
