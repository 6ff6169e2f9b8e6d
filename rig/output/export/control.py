"""python-control: the motor as systems in a Python file that needs numpy and control, not rig."""

from __future__ import annotations

import pprint

from rig.output.export.motor import NUMBERS, IdentifiedMotor
from rig.output.export.tool import IN_NONE, Tool, rendered
from rig.output.export.whole_run import ExportedRun

SMOOTH_RAD_S = 1e-3  # friction of the continuous system turns over so small a velocity


def files(motor: IdentifiedMotor, run: ExportedRun) -> dict[str, bytes]:
    """``motor_control.py``."""
    text = rendered(
        "motor_control.py.j2",
        head="\n".join(motor.head()).replace("\\", "/").replace('"""', "'''"),
        model=pprint.pformat(motor.as_json(), width=116, sort_dicts=False),
        names=pprint.pformat(tuple(NUMBERS), width=100, compact=True),
        smooth=SMOOTH_RAD_S,
    )
    return {"motor_control.py": text}


CONTROL = Tool("python-control", files, IN_NONE)
