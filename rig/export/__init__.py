"""Export: a run as a file that other programs open, and its motor as a model that other tools load."""

from rig.export.whole_run import export, load, matlab_names

__all__ = ["export", "load", "matlab_names"]
