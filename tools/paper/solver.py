"""An independent peer: the same loop by an ODE solver with events, nothing of ours in it but the equations (1)-(6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]

PERIODS = 30  # transients fall by 0.62 a half period: 1e-12 of them is left
RELATIVE, ABSOLUTE = 1e-11, 1e-13


@dataclass(frozen=True)
class _Crossing:
    """An event that ends the integration: a state's component passes zero in a direction."""

    plane: int
    direction: float
    terminal: bool = True

    def __call__(self, _t: float, x: Array) -> float:
        return float(x[self.plane])


@dataclass(frozen=True)
class Cycle:
    """One period as the solver finds it: durations of a half period's stages, s, and positions at RA and RC, rad."""

    durations_s: tuple[float, float, float]
    y_ra_rad: float
    y_rc_rad: float
    evaluations: int

    @property
    def period_s(self) -> float:
        """T = 2 (t1 + t2 + t3), s."""
        return 2.0 * sum(self.durations_s)


def settled_cycle(
    tau_s: float, K_rad_s_V: float, fc_V: float, h1_V: float, h2_V: float, start: tuple[float, float, float]
) -> Cycle:
    """Let the loop run from ``start`` = (v, y, z) until it has settled; its last half period that begins at +(h1 + h2).

    Each switching ends an integration, whose event is found by the solver's root finding. Sticks where the drive at
    v = 0 does not exceed fc_V. Raises RuntimeError if the loop comes to no cycle with edges in the order RA, RB, RC.
    """
    state = np.array(start, dtype=float)
    sides = np.where(state > 0.0, 1.0, -1.0)
    switches: list[tuple[int, float, Array]] = []
    evaluations = 0
    now = 0.0
    for _ in range(6 * PERIODS):
        relay = -h1_V * sides[1] - h2_V * sides[2]
        if state[0] == 0.0:
            if abs(relay) <= fc_V:  # stuck: y stays, z moves on to its zero, where RC switches
                now, state, sides[2] = now - state[2] / state[1], np.array([0.0, state[1], 0.0]), -sides[2]
                switches.append((2, now, state.copy()))
                continue
            sides[0] = np.sign(relay)  # moves off in the sign of the drive
        drive = relay - fc_V * sides[0]

        def motion(_t: float, x: Array, drive: float = drive) -> list[float]:
            return [(K_rad_s_V * drive - x[0]) / tau_s, x[0], x[1]]

        run = solve_ivp(
            motion, (now, now + 100.0 * tau_s), state, method="DOP853", rtol=RELATIVE, atol=ABSOLUTE,
            events=[_Crossing(plane, -side) for plane, side in enumerate(sides.tolist())], max_step=0.2 * tau_s,
        )  # fmt: skip
        evaluations += run.nfev
        times, states = run.t_events or [], run.y_events or []
        plane = next((k for k, at in enumerate(times) if at.size), None)
        if plane is None:
            raise RuntimeError("the solver found no switching: the loop does not oscillate")
        now, state = float(times[plane][0]), states[plane][0].copy()
        state[plane] = 0.0  # exactly on the plane: the next integration leaves it
        sides[plane] = -sides[plane]
        switches.append((plane, now, state.copy()))
    return _last_half(switches, evaluations)


def _last_half(switches: list[tuple[int, float, Array]], evaluations: int) -> Cycle:
    """The last RC, RA, RB, RC in a row whose first RC goes downwards (the drive steps up)."""
    for k in range(len(switches) - 4, -1, -1):
        planes = [plane for plane, _, _ in switches[k : k + 4]]
        if planes == [2, 0, 1, 2] and switches[k][2][1] < 0.0:
            times = [at for _, at, _ in switches[k : k + 4]]
            durations = (times[1] - times[0], times[2] - times[1], times[3] - times[2])
            return Cycle(durations, float(switches[k + 1][2][1]), float(switches[k][2][1]), evaluations)
    raise RuntimeError("the solver's oscillation has not settled to edges in the order RA, RB, RC")
