"""The serial driver, pyserial and the emulated board's process behind a pseudo-terminal, in real time: a smoke test."""

import contextlib
import time
from itertools import pairwise

import pytest

from emulated_chips.chip_board import ChipBoard
from rig.backends.driver import Timeouts
from rig.backends.links.serial_port import SerialPort
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.serial_board import HostBoard
from rig.backends.serial.fit import Board
from rig.config.schema import Emulated
from rig.core.calibration import Calibration, DriveMap, Scaling
from rig.core.faults import Fault
from rig.core.signals import Limits

pytestmark = pytest.mark.realtime

EMULATED = Emulated.model_validate(
    {"motor": {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_plus_V": 0.5, "fc_minus_V": 0.46}, "clock_error_ppm": 5000}
)
CALIBRATION = Calibration([(12, -500 * 4.2 / 1024), (1012, 500 * 4.2 / 1024)])
LIMITS = Limits(soft_rad=(-1.1, 1.1), hard_rad=(-1.9, 1.9), max_u_V=3.0, watchdog_s=1.0)


def connect(port: str) -> SerialDriver:
    scaling = Scaling(CALIBRATION, DriveMap(supply_V=12.0), (5, 1018), 1023)
    # a shared machine may hold a process up for long
    return SerialDriver(SerialPort(port), scaling, Timeouts(2.0), board=Board("pwm-dir"), name=f"serial:{port}")


def test_a_run_and_another_on_the_same_port() -> None:
    with HostBoard() as board:
        port = board.start(EMULATED, 1)
        for _ in range(2):
            with contextlib.closing(connect(port)) as driver:
                info = driver.open()
                assert info.emulated and info.board == "host"
                assert driver.backend.startswith(f"serial:{port} (emulated host board, build ")
                driver.arm(LIMITS)
                samples = []
                for _ in range(10):
                    samples.append(driver.read())
                    driver.write(0.2)
                    time.sleep(0.005)
                assert samples[-1].u_V == driver.drive_map.quantised(0.2)
                assert all(b.t_s > a.t_s for a, b in pairwise(samples))
                assert all(s.t_u_s < s.t_s for s in samples[1:])
                assert driver.safe_stop()
                assert driver.link_statistics["bad_frames"] == 0


def test_the_device_disappears() -> None:
    with HostBoard() as board, contextlib.closing(connect(board.start(EMULATED, 1))) as driver:
        driver.open()
        driver.arm(LIMITS)
        driver.read()
        board.stop()
        with pytest.raises(Fault) as caught:
            driver.read()
        assert caught.value.code == "LINK_LOST"
        assert driver.safe_stop() is False


@pytest.mark.parametrize("device", [HostBoard, ChipBoard])
def test_the_reset_button_is_seen_by_the_run_and_told_to_the_next(device: type[HostBoard] | type[ChipBoard]) -> None:
    with device() as board:
        port = board.start(EMULATED, 1)
        with contextlib.closing(connect(port)) as driver:
            driver.open()
            driver.arm(LIMITS)
            driver.read()
            driver.write(0.2)
            board.reset()
            with pytest.raises(Fault) as caught:
                for _ in range(100):
                    driver.read()
                    time.sleep(0.005)
            assert caught.value.code in ("DEVICE_RESET", "LINK_TIMEOUT")  # what was on the way may be lost
        with contextlib.closing(connect(port)) as driver:
            assert driver.open().reset_cause == "external"
