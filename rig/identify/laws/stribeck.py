"""The Stribeck effect: fs falls to fc over the speed vs, fc + (fs - fc) exp(-|v| / vs).

Its motion hardly differs from that of another tau, K and fc, and a change of its static level looks like one of its
velocity. So a fit must start near the solution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from rig.identify.breakaway import Ramps
from rig.identify.laws.law import (
    CLEAR,
    SECOND_AMPLITUDE,
    STATIC_LEVEL,
    Array,
    CandidateLaw,
    Doubt,
    Fitted,
    LawComparison,
    LawNumber,
    LawParameter,
    Plain,
    Range,
    Values,
)
from rig.model.sensitivity import StribeckTheta, Theta, position, stribeck_response
from rig.recording.series import Window

SPEEDS = (0.01, 0.03, 0.1, 0.3)  # tried Stribeck velocities, over the largest speed
SPEED_RANGE = (0.003, 1.0)


class Stribeck(CandidateLaw):
    """Tustin's law."""

    name = "stribeck"
    title = "Stribeck friction"
    adds = "+ Stribeck effect"
    parameters = (LawParameter("excess_V", 1e-5), LawParameter("stribeck_rad_s", 1e-4, logarithmic=True))
    reports = (STATIC_LEVEL, LawNumber("stribeck_rad_s", "rad/s", "Stribeck velocity"))
    has_static_level = True
    confounded_with = ("tau_s", "K_rad_s_V", "fc_V")

    def position(self, theta: Theta, own: Sequence[float], window: Window) -> Array:
        """Positions by Taylor series of bounded error, rad. ``own``: its own parameters, in the fit's units."""
        excess, log_speed = own
        if excess <= 0.0:
            return position(theta, *window.steps, window.t_s, theta.fc_V + excess)
        motor = StribeckTheta(*theta, theta.fc_V + excess, math.exp(log_speed))
        return stribeck_response(motor, *window.steps, window.t_s)

    def trials(self, plain: Plain) -> list[list[float]]:
        """A few velocities; none if the motor does not move."""
        top_rad_s = plain.top_rad_s
        return [[0.0, math.log(share * top_rad_s)] for share in SPEEDS] if top_rad_s > 0.0 else []

    def ranges(self, plain: Plain) -> list[Range]:
        """The excess goes up to the largest drive; the range of the velocity follows from the largest speed."""
        slowest, fastest = (math.log(share * plain.top_rad_s) for share in SPEED_RANGE)
        return [(0.0, plain.largest_V), (slowest, fastest)]

    def report(self, fit: Fitted, ramps: Ramps | None) -> Values:
        """Static level and velocity."""
        level_error, speed_error = fit.error("fc_V", "excess_V"), fit.error("stribeck_rad_s")
        if level_error is None or speed_error is None:
            return Values({}, {})
        level_V, speed = fit.value("fc_V") + fit.value("excess_V"), fit.value("stribeck_rad_s")
        return Values({"fs_V": level_V, "stribeck_rad_s": speed}, {"fs_V": level_error, "stribeck_rad_s": speed_error})

    def from_one_amplitude(self, against: LawComparison) -> str | Doubt | None:
        """Never decides for it: at one amplitude it looks like another tau, K and fc."""
        wants = f"{against.gained}, but " if against.gain > CLEAR else ""
        return Doubt(f"{wants}at one amplitude it looks like another tau, K and f_c", SECOND_AMPLITUDE)
