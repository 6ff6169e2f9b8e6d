"""Whether several recordings are of one motor, and which one is not.

Each recording is identified alone. A chi-square test compares the sampled-data estimates with their weighted mean, for
all of them, and for all but one in turn (docs/theory.md 9). rig names a recording if the others agree without it, and
if this is true of no other recording.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from shlex import quote
from typing import Final

from rig.identification import sampled_data
from rig.identification.estimate import Estimate
from rig.identification.opinion import RecordingEstimate, agree, differences, mean_of
from rig.identification.starts import Start
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.series import TimeSeries

_RUN: Final = re.compile(r"(.+) \(run (\d+) of \d+\)")


def estimates_of_each(
    recordings: Sequence[tuple[str, Sequence[TimeSeries]]], of_all: Estimate | None = None
) -> list[RecordingEstimate]:
    """The estimate of each recording (name, tests) alone, without those that cannot be identified.

    of_all   estimate of all of them, from which each starts, if it is usable
    """
    found = []
    known = of_all is not None and of_all.is_motor and of_all.converged and not of_all.spoiled
    starts = [Start(of_all.tau_s, of_all.K_rad_s_V, max(of_all.fc_V, 0.0))] if known and of_all is not None else None
    for name, tests in recordings:
        try:
            one = RecordingEstimate.of(name, sampled_data.fit(tests, starts)) if tests else None
        except IdentifyError:
            continue
        if one is not None:
            found.append(one)
    return found


def are_one_motor(found: Sequence[RecordingEstimate], rms_rad: float, numbers: int) -> bool:
    """Whether one motor with laws explains the recordings better than a plain motor for each.

    rms_rad   RMS residual of the one motor, rad
    numbers   of its laws: each must be worth its price in BIC. That plain motors have more numbers counts for nothing,
              else another supply or calibration between two recordings is taken for a law
    """
    squares, rows = (sum(one.squares[k] for one in found) for k in range(2))
    return rows > 0 and rows * (rms_rad**2 * rows - squares) + numbers * math.log(rows) * squares < 0.0


def disagreement(found: Sequence[RecordingEstimate]) -> str | None:
    """Which recording does not belong with the others, and what to do, as a sentence; None if all agree."""
    if len(found) < 2 or agree(found):
        return None
    if len(found) == 2:
        first, second = found
        return (
            f"{first.name} and {second.name} do not agree: in {second.name} {differences(second, *mean_of([first]))}; "
            "are they of one motor, supply and calibration? "
            f"Identify each alone, {_command([first])} and {_command([second])}; with a third one rig names the odd one"
        )
    without = [[other for other in found if other is not odd] for odd in found]
    consistent = [k for k, others in enumerate(without) if agree(others)]
    if len(consistent) != 1:
        reason = "more than one differs" if not consistent else "rig cannot see which one is odd"
        return (
            f"the {len(found)} recordings do not agree, and {reason}: are they of one motor, supply and calibration? "
            "Identify each alone, such as " + _command(found[:1])
        )
    odd, others = found[consistent[0]], without[consistent[0]]
    return (
        f"{odd.name} does not belong with the others, which agree: {differences(odd, *mean_of(others))}; "
        f"another motor, supply or calibration? Leave it out: {_command(others)}"
    )


def _command(found: Sequence[RecordingEstimate]) -> str:
    """What to type for these alone. A run of several in a file is no file yet."""
    runs = {opinion.name: _RUN.fullmatch(opinion.name) for opinion in found}
    typed = " ".join(quote(name) if run is None else f"run-{run[2]}.csv" for name, run in runs.items())
    cut = " and ".join(dict.fromkeys(run[1] for run in runs.values() if run is not None))
    return f"`rig identify {typed}`" + (f", cut out of {cut}" if cut else "")
