"""The schema of an experiment, and loading it with errors that name file, line and key."""

from rig.config.campaign import Campaign, campaign_lines
from rig.config.load import check, dump, is_campaign, json_schema, load, load_campaign, schema_text
from rig.config.plan import notes
from rig.config.preflight import Preflight, preflight
from rig.config.problems import ConfigError, Problem
from rig.config.schema import Experiment

__all__ = [
    "Campaign",
    "ConfigError",
    "Experiment",
    "Preflight",
    "Problem",
    "campaign_lines",
    "check",
    "dump",
    "is_campaign",
    "json_schema",
    "load",
    "load_campaign",
    "notes",
    "preflight",
    "schema_text",
]
