"""Somebody else's bench: any drive, any spacing of samples, a constant delay that only the bench knows, a plain CSV."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from synthetic import LSB_RAD, dcr, motor

from rig.identification.estimate import Estimate
from rig.identification.verdict import ASKED
from rig.model.motor import Motor, State

Law = Callable[[float, float, float], float]
Columns = dict[str, np.ndarray]

PAPER = {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_V": 0.5}
QUICK = {"tau_s": 0.08, "K_rad_s_V": 12.0, "fc_V": 0.3}
SLOW = {"tau_s": 0.35, "K_rad_s_V": 3.0, "fc_V": 0.4}


def square(high_V: float, period_s: float) -> Law:
    return lambda t, y, z: high_V if t % period_s < 0.5 * period_s else -high_V


def chirp(high_V: float, duration_s: float, low_Hz: float = 0.3, high_Hz: float = 3.0) -> Law:
    rate = (high_Hz - low_Hz) / (2.0 * duration_s)
    return lambda t, y, z: float(high_V * np.sin(2.0 * np.pi * (low_Hz + rate * t) * t))


def binary(low_V: float, high_V: float, hold_s: float, seed: int = 0) -> Law:
    bits = np.random.default_rng(seed).integers(0, 2, 10_000)
    return lambda t, y, z: high_V if bits[int(t / hold_s + 1e-9)] else low_V


def sines(high_V: float) -> Law:
    return lambda t, y, z: float(high_V * sum(np.sin(2.0 * np.pi * f * t + f * f) for f in (0.4, 0.7, 1.1, 1.9)) / 2.0)


def triangle(high_V: float) -> Law:
    return lambda t, y, z: high_V * (2.0 * abs(2.0 * ((0.5 * t) % 1.0) - 1.0) - 1.0)


def by_hand(high_V: float, seed: int = 0) -> Law:
    """Pushes to and fro of odd lengths and strengths, without a rest between them."""
    rng = np.random.default_rng(seed)
    ends = np.cumsum(rng.uniform(0.15, 0.9, 500))
    pushes = np.where(np.arange(500) % 2, 1.0, -1.0) * high_V * rng.uniform(0.6, 1.0, 500)
    return lambda t, y, z: float(pushes[np.searchsorted(ends, t)])


def step(high_V: float, at_s: float = 0.5, end_s: float = np.inf) -> Law:
    return lambda t, y, z: high_V if at_s <= t < end_s else 0.0


def constant(u_V: float) -> Law:
    return lambda t, y, z: u_V


def relay(fc_V: float) -> Law:
    return dcr(0.56, fc_V + 0.5)


def sampled(
    shaft: Motor,
    law: Law,
    t_s: np.ndarray,
    delay_s: float,
    noise_rad: float = 3e-3,
    lsb_rad: float = LSB_RAD,
    offset_rad: float = 0.03,
    seed: int = 1,
) -> Columns:
    """Columns t_s, u_V, y_rad, t_u_s. The drive that ``law(t, y, z)`` chooses at each sample acts ``delay_s`` later.

    The delay may be longer than a sampling period.
    """
    rng = np.random.default_rng(seed)
    edges = t_s + delay_s
    y_rad, u_V = np.empty(t_s.size), np.empty(t_s.size)
    state, now, acting, following = State(), float(t_s[0]), 0.0, 0
    z = previous = 0.0
    for k, t in enumerate(t_s.tolist()):
        while following < k and edges[following] <= t:
            state = shaft.advance(state, acting, edges[following] - now)
            now, acting, following = float(edges[following]), float(u_V[following]), following + 1
        state, now = shaft.advance(state, acting, t - now), t
        y = state.y + offset_rad + noise_rad * rng.standard_normal()
        y = round(y / lsb_rad) * lsb_rad if lsb_rad else y
        z += 0.5 * (y + previous) * (t - t_s[k - 1]) if k else 0.0
        previous = y
        y_rad[k], u_V[k] = y, law(t, y, z)
    return {"t_s": t_s, "u_V": u_V, "y_rad": y_rad, "t_u_s": edges}


def ticks(rows: int, spacing: str = "even", period_s: float = 0.01, seed: int = 0) -> np.ndarray:
    """Times of samples: "even", "jittered" by up to 0.3 periods each way, or "uneven" from 0.4 to 1.6 periods apart."""
    rng = np.random.default_rng(seed)
    if spacing == "uneven":
        return np.cumsum(rng.uniform(0.4, 1.6, rows)) * period_s
    late = rng.uniform(-0.3, 0.3, rows) if spacing == "jittered" else np.zeros(rows)
    return (np.arange(rows) + late) * period_s


def plain_csv(path: Path, columns: Columns, names: tuple[str, ...] = ("t_s", "u_V", "y_rad")) -> Path:
    rows = zip(*(columns[name].tolist() for name in names), strict=True)
    path.write_text(",".join(names) + "\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows), encoding="utf-8")
    return path


__all__ = [
    "PAPER", "QUICK", "SLOW", "Columns", "Law", "binary", "by_hand", "chirp", "constant", "motor", "plain_csv", "relay",
    "sampled", "sines", "square", "step", "ticks", "triangle",
]  # fmt: skip


def certain_but_for_laws(found: Estimate) -> bool:
    """Ok, or doubtful for nothing but laws: at one size of drive nobody can tell drag or sag from tau and K.

    The words are the same for scatter and for laws, so the scatter alone must be what ok asks for.
    """
    asked = {name: ASKED * abs(getattr(found, name)) for name in ("tau_s", "K_rad_s_V", "fc_V")}
    return found.verdict == "ok" or (
        found.verdict == "doubtful"
        and all(0.5 * (found.ci95[name][1] - found.ci95[name][0]) <= half for name, half in asked.items())
        and all("(at 95 %); ok asks for 2.5 %" in reason or "%; ok bears 1 %" in reason for reason in found.reasons)
    )
