"""Friction beyond Coulomb's on the emulated bench: what a run says is true of it, and what it finds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner

from rig.cli import main

ROOT = Path(__file__).resolve().parents[2]


def truth_of(folder: Path, **motor: Any) -> dict[str, Any]:
    """The truth in the result of a jog with config/quick.yaml, its true motor changed."""
    config = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    config["emulated"]["motor"] |= motor
    path = folder / "friction.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    result = CliRunner().invoke(main, ["jog", str(path), "--u-V", "1.2", "--out", str(folder / "runs")])
    assert result.exit_code == 0, result.output
    (written,) = (folder / "runs").glob("*/result.json")
    outcome = json.loads(written.read_text(encoding="utf-8"))
    assert outcome["jog"]["to_rad"] > outcome["jog"]["from_rad"] + 0.1
    truth: dict[str, Any] = outcome["truth"]
    return truth


def test_the_truth_of_a_motor_with_viscous_friction_is_what_its_motion_shows(tmp_path: Path) -> None:
    truth = truth_of(tmp_path, tau_s=0.204, K_rad_s_V=7.8, viscous_V_s_rad=0.2 / 7.8)
    assert (truth["tau_s"], truth["K_rad_s_V"]) == pytest.approx((0.17, 6.5))
    assert (truth["tau_without_viscous_s"], truth["K_without_viscous_rad_s_V"]) == (0.204, 7.8)
    assert truth["viscous_V_s_rad"] == 0.2 / 7.8
    assert "stribeck_rad_s" not in truth


def test_a_motor_with_stribeck_effect_says_so(tmp_path: Path) -> None:
    truth = truth_of(tmp_path, fc_plus_V=0.5, fc_minus_V=0.5, fs_plus_V=0.7, fs_minus_V=0.7, stribeck_rad_s=0.4)
    assert truth["stribeck_rad_s"] == 0.4
    assert (truth["tau_s"], truth["K_rad_s_V"], truth["fc_V"]) == (0.17, 6.5, 0.5)
    assert "viscous_V_s_rad" not in truth and "tau_without_viscous_s" not in truth
    (law,) = truth["law"]
    assert (law["name"], law["unit"]) == ("stribeck", "V")
    assert law["numbers"] == {"stribeck_V": pytest.approx(0.2), "stribeck_rad_s": 0.4}


def test_parts_of_the_emulated_motor_are_true_laws_with_the_sizes_that_identification_gives(tmp_path: Path) -> None:
    level = {"fs_plus_V": 0.5, "fs_minus_V": 0.46}
    truth = truth_of(tmp_path, **level, parts={"force_sin_V": 0.03, "force_cos_V": -0.04, "gain_by_sign": -0.02})
    sizes = {law["name"]: (law["value"], law["unit"]) for law in truth["law"]}
    assert sizes == {"force_over_position": (pytest.approx(0.05), "V"), "gain_by_sign": (-0.02, "1")}


def test_static_friction_that_differs_by_direction_is_no_law(tmp_path: Path) -> None:
    assert "law" not in truth_of(tmp_path, fs_plus_V=0.6, fs_minus_V=0.5)


def test_a_motor_with_nothing_more_says_so(tmp_path: Path) -> None:
    assert truth_of(tmp_path, fs_plus_V=0.5, fs_minus_V=0.46)["law"] == []
