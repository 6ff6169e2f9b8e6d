"""How far a shaft was off its trajectory: by the readings that its law took, and where an emulated shaft really was."""

from __future__ import annotations

import numpy as np

from rig.backends.emulated.shaft import ShaftPath
from rig.control.tracking import Tracking, tracking_error
from rig.core.arrays import Array
from rig.model.real_motor import FramedMotor
from rig.running.session import Session

FADE_S = 1.5  # of the tracking reference; errors count after it
SHAFT_GAP_S = 0.02  # by which the path of an emulated shaft may be shorter than the samples


def tracking_errors(session: Session, law: Tracking, motor: FramedMotor, shaft: ShaftPath | None) -> dict[str, float]:
    """RMS and largest error of a law that has come to its end, by their keys in result.json.

    motor  its model: the sensor's curvature that it knows is no error
    shaft  where the emulated shaft was, in the bench's own time; None: nobody knows
    """
    t_s, y_rad, yd_rad = np.array(law.taken).T
    rms_rad, max_rad = tracking_error(t_s, motor.positions(y_rad), yd_rad, FADE_S)
    found = {"rms_rad": rms_rad, "max_rad": max_rad}
    true_rad = _true_position(session, shaft, t_s)
    if true_rad is not None:
        found["true_rms_rad"], found["true_max_rad"] = tracking_error(t_s, true_rad, yd_rad, FADE_S)
    return found


def _true_position(session: Session, path: ShaftPath | None, t_s: Array) -> Array | None:
    """Where the emulated shaft was at these times, by the config's calibration (docs/theory.md 11.4); None: unknown.

    Also None where the device told less than all of that time.
    """
    truth = session.bench.truth
    if path is None or truth is None or len(path.t_s) == 0:
        return None
    at_s = np.asarray(path.t_s, dtype=float) + session.loop.since_start_s(0.0)
    if t_s[0] < at_s[0] - SHAFT_GAP_S or t_s[-1] > at_s[-1] + SHAFT_GAP_S:
        return None
    shaft_rad = np.interp(t_s, at_s, np.asarray(path.y_rad, dtype=float))
    counts = truth.centre_counts + (shaft_rad + truth.offset_rad) / truth.rad_per_count
    return np.array([session.experiment.sensor.curve.to_rad(one) for one in counts.tolist()])
