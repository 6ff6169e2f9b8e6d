"""Reads a config and checks it against the rules. Errors name file, line and key."""

from __future__ import annotations

from collections.abc import Collection

from rig.config.load import Given, load_with_places, read
from rig.config.problems import ConfigError
from rig.config.schema import Experiment
from rig.running.preflight.rules import Preflight, preflight


def check(path: Given, passing: Collection[str] = (), pace: float | None = None) -> tuple[Experiment, Preflight]:
    """``load``, and ``preflight`` on it: the experiment, and what it would do.

    pace     in place of loop.pace; None: as the file says
    passing  keys, written with dots, whose problems do not count; for commands that drive nothing
    Raises ConfigError as ``load`` does, and also if the experiment must not be run: with line and key of each problem.
    """
    experiment, document = load_with_places(read(path, takes_pipe=True))
    experiment = experiment.at_pace(pace)
    found = preflight(experiment)
    problems = [problem for problem in found.problems if problem.key not in passing]
    if problems:
        raise ConfigError(map(document.located, problems))
    return experiment, found
