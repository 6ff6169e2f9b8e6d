"""C: the motor as a header, and a tracking controller for it, for a microcontroller or any other machine.

``rig_controller`` is ``rig.control.tracking`` with the observer of ``rig.control.observer``. The motor moves in it by
the C of the emulated boards, firmware/motor/real_motor.c, which is copied beside it.
"""

from __future__ import annotations

from typing import Final

from rig.control.observer import MotorObserver
from rig.core.package import FOLDER, firmware_folders
from rig.model.real_motor import PARTS
from rig.output.export.motor import IdentifiedMotor
from rig.output.export.tool import NOT_RIGID, Tool, constant, rendered
from rig.output.export.whole_run import ExportedRun
from rig.run_folder.recording.errors import RecordingError

_MOTION: Final = ("real_motor.h", "real_motor.c")
_PERIOD_S, _NOISE_RAD = 0.01, 0.003  # where the run does not say
_GAINS: Final = {"k1_1_s": 12.0, "k2_1_s2": 36.0}  # as in a config that does not say


def files(motor: IdentifiedMotor, run: ExportedRun) -> dict[str, bytes]:
    """``rig_motor.h``, ``rig_controller.h`` and ``.c``, ``real_motor.h`` and ``.c``. Raises RecordingError."""
    left_out = {name for part in NOT_RIGID for name in PARTS[part]}
    numbers = [one for one in motor.numbers if one.name not in left_out]
    lines = [(f"{one.unit}, {one.words()}", one.name.upper(), repr(one.value)) for one in numbers]
    fields = [(one.name, one.name.upper()) for one in numbers if one.name != "delay_s"]
    if "half_travel_rad" not in {name for name, _ in fields}:
        lines.append(("rad, no term refers to it", "HALF_TRAVEL_RAD", "1.0"))
        fields.append(("half_travel_rad", "HALF_TRAVEL_RAD"))
    header = rendered(
        "rig_motor.h.j2",
        head="\n".join(f" * {_in_comment(line)}" for line in motor.head()),
        run=motor.provenance.run.replace("\\", "/").replace('"', "'"),
        sha256=motor.provenance.record_sha256 or "",
        numbers=[*((_in_comment(words), name, value) for words, name, value in lines), *_of_controller(motor, run)],
        fields=fields,
    )
    fixed = {name: constant(name) for name in _CONTROLLER}
    motion = {name: _motion(name) for name in _MOTION}
    return {"rig_motor.h": header, **fixed, **motion}


_CONTROLLER: Final = ("rig_controller.h", "rig_controller.c")


def _motion(name: str) -> bytes:
    """A file of the emulated boards' motor. Raises RecordingError where rig was installed without it."""
    found = next((folder for folder in firmware_folders() if (folder / "motor" / name).is_file()), None)
    if found is None:
        raise RecordingError(FOLDER, f"has no {name}, which --to c copies", "install rig again")
    return (found / "motor" / name).read_bytes()


def _of_controller(motor: IdentifiedMotor, run: ExportedRun) -> list[tuple[str, str, str]]:
    """Comment, name and value of what the controller needs besides the motor."""
    period_s = run.recording.meta.period_s or _PERIOD_S
    seen = run.result.breakaway.noise_rad if run.result.breakaway is not None else None
    noise_rad = seen or _NOISE_RAD
    gain_v, gain_y = observer_gain(motor, period_s, noise_rad)
    tracking = run.config.get("tracking")
    asked = tracking if isinstance(tracking, dict) else {}
    given = {name: asked.get(name) for name in _GAINS}
    gains = {name: float(v) if isinstance(v, int | float) else _GAINS[name] for name, v in given.items()}
    lag_s = motor.value("lag_s")
    has_linearity = any(motor.value(name) for name in PARTS["linearity"])
    return [
        ("s, how far ahead of the reading the reference is: delay and lag", "AHEAD_S", repr(motor.delay_s + lag_s)),
        ("s, period that the observer's gains are for", "PERIOD_S", repr(period_s)),
        (
            f"1/s, observer: velocity by error of position, for noise of {noise_rad:.3g} rad",
            "OBSERVER_V_1_S",
            repr(gain_v),
        ),
        ("1, observer: position by error of position", "OBSERVER_Y", repr(gain_y)),
        ("1/s, feedback of the velocity's error", "K1_1_S", repr(gains["k1_1_s"])),
        ("1/s2, feedback of the position's error", "K2_1_S2", repr(gains["k2_1_s2"])),
        ("whether the motor has laws beyond Coulomb friction", "HAS_PARTS", str(int(bool(motor.framed.parts)))),
        ("whether the sensor is curved", "HAS_LINEARITY", str(int(has_linearity))),
    ]


def observer_gain(motor: IdentifiedMotor, period_s: float, noise_rad: float) -> tuple[float, float]:
    """Gain of the observer, of velocity, 1/s, and of position, by an error of position."""
    (velocity,), (position,) = MotorObserver(motor.framed, period_s, noise_rad).gain
    return velocity, position


def _in_comment(text: str) -> str:
    """A text that ends no comment of C."""
    return text.replace("*/", "* /").replace("/*", "/ *").replace("??/", "?? /")


C = Tool("C", files, NOT_RIGID)
