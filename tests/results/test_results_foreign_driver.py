"""What a driver of another package tells comes into the results as plain numbers, or is named and left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rig import config as configs
from rig.backends.driver import DeviceInfo
from rig.backends.simulated.driver import SimulatedDriver
from rig.running.experiment.script import run_breakaway

ROOT = Path(__file__).resolve().parents[2]


def test_counts_that_are_no_whole_numbers_cost_no_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stop = SimulatedDriver.safe_stop

    def with_counts(driver: SimulatedDriver) -> None:
        driver.link_statistics = {"resent": np.int64(3), "lost": 2.0, "load": 0.5}  # type: ignore[dict-item]  # as a foreign driver may
        stop(driver)

    monkeypatch.setattr(SimulatedDriver, "safe_stop", with_counts)
    result = run_breakaway(configs.load(ROOT / "config/quick.yaml"), tmp_path).result
    assert result.link == {"resent": 3, "lost": 2}
    assert any("'load'" in note and "0.5" in note for note in result.notes)
    assert result.breakaway is not None and result.truth is not None


def test_numpys_numbers_of_a_device_are_plain_ones() -> None:
    info = DeviceInfo("1", "card", "power-on", False, supply_V=np.float32(12.0), drive_units=np.int32(4095))  # type: ignore[arg-type]  # as a foreign driver may
    assert type(info.supply_V) is float and type(info.drive_units) is int
