"""Whether the strokes of a breakaway check moved the shaft against the drive, or along it but late.

Strokes go to and fro. So a stroke that comes late can look like one that goes the wrong way, and the other way round:
an encoder shows so little motion, so exactly, that a motor with swapped wires can pass for one that moves 0.15 s late.
But the strokes change their order from pair to pair, and the late motor's motion has to fit all of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rig.identification.preprocessing import from_recording

# Private there: the rows of `make campaign-real` belong to the text of rig/identification, so a name there stays as it
# is.
from rig.identification.stroke_delay import FINE_S, LONGEST_S, MOVED, STEP_S
from rig.identification.stroke_delay import _Strokes as Strokes
from rig.run_folder.recording.errors import IdentifyError, RecordingError
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.series import TimeSeries
from rig.run_folder.recording.stage import StageKind


def strokes_move_against(recording: Recording, noise_rad: float) -> bool:
    """``moves_against`` of the breakaway check in a run; False without one."""
    try:
        series, _ = from_recording(recording, recording.stage_rows(str(StageKind.BREAKAWAY)), "breakaway")
    except (IdentifyError, RecordingError):
        return False
    return moves_against(series, noise_rad)


def moves_against(series: TimeSeries, noise_rad: float) -> bool:
    """Whether a motor with swapped wires explains the strokes better than one that moves late; False if neither does.

    series     rows of the breakaway check, with the times at which each drive acted
    noise_rad  standard deviation of the reading
    Both may move up to 0.15 s late, so that a bench that is late and reversed counts as reversed.
    """
    along, against = (Strokes.of(replace(series, u_V=sign * series.u_V), noise_rad) for sign in (1.0, -1.0))
    if along is None or against is None:
        return False
    least = _least(against)
    return against.still - least > MOVED and least < _least(along)


def _least(strokes: Strokes) -> float:
    """Least chi-squared of any delay."""
    tried = strokes.fitted({}, np.arange(-STEP_S, LONGEST_S + 0.5 * STEP_S, STEP_S))
    around_s = min(tried, key=lambda delay_s: tried[delay_s].cost)
    tried = strokes.fitted(tried, around_s + np.arange(-STEP_S + FINE_S, STEP_S, FINE_S))
    return min(fit.cost for fit in tried.values())
