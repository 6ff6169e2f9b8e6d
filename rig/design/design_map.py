"""The map of a design: what each pair of gains and the best strokes would tell, and how long they take for what."""

from __future__ import annotations

import math
from dataclasses import replace

from rig.control.strokes import Stroke
from rig.design.best_test import GainGrid, best_of, best_strokes, gain_grid
from rig.design.outlook import AT_REST, Task, driven, law_of, told
from rig.design.planned_test import Design, RelayGains, Strokes
from rig.run_folder.results import design as results

SIZE = 20  # gains of each axis
PERCENTS = (10.0, 3.0, 1.0, 0.5)  # half widths to say the time for, %
SHOWN = 1.1  # of the strokes' time: as much of their motion is shown


def design_map(task: Task, doubt_percent: float) -> results.DesignResult:
    """Try pairs of gains on a grid, and search strokes for each interval: some seconds. Deterministic.

    doubt_percent  by which ``task.belief`` may be wrong, to be told with the result
    """
    grid = gain_grid(task, SIZE)
    gains, strokes = best_of(task, grid), best_strokes(task)
    pair = () if gains is None else gains.pair or (gains.single,)
    return results.DesignResult(
        motor=_motor(task, doubt_percent),
        room=results.DesignRoom.of(task.room),
        wanted_percent=task.wanted_percent,
        strokes=tuple(results.DesignedStroke(u_V=one.u_V, turn_rad=one.turn_rad) for one in _strokes_of(strokes)),
        gains=tuple(_gains(one.gains) for one in pair),
        single=None if gains is None else _gains(gains.single.gains),
        until=tuple(_until(task, grid, strokes, percent) for percent in sorted({*PERCENTS, task.wanted_percent})[::-1]),
        map=_map(task, grid),
        motion=_motion(task, strokes),
    )


def _motor(task: Task, doubt_percent: float) -> results.BelievedMotor:
    return results.BelievedMotor.of(
        task.belief,
        static_V=task.room.static_V,
        doubt_percent=doubt_percent,
        noise_rad=math.sqrt(task.reading.noise_rad2),
        delay_s=task.delay_s,
    )


def _gains(gains: RelayGains) -> results.DesignedGains:
    return results.DesignedGains(h1_V=gains.h1_V, h2_V=gains.h2_V)


def _strokes_of(design: Design | None) -> tuple[Stroke, ...]:
    return design.test.strokes if design is not None and isinstance(design.test, Strokes) else ()


def _map(task: Task, grid: GainGrid) -> results.DesignedMap:
    rows = [
        [told(task, law_of(one.gains)).seconds if one is not None and one.is_inside else math.nan for one in row]
        for row in grid.tried
    ]
    return results.DesignedMap(
        h1_V=tuple(grid.h1_V.tolist()),
        h2_V=tuple(grid.h2_V.tolist()),
        seconds=tuple(map(tuple, rows)),
        inside=len(grid.inside),
    )


def _until(task: Task, grid: GainGrid, strokes: Design | None, percent: float) -> results.DesignedSeconds:
    wish = replace(task, wanted_percent=percent)
    gains = best_of(wish, grid)
    # strokes that are good for one interval are not the best for another
    plan = strokes if percent == task.wanted_percent else best_strokes(wish)
    return results.DesignedSeconds(
        interval_percent=percent,
        strokes_s=None if plan is None else plan.seconds,
        pair_s=None if gains is None else gains.pair_s,
        single_s=None if gains is None else gains.single_s,
    )


def _motion(task: Task, design: Design | None) -> results.DesignedMotion | None:
    strokes = _strokes_of(design)
    if design is None or not strokes:
        return None
    t_s, y_rad, u_V = driven(replace(task, start=AT_REST), law_of(strokes), SHOWN * design.seconds)
    return results.DesignedMotion(t_s=tuple(t_s.tolist()), y_rad=tuple(y_rad.tolist()), u_V=tuple(u_V.tolist()))
