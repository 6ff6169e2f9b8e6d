"""python-control: the motor as systems in a Python file that needs numpy and control, not rig."""

from __future__ import annotations

from rig.output.export.motor import IdentifiedMotor
from rig.output.export.tool import IN_NONE, Tool, python_file
from rig.output.export.whole_run import ExportedRun

SMOOTH_RAD_S = 1e-3  # friction of the continuous system turns over so small a velocity


def files(motor: IdentifiedMotor, run: ExportedRun) -> dict[str, bytes]:
    """``motor_control.py``."""
    return {"motor_control.py": python_file("motor_control.py.j2", motor, smooth=SMOOTH_RAD_S)}


CONTROL = Tool("python-control", files, IN_NONE)
