"""The Python API: what `import rig` offers. No logic lives here: the functions call what the commands call."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, overload

from numpy.typing import ArrayLike

from rig.backends.links.device_file import require_device_file
from rig.config import ready as ready_configs
from rig.config.load import Given
from rig.control import simulation
from rig.control.law import OwnLaw, Timed
from rig.control.relay import DualChannelRelay
from rig.control.simulation import Drive, Sampling
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.identification import identify as identify_recordings
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.model.prediction import predict_cycle
from rig.model.real_motor import RealMotor
from rig.notebook import Compared, Found, Prediction, Run
from rig.output.compare.comparison import CompareError, Scatter
from rig.output.compare.comparison import compare as compare_folders
from rig.run_folder.recording import reader
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.path_kind import require_distinct
from rig.run_folder.recording.reader import recordings_of
from rig.run_folder.recording.recording import Recording
from rig.run_folder.results import JsonObject
from rig.running import preflight
from rig.running.experiment import script as experiment
from rig.running.replay import Replay
from rig.running.replay import replay as replay_folder
from rig.running.session import Outcome

__all__ = [
    "CompareError",
    "Compared",
    "Fault",
    "Found",
    "Motor",
    "Prediction",
    "RealMotor",
    "Run",
    "Sample",
    "Sampling",
    "compare",
    "coulomb",
    "identify",
    "predict",
    "read",
    "ready",
    "relay",
    "replay",
    "run",
    "simulate",
]

AnyPath = str | PathLike[str]
WANTED = "rig.identify takes one run, a path, a list of them, or t, u and y"


def read(path: AnyPath) -> Run:
    """Read a run folder, or a CSV file with the columns t_s, u_V and y_rad. Raises RecordingError."""
    recording = reader.read(Path(path))
    result, notes = reader.read_result(recording.source) if recording.config_text is not None else (None, [])
    recording = replace(recording, notes=(*recording.notes, *notes))
    faults = () if result is None else result.faults
    return Run.of(recording, result, "; ".join(str(Fault(fault.code, fault.detail)) for fault in faults))


@overload
def identify(
    data: Recording | AnyPath | Sequence[Recording | AnyPath],
    *,
    methods: Sequence[str] | None = None,
    without: Sequence[str] = (),
) -> Found: ...
@overload
def identify(
    data: ArrayLike, u: ArrayLike, y: ArrayLike, t_u: ArrayLike | None = None, *, methods: Sequence[str] | None = None
) -> Found: ...
def identify(
    data: Any,
    u: ArrayLike | None = None,
    y: ArrayLike | None = None,
    t_u: ArrayLike | None = None,
    *,
    methods: Sequence[str] | None = None,
    without: Sequence[str] = (),
) -> Found:
    """Identify gain, time constant and friction of one motor.

    data     a run, or the path of a run folder or a CSV file; several in a list are recordings of one motor. Or, with
             ``u`` and ``y``, the times of n samples, s, rising
    u        n drives, V: each acts from its time in ``t_u`` until the next
    y        n positions, rad
    t_u      n times from which the drives act, s; default: unknown, a constant delay after the samples
    methods  names of estimators; default: all that the data allow
    without  names of stages of the run that are not read, such as "breakaway", "search" and "relay-2"
    Raises IdentifyError where the data give no estimate or have no such stage, RecordingError where they cannot be
    read, TypeError for arguments that are none of these.
    """
    recordings = recordings_of(data, u, y, t_u, WANTED)
    return Found.of(identify_recordings(recordings, methods, without=without))


def simulate(motor: Motor | RealMotor, drive: Drive, duration_s: float, sampling: Sampling | None = None) -> Run:
    """Drive a motor on this machine; what it shows is as if it had been read: ``rig.identify`` takes it.

    motor       ``rig.Motor(tau_s, K_rad_s_V, rig.coulomb(fc_V))``, or ``found.best.motor()``, or one with parts:
                ``rig.RealMotor(tau_s, K_rad_s_V, fc_V, backlash_rad=0.01)``
    drive       a law, such as ``rig.relay(h1_V, h2_V)``; a function of the time in s that gives volts; volts, one for
                each sample; or constant volts
    duration_s  how long, s
    sampling    period, delay, noise and so on; default: ``rig.Sampling()``
    What the law raises goes through. Raises ValueError where there would be fewer than three samples, or a drive is no
    number.
    """
    return Run.of(simulation.simulate(motor, drive, duration_s, sampling))


def relay(h1_V: float, h2_V: float) -> DualChannelRelay:
    """The relay u = -h1 sgn(y) - h2 sgn(z), with z the integral of the position y. Raises ValueError below 0 V."""
    return DualChannelRelay(h1_V, h2_V, math.inf)


def predict(
    *, tau_s: float, K_rad_s_V: float, fc_V: float, h1_V: float, h2_V: float, fs_V: float | None = None
) -> JsonObject:
    """The limit cycle that theory expects under ``rig.relay(h1_V, h2_V)``, by the names of `rig predict --json`.

    tau_s, K_rad_s_V  time constant, s, and gain, (rad/s)/V, > 0
    fc_V, fs_V        Coulomb and static friction, V; static by default as Coulomb friction
    Raises ValueError on parameters out of range.
    """
    return predict_cycle(tau_s, K_rad_s_V, fc_V, fc_V if fs_V is None else fs_V, h1_V, h2_V).as_json()


def run(config: Given, law: OwnLaw | None = None, *, duration_s: float = 10.0, out: AnyPath = "runs") -> Run:
    """Run the whole experiment of a config; or, with a law, the breakaway check and then that law.

    config      a file, such as ``rig.ready("simulated")``, or a mapping with the same keys
    law         any object with ``step(sample)`` that gives volts; the guard and the limits of the config hold for it
    duration_s  after which the law ends, s; it ends before where it says ``finished``
    out         the folder that the run folder is made in
    Returns the run. Whatever ends it, the drive is stopped and the recording is kept: ``failure`` says what went wrong.
    Raises ConfigError for a config that must not be run, Fault where the bench cannot be opened, RecordingError where
    there can be no run folder.
    """
    checked, _ = preflight.check(config)
    require_device_file(checked.daq.port)
    if law is None:
        return _as_run(experiment.run(checked, Path(out)))
    own = Timed(law, duration_s, type(law).__name__)
    # the run folder keeps the config: it must not name a law that did not run
    return _as_run(experiment.run_law(checked.model_copy(update={"law": None}), own, Path(out)))


def _as_run(outcome: Outcome) -> Run:
    """The run as it was recorded. A law's traceback goes to stderr. Raises its fault where there is no recording."""
    sys.stderr.write(outcome.traceback)
    try:
        recording = reader.read_run(outcome.folder)
    except RecordingError as error:
        raise (outcome.fault or error) from error
    return Run.of(recording, outcome.result, outcome.failure)


def replay(run: Run | AnyPath, law: OwnLaw | None = None) -> Replay:
    """Feed a run's recording through laws and guard again: ``is_same``, or the first ``difference``.

    run  a run, or the path of its folder
    law  of ``rig.run(config, law=...)``: made anew, since a law remembers; a law that the config names is found
    Raises RecordingError where the folder cannot be read, or lacks what a replay needs; ConfigError for its config.
    """
    return replay_folder(run.folder if isinstance(run, Run) else Path(run), own=law)


def compare(
    runs: Sequence[Run | AnyPath],
    *,
    scatter_percent: tuple[float, float, float] | None = None,
    temperatures_C: Mapping[str, float] | None = None,
) -> Compared:
    """Compare runs: is it one motor?

    runs             runs of ``rig.run`` or ``rig.read``, or paths of run folders; two or more
    scatter_percent  standard deviation of tau, K and f_c from run to run of one motor, %; default: that of the other
                     runs where there are five or more, else what 2.5 K do to copper and magnet
    temperatures_C   in degrees Celsius, by the names of run folders, for the trend over temperature
    Raises CompareError where fewer than two can be compared, RecordingError for a path that is no run, ValueError for a
    scatter outside of 0 to 100 %.
    """
    folders = [one.folder if isinstance(one, Run) else Path(one) for one in runs]
    require_distinct(folders)
    scatter = None if scatter_percent is None else Scatter(scatter_percent, "given as scatter_percent")
    return Compared.of(compare_folders(folders, scatter, temperatures_C))


def ready(name: str) -> Path:
    """The path of a ready config, such as "simulated". Raises UnknownConfigError."""
    ready_configs.text(name)  # it knows the names
    return ready_configs.folder() / f"{name.removesuffix('.yaml')}.yaml"
