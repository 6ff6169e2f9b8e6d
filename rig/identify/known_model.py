"""The model that an earlier run left: what `rig run --model` begins with, and `rig design --model` designs for."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

from rig.estimators import LEADING
from rig.model.real_motor import FramedMotor
from rig.recording.errors import RecordingError
from rig.recording.folder import RESULT
from rig.recording.path_kind import no_run
from rig.recording.reader import read_result
from rig.results import EstimateResult, IdentificationResult, RunResult


def known_model(path: Path, largest_V: float) -> FramedMotor:
    """The motor of a run folder, or of its result.json: the leading estimate, with the laws that the run shows.

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
        motor = model_of(result)
    except ValueError as error:
        raise RecordingError(
            folder / RESULT, f"holds a model that no motor has: {error}", "give another run"
        ) from error
    if motor is None:
        raise RecordingError(
            folder / RESULT,
            f"holds no {LEADING} estimate that was not refused",
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


def model_of(result: RunResult | IdentificationResult) -> FramedMotor | None:
    """The leading estimate, with the laws that the tests show; None if there is none, or if it was refused.

    Raises ValueError on numbers out of range.
    """
    return _with_laws(result) or _plain(result.estimates.get(LEADING))


def _plain(estimate: EstimateResult | None) -> FramedMotor | None:
    """The plain motor of an estimate; None without a usable one. Raises ValueError on numbers out of range."""
    if estimate is None or estimate.verdict == "refused":
        return None
    numbers = {
        "tau_s": estimate.tau_s,
        "K_rad_s_V": estimate.K_rad_s_V,
        "fc_V": estimate.fc_V,
        "bias_V": estimate.asym_V or 0.0,
    }
    return FramedMotor.of({name: value for name, value in numbers.items() if value is not None})


def _with_laws(result: RunResult | IdentificationResult) -> FramedMotor | None:
    """The motor with its laws; None if the run shows none. Raises ValueError on numbers out of range."""
    plain, frame = _plain(result.with_law), result.law_frame
    if plain is None or not result.law or frame is None:
        return None
    numbers = {name: value for law in result.law for name, value in law.numbers.items() if value is not None}
    places = {"centre_rad": frame.centre_rad, "half_travel_rad": frame.half_travel_rad}
    known = {name: value for name, value in places.items() if value is not None}
    return FramedMotor.of(plain.numbers | numbers | known)
