"""The schema of an experiment, and loading it with errors that name file, line and key."""

from rig.config.campaign import Campaign, campaign_lines
from rig.config.load import dump, is_campaign, json_schema, load, load_campaign, read, schema_text
from rig.config.problems import ConfigError, Problem
from rig.config.schema import Experiment

__all__ = [
    "Campaign",
    "ConfigError",
    "Experiment",
    "Problem",
    "campaign_lines",
    "dump",
    "is_campaign",
    "json_schema",
    "load",
    "load_campaign",
    "read",
    "schema_text",
]
