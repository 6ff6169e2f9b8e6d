"""Whole runs that are short: their config, and what has to come out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml


def short(config: dict[str, Any], gains: list[dict[str, float]], cycles: int, tracking_s: float) -> dict[str, Any]:
    """These gains, so many cycles at each pair, one check."""
    config["breakaway"] |= {"ramp_V_s": 0.8, "rest_s": 0.2}
    config["relay"] = {"gains": gains, "cycles": cycles}
    config["tracking"] |= {"duration_s": tracking_s, "methods": ["sampled-data"]}
    return config


def written(config: dict[str, Any], folder: Path) -> Path:
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    return path


def finds_the_truth(outcome: dict[str, Any]) -> None:
    estimate, truth = outcome["estimates"]["sampled-data"], outcome["truth"]
    for name in ("tau_s", "K_rad_s_V", "fc_V"):
        assert estimate[name] == pytest.approx(truth[name], rel=0.03)
    assert outcome["tracking"]["sampled-data"]["rms_rad"] < 0.01
