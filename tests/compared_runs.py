"""Run folders that are written without a loop, to be compared and listed."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rig.control.relay import DualChannelRelay
from rig.control.simulation import Sampling, simulate
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.run_folder.recording.sample_columns import HEADER, SampleRow, format_row

ERRORS = (0.0003, 0.008, 0.0005)  # standard errors of tau, K and f_c
METHOD = "sampled-data"


@dataclass(frozen=True)
class Told:
    """What a run's result says: the estimate, and the half widths in its budget beyond the noise."""

    tau_s: float = 0.17
    K_rad_s_V: float = 6.5
    fc_V: float = 0.48
    verdict: str = "ok"
    supply: float = 0.01
    dead_band_V: float = 0.0
    laws: tuple[dict[str, Any], ...] = ()
    travel_rad: tuple[float, float] | None = None  # its middle, and half of it


def result_of(told: Told) -> dict[str, Any]:
    """result.json."""
    values = {"tau_s": told.tau_s, "K_rad_s_V": told.K_rad_s_V, "fc_V": told.fc_V}
    covariance = np.zeros((5, 5))
    covariance[:3, :3] = np.diag(np.square(ERRORS))
    estimate = {
        **values,
        "ci95": {key: [x - 1.96 * e, x + 1.96 * e] for (key, x), e in zip(values.items(), ERRORS, strict=True)},
        "covariance_of": ["tau_s", "K_rad_s_V", "fc_V", "asym_V", "delay_s"],
        "covariance": covariance.tolist(),
        "verdict": told.verdict,
        "reasons": [] if told.verdict == "ok" else ["too few cycles"],
    }
    budget = [
        {"source": "scatter", **{key: 2.0 * e for key, e in zip(values, ERRORS, strict=True)}},
        {
            "source": "supply",
            "tau_s": 0.0,
            "K_rad_s_V": told.supply * 6.5,
            "fc_V": told.supply * 0.48,
            "absolute": True,
        },
        {"source": "dead_band", "tau_s": 0.0, "K_rad_s_V": 0.0, "fc_V": told.dead_band_V},
    ]
    u95 = {key: 1.96 * e for key, e in zip(values, ERRORS, strict=True)}
    frame = (
        {} if told.travel_rad is None else dict(zip(("centre_rad", "half_travel_rad"), told.travel_rad, strict=True))
    )
    return {
        "schema": 1, "backend": "bench", "relays": [], "estimates": {METHOD: estimate}, "tracking": {}, "faults": [],
        "law": list(told.laws), "u95": u95, "budget": budget, "law_frame": frame or None, "notes": [], "link": {},
        "config_notes": [], "loop": {"period_s": 0.01, "ticks": 1000},
    }  # fmt: skip


def write_run(folder: Path, told: Told | None = None, *, hour: int = 0, supply_V: float = 12.0) -> Path:
    """Write meta.json and result.json of a run into ``folder``, which is made; ``told``: None: no result."""
    folder.mkdir(parents=True)
    meta = {
        "schema": 1, "name": "bench", "backend": "serial:/dev/ttyACM0 (uno)", "emulated": False,
        "started_utc": f"2026-05-09T{hour:02d}:00:00.000+00:00", "firmware": {"board": "uno", "clock_ratio": 1.0},
        "drive": {"supply_V": supply_V, "bridge_drop_V": 0.0}, "script": {"name": "run"},
    }  # fmt: skip
    (folder / "meta.json").write_text(json.dumps(meta))
    if told is not None:
        (folder / "result.json").write_text(json.dumps(result_of(told)))
    return folder


def write_samples(folder: Path, seed: int) -> None:
    """Write samples.csv beside: a relay test, and what stands for a tracking check."""
    motor = Motor(0.17, 6.5, coulomb(0.48))
    recording = simulate(
        motor, DualChannelRelay(0.8, 1.0, math.inf), 12.0, Sampling(0.01, 0.002, 0.003, 0.004, 0.02, seed)
    )
    rows = [
        SampleRow(
            k, k % 256, t, t + 0.002, y, 0, math.nan, u, z, y + 0.001 * (t > 10.0),
            "relay-1" if t < 10.0 else f"track:{METHOD}", 0.0, 0.0, 0,
        )
        for k, (t, y, u, z) in enumerate(
            zip(
                recording.t_s.tolist(), recording.y_rad.tolist(), recording.u_V.tolist(),
                (0.01 * np.cumsum(recording.y_rad)).tolist(), strict=True,
            )
        )
    ]  # fmt: skip
    (folder / "samples.csv").write_text(HEADER + "".join(map(format_row, rows)))
