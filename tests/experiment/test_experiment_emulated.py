"""An emulated bench is the one that the config describes: K comes out right, or the run says why it does not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from command_line import rig

ROOT = Path(__file__).resolve().parents[2]
ODD: dict[str, Any] = {  # falling readings of 12 bits, a bridge that drops, passes nothing at first, and turns round
    "sensor": {
        "counts_max": 4095,
        "calibration": [{"counts": 3900, "rad": -2.1}, {"counts": 200, "rad": 2.1}],
        "rail_counts": [20, 4070],
    },
    "drive": {
        "supply_V": 10.0, "bridge_drop_V": 1.4, "dead_band_duty": {"plus": 0.03, "minus": 0.05}, "max_V": 3.0,
        "reversed": True,
    },
}  # fmt: skip


def relay_run(folder: Path, sections: dict[str, Any], **emulated: Any) -> tuple[dict[str, Any], str]:
    """result.json of two relay tests, and what the terminal showed."""
    config = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    del config["tracking"]
    gains = [{"h1_V": 0.42, "h2_V": 0.85}, {"h1_V": 0.3, "h2_V": 0.76}]
    config["relay"] = {"gains": gains, "cycles": 8}
    config["emulated"] |= emulated
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump(config | sections), encoding="utf-8")
    done = rig("run", path, "--out", folder / "runs")
    assert done.exit_code == 0, done.output
    (run,) = (folder / "runs").iterdir()
    return json.loads((run / "result.json").read_text()), done.stdout


def test_the_truth_is_what_the_config_believes(tmp_path: Path) -> None:
    result, shown = relay_run(tmp_path, ODD)
    estimate, truth = result["estimates"]["sampled-data"], result["truth"]
    assert estimate["verdict"] == "ok", estimate["reasons"]
    for key in ("tau_s", "K_rad_s_V", "fc_V"):
        assert estimate[key] == pytest.approx(truth[key], rel=0.02)
    assert result["config_notes"] == []
    assert "note: " not in shown


def test_a_bench_that_is_told_otherwise_is_said_at_the_end_of_the_run_and_in_its_report(tmp_path: Path) -> None:
    """K is a sixth off, and nothing in the record can show it."""
    result, shown = relay_run(tmp_path, {}, supply_V=10.0)
    estimate, truth = result["estimates"]["sampled-data"], result["truth"]
    assert estimate["K_rad_s_V"] == pytest.approx(truth["K_rad_s_V"] * 10.0 / 12.0, rel=0.03)
    note = "the emulated bridge gives 10 V, by the config it gives 12 V: K and f_c will come out scaled"
    assert result["config_notes"] == [note]
    assert f"note: {note}\n" in shown
    report = next((tmp_path / "runs").glob("*/report.html")).read_text(encoding="utf-8")
    assert report.index(note.removeprefix("t")) < report.index('<section class="headline')
