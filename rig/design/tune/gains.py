"""Gains by pole placement, and the same loop in the words of a PID controller (docs/theory.md 15.1)."""

from __future__ import annotations

from rig.control.set_point import BANDWIDTH_OF_SECOND_ORDER
from rig.control.state_feedback import Gains, Loop
from rig.run_folder.results.tuned import TunedPid

INTEGRAL_POLE = 0.2  # the integral's pole over the others: it must not shape the step


def gains_for(loop: Loop, bandwidth_1_s: float, tau_s: float) -> Gains:
    """Gains of a loop whose response to its set-point is 3 dB down at ``bandwidth_1_s``, rad/s, > 0.

    The poles of a position loop are (s + w)^2 (s + a w), w = bandwidth / 0.6436; those of a velocity loop
    (s + w)(s + a w), w = bandwidth.
    A slower loop than the motor itself (w tau < 1) gets w = 1/tau: the reference model alone makes its set-point slow.
    A feedback that slow would first have to undo the motor's own damping, and would be fragile.
    """
    a = INTEGRAL_POLE
    w = max(bandwidth_1_s / (BANDWIDTH_OF_SECOND_ORDER if loop == "position" else 1.0), 1.0 / tau_s)
    if loop == "position":
        return Gains(loop, w * (2.0 + a), w * w * (1.0 + 2.0 * a), a * w**3)
    return Gains(loop, w * (1.0 + a), 0.0, a * w * w)


def as_pid(gains: Gains, tau_s: float, K_rad_s_V: float) -> TunedPid:
    """The same feedback as a PID controller of the position, or a PI controller of the velocity.

    u = Kp e + Ki int e dt + Kd de/dt + kS sgn(v_ref) + kV v_ref + kA a_ref, with e = reference - measured.
    """
    per = tau_s / K_rad_s_V
    speed = per * gains.speed_1_s - 1.0 / K_rad_s_V
    if gains.loop == "position":
        units = ("V/rad", "V/(rad s)", "V s/rad")
        return TunedPid(Kp=per * gains.place_1_s2, Ki=per * gains.integral, Kd=speed, units=units)
    return TunedPid(Kp=speed, Ki=per * gains.integral, Kd=0.0, units=("V s/rad", "V/rad", "V s2/rad"))
