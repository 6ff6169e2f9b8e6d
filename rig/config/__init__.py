"""The schema of an experiment, and loading it with errors that name file, line and key."""

from rig.config.campaign import Campaign
from rig.config.load import check, dump, json_schema, load, load_campaign, schema_text
from rig.config.preflight import Preflight, preflight
from rig.config.problems import ConfigError, Problem
from rig.config.schema import Experiment

__all__ = [
    "Campaign",
    "ConfigError",
    "Experiment",
    "Preflight",
    "Problem",
    "check",
    "dump",
    "json_schema",
    "load",
    "load_campaign",
    "preflight",
    "schema_text",
]
