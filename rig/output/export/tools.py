"""The model of a run for another tool: which tools there are, and their files written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from rig.output.export.bam import BAM
from rig.output.export.c import C
from rig.output.export.motor import IdentifiedMotor, identified_motor
from rig.output.export.mujoco import MUJOCO
from rig.output.export.tool import IN_NONE, ExportError, Tool, constant, python_file
from rig.output.export.whole_run import ExportedRun, as_mat, load
from rig.output.export.wpilib import WPILIB
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import write_whole
from rig.run_folder.recording.path_kind import require_free
from rig.run_folder.results import JsonObject

_SIMULATION: Final = "motor_simulate.m"
_SMOOTH_RAD_S: Final = 1e-3  # friction of python-control's continuous system turns over so small a velocity


def _for_control(motor: IdentifiedMotor, run: ExportedRun) -> dict[str, bytes]:
    """``motor_control.py``: the motor as systems in a Python file that needs numpy and control, not rig."""
    return {"motor_control.py": python_file("motor_control.py.j2", motor, smooth=_SMOOTH_RAD_S)}


def _for_matlab(motor: IdentifiedMotor, run: ExportedRun) -> dict[str, bytes]:
    """``motor.mat``: the run, ``motor`` with everything known of it, ``values`` for a simulation; and the function."""
    model: JsonObject = {"motor": motor.as_json(), "values": dict(motor.all_values())}
    return {"motor.mat": as_mat(run, model), _SIMULATION: constant(_SIMULATION)}


TOOLS: Final[dict[str, Tool]] = {
    "control": Tool("python-control", _for_control, IN_NONE),
    "matlab": Tool("MATLAB and Octave", _for_matlab, IN_NONE),
    "mujoco": MUJOCO,
    "wpilib": WPILIB,
    "c": C,
    "bam": BAM,
}


@dataclass(frozen=True)
class ExportedModel:
    """What an export of a model wrote.

    files   the files, in the order in which they are to be read
    notes   what the run lacks, in words
    """

    motor: IdentifiedMotor
    files: tuple[Path, ...]
    notes: tuple[str, ...]


def export_model(
    run_folder: Path,
    tool: str,
    into: Path,
    *,
    overwrite: bool = False,
    torque_N_m_V: float | None = None,
    R_ohm: float | None = None,
) -> ExportedModel:
    """Write the model of a run for ``tool``, one of ``TOOLS``, as files in the folder ``into``, which it makes.

    overwrite     replace files that are there already
    torque_N_m_V  of a volt, > 0: then the files are in N m; None: not known
    R_ohm         of the winding, > 0, for BAM; None: not known
    Raises ExportError for newton metres where the tool has none, and where it has no such motor.
    Raises RecordingError if there is no run, no model in it that was not refused, or a file of a name that is to be
    written or in place of the folder; CannotWriteError if a file cannot be written.
    """
    run = load(run_folder)
    chosen = TOOLS[tool]
    if torque_N_m_V is not None and not chosen.in_N_m:
        able = ", ".join(name for name, one in TOOLS.items() if one.in_N_m)
        raise ExportError(f"{chosen.title} gets a motor in volts", f"leave out --N-m-per-V: it is for {able}")
    motor = replace(identified_motor(run_folder, run).lacking(chosen.lacks), torque_N_m_V=torque_N_m_V, R_ohm=R_ohm)
    contents = chosen.files(motor, run)
    paths = [into / name for name in contents]
    _make_ready(into, paths, overwrite=overwrite)
    for path, content in zip(paths, contents.values(), strict=True):
        write_whole(path, content)
    return ExportedModel(motor, tuple(paths), run.notes)


def _make_ready(into: Path, paths: Sequence[Path], *, overwrite: bool) -> None:
    try:
        if into.exists() and not into.is_dir():
            raise RecordingError(into, "is no folder", "name another one with --into")
        into.mkdir(parents=True, exist_ok=True)
        for path in paths:
            require_free(path, "another folder with --into", overwrite=overwrite)
    except OSError as error:
        raise RecordingError(into, f"cannot be used: {error.strerror}", "name another folder") from error
