"""Export: a run as one file that other programs open, and its motor as a model that other tools load."""

from rig.output.export.tool import ExportError
from rig.output.export.tools import TOOLS, ExportedModel, export_model
from rig.output.export.whole_run import FORMATS, ExportedRun, export, load, matlab_names

__all__ = [
    "FORMATS",
    "TOOLS",
    "ExportError",
    "ExportedModel",
    "ExportedRun",
    "export",
    "export_model",
    "load",
    "matlab_names",
]
