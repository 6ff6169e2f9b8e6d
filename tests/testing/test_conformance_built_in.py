"""The built-in drivers under the conformance suite, one line each; and that line in a test file of somebody else."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from evidence import evidence

from rig.backends.driver import Driver
from rig.backends.serial.driver import SerialDriver
from rig.backends.servo.driver import ServoDriver
from rig.testing import conformance

TESTS = Path(__file__).parent.parent
CONFIGS = TESTS.parent / "config"


def stop_the_board(driver: Driver) -> None:
    """The emulated device dies: its port hangs up."""
    assert isinstance(driver, SerialDriver)
    driver._exchange.transport.close()


def pull_the_bus(driver: Driver) -> None:
    """The cable of the servo is pulled out at the adapter."""
    assert isinstance(driver, ServoDriver)
    driver._transport.close()


TestSimulated = conformance.suite(CONFIGS / "quick.yaml", silence=True)
TestHostBoard = conformance.suite("host-board.yaml", silence=True, cut=stop_the_board)
TestChip = conformance.suite("chip.yaml", silence=True)
TestModbusReadWrite = conformance.suite("modbus-read-write.yaml", silence=True)
TestModbusSeparate = conformance.suite("modbus-separate.yaml", silence=True)
TestServo = conformance.suite(CONFIGS / "servo.yaml", silence=True, cut=pull_the_bus)
TestServoWithoutWatchdog = conformance.suite(CONFIGS / "servo-sts3215.yaml", cut=pull_the_bus)


@pytest.mark.evidence
@pytest.mark.parametrize(("card", "passes"), [("Clips", False), *evidence(("VirtualCard", True))])
def test_one_line_is_enough_with_pytest_alone(tmp_path: Path, card: str, passes: bool) -> None:
    """In a folder of its own, with an installed plug-in: entry point, config beside the test, one line."""
    module = {"VirtualCard": "plug_in_cards", "Clips": "broken_cards"}[card]
    package = tmp_path / "site" / "rig_virtual_card-1.0.dist-info"
    package.mkdir(parents=True)
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: rig-virtual-card\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text(f"[rig.daq]\nvirtual-card = {module}:{card}\n")
    config = (Path(__file__).parent / "virtual-card.yaml").read_text(encoding="utf-8")
    (tmp_path / "card.yaml").write_text(config, encoding="utf-8")
    (tmp_path / "test_card.py").write_text(
        'import rig.testing.conformance\n\nTestCard = rig.testing.conformance.suite("card.yaml")\n', encoding="utf-8"
    )
    path = os.pathsep.join(map(str, (tmp_path / "site", TESTS, Path(__file__).parent)))
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_card.py"],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if passes:
        assert done.returncode == 0, done.stdout
        assert " passed" in done.stdout
        assert "skipped" not in done.stdout
    else:
        assert done.returncode == 1
        assert "FAILED test_card.py::TestCard::test_it_refuses_drives_beyond_its_range" in done.stdout
        assert "write(12.22) must raise ValueError: the drive gives 12 V" in done.stdout
        assert done.stdout.count("FAILED") == 1


def test_nothing_of_pytest_is_imported_by_rig(tmp_path: Path) -> None:
    program = "import sys, rig.testing.conformance; sys.exit('pytest' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=False).returncode == 0
