"""Export: a run as one file that other programs open, and its motor as a model that other tools load."""

from rig.output.export.tool import ExportError as ExportError
from rig.output.export.tools import TOOLS as TOOLS
from rig.output.export.tools import ExportedModel as ExportedModel
from rig.output.export.tools import export_model as export_model
from rig.output.export.whole_run import FORMATS as FORMATS
from rig.output.export.whole_run import ExportedRun as ExportedRun
from rig.output.export.whole_run import export as export
from rig.output.export.whole_run import load as load
from rig.output.export.whole_run import matlab_names as matlab_names
