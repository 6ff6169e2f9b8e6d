"""A run folder written without the loop: a sampled dual-channel relay on the exact motor, all stages."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rig.model.friction import Friction
from rig.model.motor import Motor, State
from rig.run_folder.recording.sample_columns import HEADER, SampleRow, format_row

PERIOD_S = 0.01
DELAY_S = 0.003
LSB_RAD = 4.2 / 1024
NOISE_RAD = 0.003
MOTOR = Motor(0.17, 6.5, Friction(0.50, 0.46, 0.54, 0.50), bias_V=0.01)
BACKEND = "emulated serial device (pty) <uno & motor>"  # needs escaping on purpose

CONFIG = """\
name: synthetic
period_s: 0.010
limits:
  soft_rad: [-1.1, 1.1]
  hard_rad: [-1.9, 1.9]
relay:
  target: {amplitude_rad: 0.5, period_s: 0.75}
tracking:
  k1_1_s: 12.0
  k2_1_s2: 36.0
"""


@dataclass
class Bench:
    """The motor behind a sampler: one call to ``tick`` is one row."""

    rng: np.random.Generator
    state: State = field(default_factory=State)
    u_V: float = 0.0
    z_rad_s: float = 0.0
    last_y: float | None = None
    rows: list[str] = field(default_factory=list)
    late_us: list[float] = field(default_factory=list)
    events: list[dict[str, Any]] = field(default_factory=list)
    stage: str = ""

    @property
    def t_s(self) -> float:
        return len(self.rows) * PERIOD_S

    def enter(self, stage: str) -> None:
        self.stage = stage
        self.events.append({"t_s": self.t_s, "kind": "stage", "name": stage})

    def read(self) -> tuple[float, int]:
        noisy = self.state.y + self.rng.normal(0.0, NOISE_RAD)
        counts = int(min(1023, max(0, round(512 + noisy / LSB_RAD))))
        y = (counts - 512) * LSB_RAD
        if self.last_y is not None:
            self.z_rad_s += 0.5 * PERIOD_S * (y + self.last_y)
        self.last_y = y
        return y, counts

    def tick(self, y: float, counts: int, u_V: float, yd_rad: float = math.nan) -> None:
        k = len(self.rows)
        t = self.t_s
        late, io = self.rng.gamma(2.0, 20.0), 900 + self.rng.gamma(2.0, 90.0)
        self.rows.append(
            format_row(
                SampleRow(
                    k, k % 256, t, t + DELAY_S, y, counts, math.nan, u_V, self.z_rad_s, yd_rad, self.stage, late, io, 0
                )
            )
        )
        self.late_us.append(late)
        self.state = MOTOR.advance(self.state, self.u_V, DELAY_S)
        self.u_V = u_V
        self.state = MOTOR.advance(self.state, u_V, PERIOD_S - DELAY_S)


def _rest(bench: Bench, seconds: float) -> None:
    """Rows at 0 V in the present stage; the integral starts anew."""
    bench.z_rad_s, bench.last_y = 0.0, None
    for _ in range(round(seconds / PERIOD_S)):
        bench.tick(*bench.read(), 0.0)


def _breakaway(bench: Bench) -> None:
    bench.enter("breakaway")
    for sign in (1.0, -1.0):
        _rest(bench, 0.4)
        start, drive = bench.read()[0], 0.0
        while True:
            y, counts = bench.read()
            if abs(y - start) > 0.02:
                break
            bench.tick(y, counts, sign * drive)
            drive += 0.4 * PERIOD_S
        _rest(bench, 0.2)


def _relay(bench: Bench, stage: str, gains: list[tuple[float, float, float]]) -> None:
    bench.enter(stage)
    sgn_y = sgn_z = -1.0
    for h1, h2, seconds in gains:
        for _ in range(round(seconds / PERIOD_S)):
            y, counts = bench.read()
            sgn_y = math.copysign(1.0, y) if y else sgn_y
            sgn_z = math.copysign(1.0, bench.z_rad_s) if bench.z_rad_s else sgn_z
            bench.tick(y, counts, -h1 * sgn_y - h2 * sgn_z)
        if stage == "search":
            settled = h2 > 0.7
            size = (0.6 * h2, 0.55 * h2**2) if settled else (None, None)
            event = {"t_s": bench.t_s, "kind": "search", "h1_V": h1, "h2_V": h2, "period_s": size[0]}
            event |= {"amplitude_rad": size[1], "outcome": "settled" if settled else "no oscillation"}
            bench.events.append(event)


def _track(bench: Bench, method: str, tau: float, gain: float, fc: float) -> tuple[float, float]:
    bench.enter(f"track:{method}")
    errors = []
    start, y0 = len(bench.rows), bench.state.y

    def reference(t: float) -> float:
        fade = math.exp(-((t / 0.8) ** 2))
        return fade * y0 + (1.0 - fade) * (0.5 * math.sin(1.5 * t) + 0.2 * math.sin(3.1 * t))

    for _ in range(600):
        t = (len(bench.rows) - start) * PERIOD_S
        before, yd, after = (reference(t + d) for d in (-1e-3, 0.0, 1e-3))
        vd, ad = (after - before) / 2e-3, (after - 2.0 * yd + before) / 1e-6
        y, counts = bench.read()
        v = bench.state.v
        r = ad + 12.0 * (vd - v) + 36.0 * (yd - y)
        u = tau / gain * r + v / gain + fc * math.copysign(1.0, vd)
        bench.tick(y, counts, max(-3.0, min(3.0, u)), yd)
        errors.append(yd - y)
    return float(np.sqrt(np.mean(np.square(errors)))), float(np.max(np.abs(errors)))


def _estimate(
    tau: float, gain: float, fc: float, relative_ci: float | None, verdict: str, rms: float
) -> dict[str, Any]:
    values = {"tau_s": tau, "K_rad_s_V": gain, "fc_V": fc, "asym_V": -0.0101, "delay_s": 0.00302}
    ci = None
    if relative_ci is not None:
        ci = {k: [x - relative_ci * abs(x), x + relative_ci * abs(x)] for k, x in values.items()}
    reasons = {
        "ok": [],
        "doubtful": ["the position extremum is located no better than 1.2 ms, which costs 12 % in tau"],
        "refused": ["no settled cycle in the rows used"],
    }[verdict]
    return {
        **values, "fc_plus_V": 0.4998, "fc_minus_V": 0.4602, "bias_V": 0.0097, "ci95": ci, "covariance": None,
        "rms_rad": rms, "iterations": 5, "verdict": verdict, "reasons": reasons, "rows": [700, 2400],
    }  # fmt: skip


def write_run(folder: Path, *, seed: int = 1, tracking: bool = True) -> Path:
    """Write a complete synthetic run into ``folder`` (created) and return it."""
    folder.mkdir(parents=True, exist_ok=True)
    bench = Bench(np.random.default_rng(seed))
    _breakaway(bench)
    _relay(bench, "search", [(0.8, h2, 1.0) for h2 in (0.1, 0.4, 0.7, 0.9)] + [(0.8, 1.0, 3.0)])
    first = len(bench.rows)
    _relay(bench, "relay-1", [(0.8, 1.0, 10.0)])
    _relay(bench, "relay-2", [(1.0, 1.15, 10.0)])
    last = len(bench.rows) - 1
    bench.enter("rest")
    _rest(bench, 0.7)
    estimates = {
        "sampled-data": _estimate(0.17042, 6.5123, 0.48051, 0.006, "ok", 0.00321),
        "triple-relay": _estimate(0.1863, 6.912, 0.5121, 0.12, "doubtful", 0.0113),
        "describing-function": _estimate(0.2121, 5.31, 0.2952, None, "doubtful", 0.0412),
    }
    tracked: dict[str, Any] = {}
    if tracking:
        for method, e in estimates.items():
            if method == "describing-function":
                reason = "its simulation on the best model leaves the soft limits (1.31 rad, limit 1.10 rad)"
                tracked[method] = {"not_run": reason}
                continue
            bench.enter("rest")
            _rest(bench, 0.7)
            rms, largest = _track(bench, method, e["tau_s"], e["K_rad_s_V"], e["fc_V"])
            tracked[method] = {"rms_rad": rms, "max_rad": largest}
    for e in estimates.values():
        e["rows"] = [first, last]
    late = np.array(bench.late_us)
    p50, p99, p999 = np.percentile(late, [50, 99, 99.9])
    result = {
        "schema": 1, "backend": BACKEND,
        "breakaway": {"static_plus_V": 0.541, "static_minus_V": 0.503},
        "search": [{k: v for k, v in e.items() if k != "kind"} for e in bench.events if e["kind"] == "search"],
        "relays": [
            {"stage": "relay-1", "h1_V": 0.8, "h2_V": 1.0, "period_s": 0.68, "amplitude_rad": 0.44, "cycles": 12},
            {"stage": "relay-2", "h1_V": 1.0, "h2_V": 1.15, "period_s": 0.6, "amplitude_rad": 0.46, "cycles": 14},
        ],
        "estimates": estimates, "tracking": tracked,
        "loop": {
            "period_s": PERIOD_S, "ticks": len(bench.rows), "skipped": 0,
            "late_us": {"p50": p50, "p99": p99, "p999": p999, "max": float(late.max())},
        },
        "faults": [],
    }  # fmt: skip
    meta = {
        "schema": 1, "name": "synthetic", "backend": BACKEND, "period_s": PERIOD_S, "order": "sample_first",
        "started_utc": "2026-05-09T12:00:00.000+00:00", "host": {"system": "Linux", "machine": "x86_64"},
        "firmware": {"board": "uno", "build": "0.1.0", "reset_cause": "power-on", "clock_ratio": 1.00012},
        "versions": {"rig": "0.1.0", "numpy": np.__version__},
        "truth": {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_V": 0.48, "asym_V": -0.01},
    }  # fmt: skip
    (folder / "samples.csv").write_text(HEADER + "".join(bench.rows))
    (folder / "events.jsonl").write_text("".join(json.dumps(e) + "\n" for e in bench.events))
    (folder / "meta.json").write_text(json.dumps(meta))
    (folder / "result.json").write_text(json.dumps(result))
    (folder / "config.yaml").write_text(CONFIG)
    return folder
