"""MATLAB and Octave: the run with its motor as a .mat file, and a function that simulates it."""

from __future__ import annotations

from rig.output.export.motor import IdentifiedMotor
from rig.output.export.tool import IN_NONE, Tool, constant
from rig.output.export.whole_run import ExportedRun, as_mat
from rig.run_folder.results import JsonObject

_SIMULATION = "motor_simulate.m"


def files(motor: IdentifiedMotor, run: ExportedRun) -> dict[str, bytes]:
    """``motor.mat``: the run, ``motor`` with everything known of it, ``values`` for a simulation; and the function."""
    model: JsonObject = {"motor": motor.as_json(), "values": dict(motor.all_values())}
    return {"motor.mat": as_mat(run, model), _SIMULATION: constant(_SIMULATION)}


MATLAB = Tool("MATLAB and Octave", files, IN_NONE)
