"""A config that may be run: loaded, and held to the rules, with errors that name file, line and key."""

from __future__ import annotations

from collections.abc import Collection

from rig.config.load import Given, load_with_places
from rig.config.problems import ConfigError
from rig.config.schema import Experiment
from rig.preflight.rules import Preflight, preflight


def check(path: Given, passing: Collection[str] = ()) -> tuple[Experiment, Preflight]:
    """``load``, and ``preflight`` on it: the experiment, and what it would do.

    passing  keys, with dots, whose problems do not count: of what drives nothing
    Raises ConfigError as ``load`` does, and, with the places of the keys, where the experiment must not be run.
    """
    experiment, document = load_with_places(path)
    found = preflight(experiment)
    problems = [problem for problem in found.problems if problem.key not in passing]
    if problems:
        raise ConfigError(map(document.located, problems))
    return experiment, found
