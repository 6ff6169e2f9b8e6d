"""The model that an earlier run left: what `rig run --model` begins with, and `rig design --model` designs for."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

from rig.model.real_motor import Frame, FramedMotor, RealMotor
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import RESULT
from rig.run_folder.recording.path_kind import no_run
from rig.run_folder.recording.reader import MOST_BYTES, read_object, read_result
from rig.run_folder.recording.text_file import content_of
from rig.run_folder.results import Answer, EstimateResult, IdentificationResult, known
from rig.run_folder.results.identification import Answered
from rig.run_folder.results.salvage import salvaged

_NO_MOTOR = "holds a model that no motor has"
OF_PLACE = ("centre_rad", "half_travel_rad")  # the part of a frame that another run shares


def known_model(path: Path, largest_V: float) -> FramedMotor:
    """The motor of a run folder, or of its result.json: its answer, with the laws that the run shows.

    largest_V   the largest drive of the bench that it is for, V
    Raises RecordingError where there is none, where it was refused, or where that drive does not move it.
    """
    folder = path.parent if path.name == RESULT else path
    result, _ = read_result(folder)
    if result is None:
        if (folder / "samples.csv").exists():
            raise RecordingError(
                folder,
                f"has no {RESULT}: the run was killed before its motor was identified",
                "give another run; `rig identify` reads what this one recorded",
            )
        nothing = no_run(path)
        raise nothing
    try:
        motor = model_of(result.answer)
    except ValueError as error:
        raise RecordingError(folder / RESULT, f"{_NO_MOTOR}: {error}", "give another run") from error
    if motor is None:
        raise RecordingError(
            folder / RESULT,
            "holds no motor that was not refused",
            f"see why: `rig identify {quote(str(folder))}`; or give another run",
        )
    needed_V = motor.motor.fc_V + abs(motor.motor.bias_V)
    if needed_V >= largest_V:
        raise RecordingError(
            folder / RESULT,
            f"holds a motor that takes {needed_V:.3g} V to keep moving, and drive.max_V is {largest_V:.3g} V",
            "give a run of this bench, or correct drive.max_V",
        )
    return motor


def plain_motor(estimate: EstimateResult) -> FramedMotor:
    """Its tau, K and f_c, with its asymmetry, where it has one, as a bias. Raises ValueError where one is not known."""
    bias_V = 0.0 if estimate.asym_V is None else known(estimate.asym_V)
    numbers = RealMotor(known(estimate.tau_s), known(estimate.K_rad_s_V), known(estimate.fc_V), bias_V)
    return FramedMotor(numbers, Frame())


def is_printed(path: Path) -> bool:
    """Whether a path is a file, and not the result.json of a run: what `rig identify --json` printed, if anything."""
    return path.is_file() and path.name != RESULT


def printed(path: Path) -> IdentificationResult:
    """What `rig identify --json` printed into a file. Raises RecordingError where it is none."""
    if not content_of(path, MOST_BYTES).lstrip().startswith(b"{"):
        name = quote(str(path))
        raise RecordingError(
            path, "is no answer", f"if it is a recording, type: rig identify {name} --json > found.json; then give that"
        )
    return salvaged(IdentificationResult, read_object(path))[0]


def answer_in(path: Path) -> Answer:
    """The answer of a run folder, of its result.json, or of what `rig identify --json` printed into a file.

    Raises RecordingError where there is none.
    """
    if is_printed(path):
        answer = printed(path).answer
    else:
        of_run, _ = read_result(path.parent if path.name == RESULT else path)
        answer = None if of_run is None else of_run.answer
    if answer is None:
        raise RecordingError(
            path, "holds no answer", "give a run folder that has one, or a file: `rig identify LOG --json > found.json`"
        )
    return answer


def kept_models(folder: Path) -> Answered | None:
    """The answer of a run folder, and the plain motors of each method, as its result.json has them.

    None where the run was killed before it had them. Raises RecordingError, also for numbers that no motor has.
    """
    result, _ = read_result(folder)
    if result is None or result.answer is None:
        return None
    try:
        model_of(result.answer, in_its_time=True)
        for estimate in result.estimates.values():
            if not estimate.is_refused and estimate.tau_s is not None:
                plain_motor(estimate)
    except ValueError as error:
        raise RecordingError(folder / RESULT, f"{_NO_MOTOR}: {error}", "give another run") from error
    return result


def model_of(answer: Answer | None, *, in_its_time: bool = False) -> FramedMotor | None:
    """The motor of an answer, with its laws; None if there is none, if it is refused, or lacks tau, K or f_c.

    in_its_time   for the records that it was fitted to: drift refers to their time
    Raises ValueError on numbers out of range.
    """
    if answer is None or answer.is_refused:
        return None
    plain = {name: answer.value(name) for name in ("tau_s", "K_rad_s_V", "fc_V")}
    if None in plain.values():
        return None
    laws: dict[str, float | None] = {}
    if answer.law and answer.law_frame is not None:
        laws = {name: value for law in answer.law for name, value in law.numbers.items()}
        places = Frame._fields if in_its_time else OF_PLACE
        laws |= {name: getattr(answer.law_frame, name) for name in places}
    numbers = plain | {"bias_V": answer.asym_V} | laws
    return FramedMotor.of({name: known(value) for name, value in numbers.items() if value is not None})
