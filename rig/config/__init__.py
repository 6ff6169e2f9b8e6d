"""The schema of an experiment, and loading it with errors that name file, line and key."""

from rig.config.load import check, dump, json_schema, load, schema_text
from rig.config.preflight import Preflight, preflight
from rig.config.problems import ConfigError, Problem
from rig.config.schema import Experiment

__all__ = [
    "ConfigError",
    "Experiment",
    "Preflight",
    "Problem",
    "check",
    "dump",
    "json_schema",
    "load",
    "preflight",
    "schema_text",
]
