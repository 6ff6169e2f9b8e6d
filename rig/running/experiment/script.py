"""The experiment as a script: breakaway -> search -> relay -> identify -> verify, and the parts that run alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from rig.backends.registry import Bench, backend_of, connect
from rig.config import Experiment
from rig.control.law import Timed, named_law
from rig.control.loop.stop_request import Gone
from rig.control.sweep_plan import TooShortError
from rig.core.faults import Fault
from rig.model.real_motor import FramedMotor
from rig.run_folder.live.stop_flag import StopFlag
from rig.run_folder.results import ScriptCall
from rig.run_folder.results.identification import Answered
from rig.running.experiment import stages
from rig.running.experiment.law_watch import watched
from rig.running.experiment.survey import survey, tell_apart
from rig.running.experiment.until import drive_until
from rig.running.preflight.room_to_stop import expected_sweeps
from rig.running.session import OnStart, Outcome, Script, Session, record

BREAKAWAY_LAW = "balanced pairs, in the device's steps"  # in meta.json, so that a replay knows which law ran
SEARCH_LAW = "gains of both tests"  # the same of the gain search


def run(
    experiment: Experiment,
    parent: Path,
    on_start: OnStart | None = None,
    again: Bench | None = None,
    known: FramedMotor | None = None,
    series: StopFlag | None = None,
) -> Outcome:
    """The whole experiment; if the config has a section `law`: the breakaway check and that law.

    parent    folder in which the run folder is made
    on_start  called once with the run folder and the first notes
    again     a bench that the same command has opened already
    known     with `relay.until`: the motor, as far as an earlier run knows it
    series    as of ``record``
    """
    law = experiment.law
    if law is not None:
        what, script = _under(Timed(named_law(law.name, law.options), law.duration_s, law.name))
    else:
        more = [tell_apart] if experiment.identify.thorough else []
        script = _in_turn(partial(_drive_tests, known=known), stages.identify_recorded, *more, stages.verify_models)
        what = _named("run")
    return record(experiment, parent, what, script, on_start, again, series=series)


def run_law(experiment: Experiment, law: Timed, parent: Path) -> Outcome:
    """The breakaway check, and then a law of the user's own, under the guard and the limits of the config."""
    return record(experiment, parent, *_under(law), None)


def _under(law: Timed) -> tuple[ScriptCall, Script]:
    """The breakaway check, and then this law, watched."""

    def script(session: Session) -> None:
        with watched(session, law) as one:
            stages.drive_law(session, one)

    return ScriptCall(name="law", breakaway=BREAKAWAY_LAW, law=law.name, duration_s=law.duration_s), script


def repeated(
    experiment: Experiment,
    number: int,
    parent: Path,
    perform: Callable[[Callable[[OnStart], Outcome]], Outcome],
    known: FramedMotor | None = None,
) -> list[Outcome]:
    """Do ``run`` ``number`` times, each through ``perform``. A fault, a failure, a signal or a Stop ends the series.

    One stop flag goes with the series from run to run, so a Stop between two of them, or while a report is written,
    counts, too.
    A person gives this command once. So if a device latches an e-stop between two runs, that ends the series: the next
    run must not acknowledge it. A real bench stays open from the first run to the last, since opening a device clears
    or resets it. An emulated bench starts anew, with the next seed.
    Raises Fault LATCHES_NOTHING for a real device that latches no e-stop, and as ``run``.
    """
    d = experiment.device
    outcomes: list[Outcome] = []

    def one(e: Experiment, bench: Bench | None) -> bool:
        outcomes.append(perform(lambda on_start: run(e, parent, on_start, bench, known, flag)))
        return outcomes[-1].fault is None and not outcomes[-1].failures

    with StopFlag() as flag:
        if number == 1:
            one(experiment, None)
        elif backend_of(d).is_emulated(d):
            for k in range(number):
                if not one(experiment.model_copy(update={"seed": experiment.seed + k}), None):
                    break
        else:
            with connect(d) as bench:
                if not bench.info.emulated and not getattr(bench.driver, "latches_stops", False):
                    raise Fault("LATCHES_NOTHING", bench.driver.backend)
                for k in range(number):
                    opened = bench if k == 0 else replace(bench, info=replace(bench.info, acknowledged=()))
                    if not one(experiment, opened):
                        break
    return outcomes


def run_relay(experiment: Experiment, parent: Path, on_start: OnStart | None = None) -> Outcome:
    """Breakaway, gain search and relay tests, then identification; no tracking."""
    return record(experiment, parent, _named("relay"), _in_turn(_drive_tests, stages.identify_recorded), on_start)


def run_survey(experiment: Experiment, parent: Path, on_start: OnStart | None = None) -> Outcome:
    """Breakaway, one relay test, the survey, then identification and the friction map.

    Raises Fault NO_SWEEPS if the config leaves no room for sweeps.
    """
    try:
        expected_sweeps(experiment)
    except TooShortError as error:
        raise Fault("NO_SWEEPS", str(error)) from error
    if not experiment.relay.has_tests:
        raise Fault("NO_SWEEPS", "the sweeps need a test before them: give relay.until, relay.target or relay.gains")
    first: Script = stages.drive_one_test if experiment.relay.until is None else drive_until
    return record(experiment, parent, _named("survey"), _in_turn(first, survey, stages.identify_recorded), on_start)


def run_breakaway(
    experiment: Experiment, parent: Path, on_start: OnStart | None = None, gone: Gone | None = None
) -> Outcome:
    """The breakaway check alone: does the bench arm, and does the shaft move in the right direction?

    gone  who has to be there while it drives, and is not: as of ``StopRequest``
    """
    return record(experiment, parent, _named("breakaway"), stages.drive_check, on_start, gone=gone)


def run_tracking(
    experiment: Experiment, models: Answered, models_from: Path, parent: Path, on_start: OnStart | None = None
) -> Outcome:
    """Breakaway and the tracking check, with the models of an earlier run, ``models_from``."""

    def script(session: Session) -> None:
        session.found.models, session.found.models_from = models, models_from
        stages.drive_check(session)
        stages.verify_models(session)

    return record(experiment, parent, _named("track"), script, on_start)


def jog(
    experiment: Experiment, u_V: float, duration_s: float, parent: Path, on_start: OnStart | None = None
) -> Outcome:
    """A constant drive for a short time, within the limits; outside them only inward."""
    script = partial(stages.drive_by_hand, u_V=u_V, duration_s=duration_s)
    return record(experiment, parent, ScriptCall(name="jog", u_V=u_V, duration_s=duration_s), script, on_start)


def jog_leased(experiment: Experiment, longest_s: float, parent: Path, on_start: OnStart | None = None) -> Outcome:
    """A jog that goes on only while somebody renews a lease in the run folder (``rig.run_folder.live.lease``)."""
    what = ScriptCall(name="jog", duration_s=longest_s, leased=True)
    return record(experiment, parent, what, partial(stages.drive_by_lease, longest_s=longest_s), on_start)


def _in_turn(*parts: Script) -> Script:
    """These parts of a run, one after the other."""

    def script(session: Session) -> None:
        for part in parts:
            part(session)

    return script


def _drive_tests(session: Session, known: FramedMotor | None = None) -> None:
    if session.experiment.relay.until is None:
        stages.drive_tests(session)
    else:
        drive_until(session, known)


def _named(script: str) -> ScriptCall:
    """What meta.json says of a script with a breakaway check."""
    if script in ("run", "relay"):
        return ScriptCall(name=script, breakaway=BREAKAWAY_LAW, search=SEARCH_LAW)
    return ScriptCall(name=script, breakaway=BREAKAWAY_LAW)
