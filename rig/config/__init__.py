"""The schema of an experiment, and loading it with errors that name file, line and key."""

from rig.config.campaign import Campaign as Campaign
from rig.config.campaign import campaign_lines as campaign_lines
from rig.config.load import dump as dump
from rig.config.load import is_campaign as is_campaign
from rig.config.load import json_schema as json_schema
from rig.config.load import load as load
from rig.config.load import load_campaign as load_campaign
from rig.config.load import read as read
from rig.config.load import schema_text as schema_text
from rig.config.problems import ConfigError as ConfigError
from rig.config.problems import Problem as Problem
from rig.config.schema import Experiment as Experiment
