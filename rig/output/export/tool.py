"""What every tool's export is made of: its files as texts, from templates of this room."""

from __future__ import annotations

import pprint
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import jinja2

from rig.core.errors import CauseError
from rig.core.package import FOLDER
from rig.output.export.motor import NUMBERS, IdentifiedMotor
from rig.output.export.whole_run import ExportedRun

# A model has no first day: what drifts from the start of the tests to their end. And no torque that is another than its
# drive.
IN_NONE: Final = {
    "drift": "friction stays at its mean over the tests",
    "load_friction": "friction is that at no torque: a large drive moves the model farther than the motor",
    "source": "the supply has no resistance: tau is that of small drives",
    "runs_free": "the bridge brakes: at a drive of 0 the motor coasts farther than the model",
    "free_between": "the bridge always brakes: at small drives the motor is faster and coasts farther than the model",
    "no_brake": "the bridge brakes: where its drive falls the motor coasts farther than the model",
}
# And what has no state in a model of velocity and position, and no inverse.
NOT_RIGID: Final = {
    "bristle": "the shaft is rigid where friction holds it: it does not bend",
    "backlash": "the sensor follows the motor without play",
    **IN_NONE,
}


@dataclass(frozen=True)
class Tool:
    """A tool that loads the model of a run.

    title   for people
    files   of a motor and its run: content by name of file
    lacks   parts of a motor that its files cannot express, each with what follows
    in_N_m  whether its files can be in newton metres
    """

    title: str
    files: Callable[[IdentifiedMotor, ExportedRun], dict[str, bytes]]
    lacks: Mapping[str, str]
    in_N_m: bool = False


class ExportError(CauseError):
    """A motor that a tool has no words for."""


def rendered(template: str, **values: object) -> bytes:
    """A template of this room, filled in, as UTF-8."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rig.output.export", "templates"),
        autoescape=False,  # no markup that a browser reads
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        trim_blocks=True,
    )
    return environment.get_template(template).render(**values).encode("utf-8")


def python_file(template: str, motor: IdentifiedMotor, **values: object) -> bytes:
    """A Python file by its template, with the motor in it: ``head`` in its docstring, ``model`` and ``names``."""
    return rendered(
        template,
        head="\n".join(motor.head()).replace("\\", "/").replace('"""', "'''"),
        model=pprint.pformat(motor.as_json(), width=116, sort_dicts=False),
        names=pprint.pformat(tuple(NUMBERS), width=100, compact=True),
        **values,
    )


def constant(name: str) -> bytes:
    """A file of this room that is the same for every motor."""
    return (FOLDER / "output" / "export" / "templates" / name).read_bytes()
