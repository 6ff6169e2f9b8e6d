"""A run folder whose motor is known well enough to tune a loop for it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from rig.design.tune.prediction import Prediction, predict
from rig.design.tune.program import Trial
from rig.design.tune.tuning import Tuned
from rig.running import run_tuning

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "config/simulated.yaml"
GOLDEN = ROOT / "tests/golden/simulated"


def tuned_run(parent: Path) -> Path:
    """The golden recording of the simulated bench, with an estimate."""
    folder = parent / "20260101T000000Z-run-simulated"
    shutil.copytree(GOLDEN, folder)
    (folder / "config.yaml").write_text(CONFIG.read_text(encoding="utf-8"), encoding="utf-8")
    numbers = {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_V": 0.48, "asym_V": -0.01, "delay_s": 0.0012}
    estimate = numbers | {
        "ci95": {name: [0.997 * value, 1.003 * value] for name, value in numbers.items() if value > 0.0},
        "covariance_of": ["tau_s", "K_rad_s_V"],
        "correlation": [[1.0, 0.5], [0.5, 1.0]],
        "verdict": "ok",
    }
    result = {
        "schema": 1,
        "estimates": {"sampled-data": estimate},
        "law": [],
        "u95": {"tau_s": 0.002, "K_rad_s_V": 0.08, "fc_V": 0.004},
        "breakaway": {"noise_rad": 0.0032},
    }
    (folder / "result.json").write_text(json.dumps(result), encoding="utf-8")
    return folder


def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """The prediction of `rig tune` from 5 motors instead of the 39 that it asks for at least, which take seconds."""

    def predicted(tuned: Tuned, trial: Trial, draws: int, **more: Any) -> Prediction:
        return predict(tuned, trial, min(draws, 5), **more)

    monkeypatch.setattr("rig.design.tune.prediction.LEAST_DRAWS", 5)
    monkeypatch.setattr(run_tuning, "predict", predicted)
