"""Makes meta.json when a run begins, and result.json when it ends."""

from __future__ import annotations

import math
import operator
import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from rig.backends.clock import MonotonicClock, PacedClock
from rig.backends.emulated.shaft import ShaftPath
from rig.backends.registry import Bench, backend_of
from rig.config import Experiment
from rig.control.breakaway import BreakawayCheck
from rig.control.excitation import GainSearch, SettledCycle
from rig.control.rising_gains import RisingGains
from rig.core.faults import Fault
from rig.core.package import VERSION as RIG_VERSION
from rig.identification import Identification
from rig.identification.departures import DEPARTURES
from rig.model.bench import BenchParameters
from rig.model.real_motor import FramedMotor, plain
from rig.run_folder import results
from rig.run_folder.recording.stage import Stage
from rig.run_folder.results.identification import Answered
from rig.run_folder.results.meta import REHEARSAL
from rig.run_folder.results.part import VERSION
from rig.running.preflight import notes


@dataclass
class Findings:
    """What a run has found so far. A field is None or empty until its stage has run.

    real_time       what the machine granted the loop
    gains_V         gains (h1, h2) of the relay tests, V
    further_gains_V gains of a test at a third amplitude, V, if the gains were searched
    cycle           the limit cycle of the last relay test
    identification  of this run's recording
    models          that are driven: of this run, or as they are kept with ``models_from``
    models_from     another run whose models are driven
    tracking        by method; an empty one has come to its end, but nobody has measured its error yet
    real_motors     by method, the models with laws that tracked
    stopped         why the tests of `relay.until` ended
    shaft           where the emulated shaft really was, in the bench's own time and radians; None if nobody knows
    notes           what else there is to know, in words
    """

    real_time: results.RealTimeReport | None = None
    breakaway: BreakawayCheck | None = None
    search: GainSearch | RisingGains | None = None
    gains_V: tuple[tuple[float, float], ...] = ()
    further_gains_V: tuple[float, float] | None = None
    cycle: SettledCycle | None = None
    identification: Identification | None = None
    models: Answered | None = None
    models_from: Path | None = None
    jog: results.JogResult | None = None
    tracking: dict[str, results.TrackingResult] = field(default_factory=dict)
    real_motors: dict[str, FramedMotor] = field(default_factory=dict)
    shaft: ShaftPath | None = None
    stopped: results.StoppedResult | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def checked(self) -> BreakawayCheck:
        """The breakaway check. Raises ValueError if there was none."""
        if self.breakaway is None:
            raise ValueError("no test begins before the breakaway check")
        return self.breakaway


def run_meta(experiment: Experiment, bench: Bench, script: results.ScriptCall, started: datetime) -> results.RunMeta:
    """meta.json of a run that begins on an open bench."""
    info = bench.info
    measures_supply = not math.isnan(info.supply_V)
    backend = backend_of(experiment.device)
    watchdog_s = backend.watchdog(experiment.device).time_s
    emulated = experiment.emulated
    is_rehearsal = info.emulated and emulated is not None and emulated.rehearsal is not None
    return results.RunMeta(
        version=VERSION,
        name=experiment.name,
        backend=f"{'rehearsal, nothing real: ' if is_rehearsal else ''}{bench.driver.backend}",
        emulated=info.emulated,
        order=bench.driver.order,
        period_s=experiment.period_s,
        drive_units=info.drive_units,
        times_error_s=backend.times_error_s(experiment.device),
        firmware=results.DeviceSeen.of(
            info,
            supply_V=info.supply_V if measures_supply else None,
            supply_at_least=info.supply_at_least if measures_supply else None,
        ),
        drive=results.SupplyBelieved.of(experiment.drive),
        sensor=results.SensorBelieved.of(
            experiment.sensor, calibration_rad=tuple(sorted(rad for _, rad in experiment.sensor.points))
        ),
        failsafe="none: the device holds its last drive"
        if bench.driver.failsafe is None or watchdog_s is None
        else f"device watchdog, {watchdog_s * 1e3:.0f} ms",
        started_utc=started.isoformat(timespec="milliseconds"),
        versions={"rig": RIG_VERSION, "python": platform.python_version()},
        host={"system": platform.platform(), "machine": platform.machine()},
        command=" ".join(sys.argv),
        truth=true_motor(bench),
        rehearsal=is_rehearsal or None,
        time=run_time(bench),
        script=script,
        identify_without=experiment.identify.without or None,
    )


def run_time(bench: Bench) -> results.RunTime:
    """The time of an open bench, with its stalls so far."""
    clock = bench.clock
    if isinstance(clock, PacedClock):
        return results.RunTime.of(clock, kind="virtual")
    return results.RunTime(kind="real" if isinstance(clock, MonotonicClock) else "virtual")


def run_result(
    experiment: Experiment,
    meta: results.RunMeta,
    told: Mapping[str, object],
    loop: results.LoopResult,
    found: Findings,
    fault: Fault | None,
) -> results.RunResult:
    """result.json of a run that has come to its end or to a fault; ``told``: the driver's counts."""
    own = found.identification
    link, not_counts = _link_counts(told)
    return results.RunResult(
        version=VERSION,
        backend=meta.backend,
        rehearsal=meta.rehearsal,
        answer=_answer(found),
        estimates=_estimates(found),
        relays=() if own is None else tuple(own.relays),
        tracking=dict(found.tracking),
        loop=loop.model_copy(update={"real_time": found.real_time}),
        link=link,
        faults=_faults(fault),
        config_notes=tuple(notes(experiment.device)),
        notes=(*_notes(found), *not_counts),
        hysteretic=None if own is None else _hysteretic(own, experiment),
        models_from=None if found.models_from is None else str(found.models_from),
        breakaway=None if found.breakaway is None else _breakaway(found.breakaway, own),
        friction_map=None if own is None or own.friction_map is None else own.friction_map.as_result(),
        **({} if own is None else own.evidence),
        jog=found.jog,
        search=None
        if found.search is None
        else tuple(results.SearchStepResult(**step._asdict()) for step in found.search.steps),
        stopped=found.stopped,
        truth=meta.truth,
    )


def least_result(
    meta: results.RunMeta, loop: results.LoopResult, notes: list[str], fault: Fault | None
) -> results.RunResult:
    """result.json of a run whose findings cannot be written: backend, loop, fault and notes."""
    return results.RunResult(
        version=VERSION,
        backend=meta.backend,
        rehearsal=meta.rehearsal,
        answer=None,
        estimates={},
        relays=(),
        tracking={},
        loop=loop,
        link={},
        faults=_faults(fault),
        config_notes=(),
        notes=tuple(notes),
    )


def true_motor(bench: Bench) -> results.TrueMotor | None:
    """The emulated motor's parameters, under an estimate's names; None if the motor is real.

    With viscous friction, tau_s and K_rad_s_V include it, as the motion shows them. The values without it stand beside.
    """
    if bench.truth is None:
        return None
    motor = bench.truth.motor
    friction = motor.friction
    has_viscous = friction.viscous_V_s_rad > 0.0
    return results.TrueMotor(
        tau_s=motor.tau_eff_s,
        K_rad_s_V=motor.K_eff_rad_s_V,
        fc_V=friction.fc_V,
        asym_V=motor.asym_V,
        static_plus_V=friction.static_plus_V - motor.bias_V,
        static_minus_V=friction.static_minus_V + motor.bias_V,
        stribeck_rad_s=friction.stribeck_rad_s if friction.stribeck_rad_s > 0.0 else None,
        viscous_V_s_rad=friction.viscous_V_s_rad if has_viscous else None,
        tau_without_viscous_s=motor.tau_s if has_viscous else None,
        K_without_viscous_rad_s_V=motor.K_rad_s_V if has_viscous else None,
        law=true_laws(bench.truth),
    )


def true_laws(bench: BenchParameters) -> tuple[results.TrueLaw, ...] | None:
    """What the bench's motor has beyond tau, K and Coulomb friction, as the laws that `rig identify` finds.

    None where its static friction or Stribeck effect differs by direction: no law has that.
    """
    try:
        motor = plain(bench.motor) if bench.real is None else bench.real
    except ValueError:
        return None
    found = []
    for law in DEPARTURES:
        values = [getattr(motor, name) for name in law.numbers]
        if any(values):
            size = values[0] if len(values) == 1 else math.hypot(*values)
            numbers = {name: getattr(motor, name) for name in law.fields}
            found.append(results.TrueLaw(name=law.name, value=size, unit=law.unit, numbers=numbers))
    return tuple(found)


def _estimates(found: Findings) -> dict[str, results.EstimateResult]:
    """The estimates; those of another run have no rows in this one."""
    if found.identification is not None:
        return {method: estimate.as_result() for method, estimate in found.identification.estimates.items()}
    others = {} if found.models is None else found.models.estimates
    return {method: estimate.model_copy(update={"rows": None}) for method, estimate in others.items()}


def _answer(found: Findings) -> results.Answer | None:
    """The answer; that of another run has no rows in this one."""
    if found.identification is not None:
        return found.identification.answer
    answer = None if found.models is None else found.models.answer
    return None if answer is None else answer.model_copy(update={"rows": None})


def _faults(fault: Fault | None) -> tuple[results.FaultReport, ...]:
    return () if fault is None else (results.FaultReport(**fault.as_dict()),)


def _link_counts(told: Mapping[str, object]) -> tuple[dict[str, int], list[str]]:
    """The driver's counts, and a note on each that is no whole number: other packages may give any value."""
    counts, notes = {}, []
    for name, value in told.items():
        try:
            counts[str(name)] = operator.index(int(value) if isinstance(value, float) and value.is_integer() else value)  # type: ignore[arg-type]  # refused below
        except TypeError:
            notes.append(f"the driver counts {name!r} as {value!r}, which is no whole number: left out of `link`")
    return counts, notes


def _notes(found: Findings) -> tuple[str, ...]:
    if found.models_from is not None:
        made_up = getattr(found.models, "rehearsal", None)
        words = f"the models come from {found.models_from}{f', {REHEARSAL}' if made_up else ''}"
        return (*found.notes, words)
    return (*found.notes, *([] if found.identification is None else found.identification.notes))


def _hysteretic(own: Identification, experiment: Experiment) -> tuple[results.HystereticResult, ...] | None:
    """The hysteretic runs, with the hysteresis that the config asked for; None if there are none."""
    eps_rad = {str(Stage.hysteretic(k)): run.eps_rad for k, run in enumerate(experiment.relay.hysteretic or (), 1)}
    runs = tuple(run.model_copy(update={"eps_rad": eps_rad.get(run.stage)}) for run in own.hysteretic)
    return runs or None


def _breakaway(check: BreakawayCheck, own: Identification | None) -> results.BreakawayResult:
    """What the breakaway check saw, and what was identified from it."""
    seen = results.BreakawayResult(seen_plus_V=check.plus_V, seen_minus_V=check.minus_V, noise_rad=check.noise_rad)
    if own is None or own.breakaway is None:
        return seen
    static = own.breakaway
    return seen.model_copy(update={name: getattr(static, name) for name in type(static).model_fields})
