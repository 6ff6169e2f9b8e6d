"""Constants of the stand-in."""

from enum import Enum


class TerminalConfiguration(Enum):
    RSE = 10083
    NRSE = 10078
    DIFF = 10106
    DEFAULT = -1
