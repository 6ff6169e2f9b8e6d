"""Synthetic recordings: a sampled dual-channel relay, or any drive, on the exact motor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rig.model.describing_function import predict
from rig.model.friction import coulomb
from rig.model.motor import Motor, State
from rig.run_folder.recording.series import TimeSeries

LSB_RAD = 4.2 / 1024


@dataclass(frozen=True)
class Bench:
    """How the motor is watched and driven. Units in the names; ``delay_s`` from sample to effect of the drive."""

    period_s: float = 0.01
    delay_s: float = 0.004
    jitter_s: float = 0.0
    noise_rad: float = 0.0
    lsb_rad: float = 0.0
    offset_rad: float = 0.0
    seed: int = 1


@dataclass
class Samples:
    """Columns of a synthetic recording."""

    t_s: np.ndarray
    t_u_s: np.ndarray
    y_rad: np.ndarray
    u_V: np.ndarray
    z_rad_s: np.ndarray
    true: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))


def dcr(h1_V: float, h2_V: float) -> Callable[[float, float, float], float]:
    """Dual-channel relay: sgn(0) keeps the previous state; starts by pushing towards +y."""
    signs = [-1.0, -1.0]

    def law(t_s: float, y_rad: float, z_rad_s: float) -> float:
        for k, value in enumerate((y_rad, z_rad_s)):
            if value != 0.0:
                signs[k] = np.sign(value)
        return float(-h1_V * signs[0] - h2_V * signs[1])

    return law


def simulate(
    motor: Motor, law: Callable[[float, float, float], float], rows: int, bench: Bench, start: State | None = None
) -> Samples:
    """Record ``rows`` ticks of ``law(t, y, z) -> u`` on ``motor``."""
    rng = np.random.default_rng(bench.seed)
    state = start or State()
    acting = 0.0
    t_s = np.arange(rows) * bench.period_s
    out = Samples(t_s, np.empty(rows), np.empty(rows), np.empty(rows), np.empty(rows), np.empty((rows, 3)))
    z = previous = 0.0
    for k in range(rows):
        out.true[k] = state
        y = state.y + bench.offset_rad + bench.noise_rad * rng.standard_normal()
        if bench.lsb_rad:
            y = round(y / bench.lsb_rad) * bench.lsb_rad
        if k:
            z += (t_s[k] - t_s[k - 1]) * 0.5 * (y + previous)
        previous = y
        u = law(t_s[k], y, z)
        delay = bench.delay_s + bench.jitter_s * rng.uniform(-1.0, 1.0)
        out.y_rad[k], out.u_V[k], out.t_u_s[k], out.z_rad_s[k] = y, u, t_s[k] + delay, z
        assert 0.0 <= delay < bench.period_s
        state = motor.advance(state, acting, delay)
        acting = u
        state = motor.advance(state, acting, bench.period_s - delay)
    return out


def motor(
    tau_s: float = 0.17, K_rad_s_V: float = 6.5, fc_V: float = 0.5, asym_V: float = 0.0, fs_V: float | None = None
) -> Motor:
    """A motor with Coulomb friction and bias, by default that of docs/theory.md 3.5."""
    return Motor(tau_s, K_rad_s_V, coulomb(fc_V, fs_V), asym_V)


def drawn(rng: np.random.Generator) -> tuple[float, float, float, float, float]:
    """A motor and gains at random, as in docs/theory.md 7.10, with an amplitude of 0.8 rad: tau, K, fc, h1, h2."""
    tau, fc = math.exp(rng.uniform(math.log(0.08), math.log(0.5))), rng.uniform(0.1, 0.5)
    h2 = fc + rng.uniform(0.3, 1.0)
    h1 = rng.uniform(0.4, 1.0) * h2
    return tau, 0.8 / predict(tau, 1.0, fc, h1, h2).amplitude_rad, fc, h1, h2


def record(samples: Samples, t_u_known: bool = True, first: int = 0) -> TimeSeries:
    """The samples as estimators read them, from row ``first`` on."""
    times = samples.t_u_s if t_u_known else None
    return TimeSeries(samples.t_s, samples.y_rad, times, samples.u_V, name="synthetic").part(first, samples.t_s.size)


def write_csv(path: Path, samples: Samples, t_u_known: bool = True, stage: str = "") -> Path:
    """The samples as a plain CSV file, or with a column ``stage`` as samples.csv has it."""
    names = ["t_s", "u_V", "y_rad"] + (["t_u_s"] if t_u_known else []) + (["stage"] if stage else [])
    lines = [",".join(names)]
    for t, u, y, t_u in zip(samples.t_s, samples.u_V, samples.y_rad, samples.t_u_s, strict=True):
        row = [repr(float(x)) for x in (t, u, y, t_u)[: 4 if t_u_known else 3]] + ([stage] if stage else [])
        lines.append(",".join(row))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


__all__ = ["LSB_RAD", "Bench", "Samples", "dcr", "drawn", "motor", "record", "simulate", "write_csv"]
