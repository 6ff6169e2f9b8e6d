"""The stages of an experiment, each on an open session: arming, breakaway, search, relay tests, tracking.

A stage raises Fault to end the run: the loop's faults, and START_OUTSIDE, CONFIG_MISMATCH or DRIVE_TOO_SMALL if it
cannot begin. It raises ValueError if it is called out of order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace

from rig.backends.clock import MonotonicClock, PacedClock
from rig.backends.driver import PulseDriver, ReckonedTimes, RelayCommand, RelayDriver
from rig.config import Experiment
from rig.config.schema import Method
from rig.control.breakaway import BreakawayCheck, BreakawayFound
from rig.control.excitation import CycleTarget, GainSearch, RelayTest, SearchRange, SettledCycle
from rig.control.homing import Homing
from rig.control.hysteretic import HystereticRun
from rig.control.known_motor import NOT_COMPENSATED
from rig.control.law import Constant, Law, Rest, Timed
from rig.control.leased_jog import LeasedDrive
from rig.control.loop.pre_run import PreRunBench, Rehearsed, pre_run
from rig.control.loop.real_time import RealTime, real_time
from rig.control.observer import MotorObserver
from rig.control.relay import DualChannelRelay, HystereticRelay, RelayOnCounts
from rig.control.rising_gains import RisingGains
from rig.control.tracking import Tracking
from rig.control.trajectory import SumOfSines
from rig.control.unshown import STILL_S, Flicker, UnshownMotion
from rig.core.estimators import LEADING
from rig.core.faults import Fault
from rig.core.signals import BenchDelay, percent
from rig.identification import identify
from rig.identification.known_model import model_of, plain_motor
from rig.identification.preprocessing import from_recording
from rig.identification.stroke_delay import strokes_delay
from rig.model.cycle_detector import CycleDetector
from rig.model.real_motor import FramedMotor
from rig.run_folder.live.lease import NAME as LEASE
from rig.run_folder.live.lease import HeldLease
from rig.run_folder.recording.errors import IdentifyError, RecordingError
from rig.run_folder.recording.stage import Stage, StageKind
from rig.run_folder.results import JogResult, RealTimeReport, TrackingResult
from rig.run_folder.results.answer_words import beyond_drive
from rig.run_folder.results.result import NO_ESTIMATE
from rig.running.experiment.tracked import FADE_S, tracking_errors
from rig.running.experiment.which_way import strokes_move_against
from rig.running.preflight.breakaway_strokes import FRICTION_DIFFERS, breakaway_strokes
from rig.running.preflight.room_to_stop import (
    counted_delay_s,
    expected_delay_s,
    guard_settings_of,
    reach_rad,
    room_for_delay_s,
    swing_rad,
)
from rig.running.session import Session, beside_data_sheet, real_time_of

REST_S = 0.7
FLICKERS_LSB = 0.7  # noise of a reading that, in 30 samples at rest, stays the same less often than once in 10^5
FLICKER_SAMPLES = 30  # the same reading in so many samples is what FLICKERS_LSB says
RELAY_TIMEOUT_PERIODS = 5.0  # for each cycle that a relay test is to record
HOMING_TIMEOUT_S = 40.0
START_REST_S = 0.5  # recorded before a hysteretic relay's first drive
HYSTERETIC_SWITCHINGS = 6  # least squares takes the motion up to the first, the sampled-data estimator all of it
HYSTERETIC_TIMEOUT_S = 10.0  # for each


def drive_tests(session: Session) -> None:
    """Breakaway check, relay tests and hysteretic runs: all that is identified."""
    with _checked(session):
        test_relays(session)
        test_hysteretic(session)


def drive_one_test(session: Session) -> None:
    """Breakaway check and the first relay test: what a survey needs."""
    with _checked(session):
        test_relays(session, most=1)


def drive_check(session: Session) -> None:
    """The breakaway check alone."""
    with prepared(session):
        armed_check(session)


def drive_law(session: Session, law: Timed) -> None:
    """A law of a user's own, from rest, after the breakaway check."""
    with _checked(session):
        session.note("law", name=law.name, duration_s=law.duration_s)
        session.loop.run(law, str(StageKind.LAW))
        session.loop.run(Rest(REST_S), "rest")


def drive_by_hand(session: Session, u_V: float, duration_s: float) -> None:
    """A constant drive, as ``_jog``."""
    _jog(session, Constant(u_V, duration_s))


def _jog(session: Session, law: Law) -> None:
    """A law between two rests, within the limits; outside them only inward."""
    loop = session.loop
    loop.guard.recovering = True
    with driving(session):
        loop.run(Rest(0.1), "rest")
        from_rad = loop.last_y_rad
        loop.run(law, "jog")
        loop.run(Rest(REST_S), "rest")
        session.found.jog = JogResult(from_rad=from_rad, to_rad=loop.last_y_rad, refused_ticks=loop.guard.clipped_ticks)


def drive_by_lease(session: Session, longest_s: float, recorded: Callable[[int], float | None] | None = None) -> None:
    """A drive by leases, as ``_jog``.

    longest_s  the jog ends after this time, s, whoever renews a lease
    recorded   in a replay: the drive by its row, V; None: the jog ended there
    Raises Fault CONFIG_MISMATCH in virtual time, RECORDER_DEAD where the folder cannot hold the lease.
    """
    loop = session.loop

    def changed(u_V: float | None) -> None:
        session.note("lease", row=loop.rows, u_V=u_V)

    def drive(promised: Callable[[], float | None]) -> None:
        _jog(session, LeasedDrive(promised, changed, longest_s))

    if recorded is not None:
        drive(lambda: recorded(loop.rows))
        return
    if not isinstance(session.bench.clock, MonotonicClock | PacedClock):
        raise Fault("CONFIG_MISMATCH", "a lease runs out in real time, for which virtual time does not wait: --pace 1")
    try:
        held = HeldLease(session.folder)
    except OSError as error:
        raise Fault("RECORDER_DEAD", f"no {LEASE} in {session.folder}: {error.strerror}") from error
    with held:
        drive(held.u_V)
    if held.refused:
        session.found.notes.append(f"{held.refused} leases were refused: of more than 150 ms, or without a drive")


@contextmanager
def driving(session: Session) -> Iterator[None]:
    """Arm the device for the block. If time is real, set this process up for real time."""
    with prepared(session), session.loop.armed(session.experiment.device.arming):
        yield


@contextmanager
def _checked(session: Session) -> Iterator[None]:
    """As ``driving``, after the breakaway check, which arms the device with its own watchdog time."""
    with prepared(session):
        armed_check(session)
        with session.loop.armed(session.experiment.device.arming):
            yield


def armed_check(session: Session) -> None:
    """The breakaway check. Its device ends each stroke itself, which bounds unseen travel even if the host dies in one.

    A device that cannot is armed with a short watchdog, which ends the stroke and the run.
    """
    e = session.experiment
    limits = e.device.arming
    strokes = None if e.motor is None else breakaway_strokes(e)
    driver = session.bench.driver
    if strokes is not None and not (isinstance(driver, PulseDriver) and driver.pulses):
        limits = replace(limits, watchdog_s=strokes.watchdog_s)
    try:
        with session.loop.armed(limits):
            check_breakaway(session)
    except Fault as fault:
        if fault.code in ("NO_MOTION", "POLARITY", "LOAD_TURNS"):
            _explain_by_delay(session, fault)
        raise
    _take_delay(session)


def _take_delay(session: Session) -> None:
    """Measure the bench's delay by the strokes, and let guard and loop count with it. Raises Fault DELAY."""
    e, check = session.experiment, session.found.checked
    is_run = session.delay is None  # in a replay it is known from the begin, and the strokes are not looked at again
    delay = _delay_of(session, check.reported_delay_s, check.noise_rad)
    if is_run:
        _look_at_bridge(session, check.noise_rad, delay)
    counted_s = counted_delay_s(e.device, delay)
    if counted_s > max(room_for_delay_s(e), 0.0):
        raise Fault("DELAY", no_room_words(e, delay))
    session.loop.guard.learn(guard_settings_of(e, check.noise_rad, delay))
    session.loop.expect_delay(delay.reported_s)
    if counted_s > 0.0:
        session.found.notes.append(
            f"{delay_words(delay)}: the guard brakes {1e3 * counted_s:.0f} ms earlier for it, and tracking predicts "
            "over it"
        )


def _look_at_bridge(session: Session, noise_rad: float, delay: BenchDelay) -> None:
    """Note a bridge that lets the motor run free while PWM is low, where the strokes show it beyond doubt."""
    e = session.experiment
    if e.motor is None or e.drive.bridge == "in1-in2":
        return
    try:
        recording = session.read()
        series, _ = from_recording(recording, recording.stage_rows(str(StageKind.BREAKAWAY)), "breakaway")
    except (IdentifyError, RecordingError):
        return
    from rig.running.experiment.free_running import free_running  # scipy.optimize loads slowly; nothing is armed now

    full_V, further_s = e.drive.supply_V - e.drive.bridge_drop_V, delay.further_s
    found = free_running(
        series,
        noise_rad,
        e.sensor.curve.lsb_rad,
        full_V,
        e.motor.no_load_speed_rad_s,
        further_s[1] if delay.is_shown and further_s is not None else 0.0,
    )
    if found is not None and found.is_certain:
        session.found.notes.append(
            "the strokes of the breakaway check show that the bridge lets the motor run free while PWM is low: nothing "
            f"but friction braked the shaft, though with motor.no_load_speed_rad_s {e.motor.no_load_speed_rad_s:g} its "
            f"tau is at most {found.tau_s:.2g} s. An L298N with PWM on its enable does so, and rig would "
            "measure another motor. With the motor's supply off, put the jumper back on ENA, move the wires of IN1 and "
            "IN2 to the two PWM pins (Uno: D9 and D10; Pico: GP16 and GP17), and flash with --bridge in1-in2 "
            "(docs/real-bench.md). Or motor.no_load_speed_rad_s is less than half the true speed: then correct it"
        )


def _explain_by_delay(session: Session, fault: Fault) -> None:
    """Raise Fault DELAY if the strokes did move the shaft, but later than the check looks; ``fault`` is what it saw."""
    noise_rad = max(session.loop.guard.settings.noise_rad, session.experiment.sensor.curve.lsb_rad)
    if session.delay is None:  # in a replay the run has answered this: with an event of its delay, or without one
        session.recorder.drain()
        if strokes_move_against(session.read(), noise_rad):
            return
    delay = _delay_of(session, 0.0, noise_rad)
    if delay.is_shown:
        raise Fault("DELAY", f"{no_room_words(session.experiment, delay)}; the check said {fault.code}") from fault


def no_room_words(e: Experiment, delay: BenchDelay) -> str:
    """What the strokes show of the delay, and the room that there is for it."""
    counted_s, v = counted_delay_s(e.device, delay), e.limits.max_speed_rad_s
    return (
        f"{delay_words(delay)}; beyond a drive's own tick that is {1e3 * counted_s:.0f} ms, {v * counted_s:.2f} rad at "
        f"{v:g} rad/s, and there is room for {1e3 * max(room_for_delay_s(e), 0.0):.0f} ms"
    )


def delay_words(delay: BenchDelay) -> str:
    """The delay, as the beginning of a sentence."""
    low_s, high_s = delay.range_s
    if delay.is_shown:
        return (
            f"the strokes of the breakaway check moved the reading {1e3 * low_s:.0f} to {1e3 * high_s:.0f} ms after "
            "the sample on which they were decided"
        )
    return f"the device reports that a drive acts {1e3 * delay.reported_s:.0f} ms after its sample"


def _delay_of(session: Session, reported_s: float, noise_rad: float) -> BenchDelay:
    """The bench's delay by the strokes so far; noted if it is beyond a tick, so that a replay counts with the same."""
    if session.delay is None:
        session.recorder.drain()
        recording = session.read()
        further = strokes_delay(recording, noise_rad)
        delay = session.delay = BenchDelay(reported_s, further)
        low_s, best_s, high_s = delay.further_s or (math.nan,) * 3
        if delay.is_shown or session.loop.waits(reported_s):
            session.note("delay", reported_s=reported_s, low_s=low_s, further_s=best_s, high_s=high_s)
    return session.delay


@contextmanager
def prepared(session: Session) -> Iterator[None]:
    """Set this process up for real time during the block, if time is real. After it the driver's times are judged."""
    try:
        yield from _prepared(session)
    finally:
        driver = session.bench.driver
        is_first = session.meta.times_shift_s is None  # what is identified next is judged by that, also in a replay
        if is_first and isinstance(driver, ReckonedTimes) and driver.times_shift_s > 0.0:
            with suppress(RecordingError):  # a full disk has its own words
                session.add_to_meta(times_shift_s=driver.times_shift_s)


def _prepared(session: Session) -> Iterator[None]:
    if not isinstance(session.bench.clock, MonotonicClock):
        _note_real_time(session, RealTime(["virtual time: lateness means nothing here"]))
        yield
    else:
        with real_time(real_time_of(session.experiment)) as done:
            _note_real_time(session, done)
            yield


def _note_real_time(session: Session, done: RealTime) -> None:
    """Write to meta.json, result.json and its notes what the machine granted the loop, and what it refused."""
    if session.found.real_time is None:
        report = RealTimeReport(granted=tuple(done.granted), refused=tuple(done.refused))
        session.found.real_time = report
        granted = ["loop: " + "; ".join(done.granted)] if done.granted else []
        session.found.notes += granted + [f"loop: {line}" for line in done.refused]
        session.add_to_meta(real_time=report)


def breakaway_check(e: Experiment, drive_units: int | None = None) -> BreakawayCheck:
    """The breakaway check of a config.

    drive_units  steps of the device's drive at full duty; None: it has no steps
    Raises Fault CONFIG_MISMATCH if its unseen travel has no bound.
    """
    strokes = None if e.motor is None else breakaway_strokes(e)
    if strokes is None:
        raise Fault(
            "CONFIG_MISMATCH",
            "with a stuck or uncoupled sensor nothing would bound how far the shaft turns in the breakaway check: "
            "motor.no_load_speed_rad_s is missing, or breakaway.max_V is too high for it; see `rig check`",
        )
    b = e.breakaway
    return BreakawayCheck(
        b.max_V,
        b.motion_rad,
        b.rest_s,
        strokes,
        e.period_s,
        float if drive_units is None else replace(e.drive.map, full_units=drive_units).quantised,
    )


def check_breakaway(session: Session) -> None:
    """Prove sensor, drive and sign by strokes to and fro; after that the guard may brake by itself.

    Raises Fault START_OUTSIDE, CONFIG_MISMATCH, and what the loop and the check raise.
    """
    e = session.experiment
    session.loop.run(Rest(0.1), "rest")
    y_rad = session.loop.last_y_rad
    low, high = e.limits.soft_rad
    if not low <= y_rad <= high:
        raise Fault("START_OUTSIDE", f"y = {y_rad:.3f} rad, soft limits {low:.2f} to {high:.2f} rad")
    check = breakaway_check(e, session.bench.info.drive_units)
    session.loop.run(check, "breakaway")
    session.found.breakaway = check
    guard = session.loop.guard
    guard.learn(guard_settings_of(e, check.noise_rad))
    guard.static_V = check.moves_V
    guard.sign_proven = True
    differ = abs(check.plus_V - check.minus_V) / (check.plus_V + check.minus_V)
    if differ > FRICTION_DIFFERS:
        session.found.notes.append(
            f"the shaft broke away at {check.plus_V:.2f} V in one direction and at {check.minus_V:.2f} V in the other, "
            f"{percent(differ)} from their mean; `rig check` bounds unseen travel for at most "
            f"{percent(FRICTION_DIFFERS)}. With a stuck or uncoupled sensor this shaft could turn farther than "
            "`rig check` says: lower breakaway.max_V"
        )
    session.note("breakaway", plus_V=check.plus_V, minus_V=check.minus_V, noise_rad=check.noise_rad)


def flicker_of(session: Session) -> Flicker:
    """How long a reading of this bench may stay the same while the motor is driven, by the breakaway check."""
    check, still_s = session.found.checked, STILL_S + session.loop.guard.settings.delay_s
    if check.noise_rad < FLICKERS_LSB * session.experiment.sensor.curve.lsb_rad:
        return Flicker(math.inf)
    samples_s = FLICKER_SAMPLES * session.experiment.period_s
    return Flicker(max(still_s, samples_s, 3.0 * check.longest_same_s))


def unshown_motion(session: Session, from_V: float = 0.0) -> UnshownMotion | None:
    """What finds a reading that stands still under drives; None without a breakaway check; as ``UnshownMotion``."""
    check, settings = session.found.breakaway, session.loop.guard.settings
    if check is None:
        return None
    return UnshownMotion(check.moves_V, settings.motion_rad, settings.delay_s, flicker_of(session), from_V)


def test_relays(session: Session, most: int | None = None) -> None:
    """Run a relay test at each pair of gains, then let the shaft rest. If the config gives no gains, search them.

    most  so many tests at most; None: all
    """
    e = session.experiment
    if e.relay.gains is None and e.relay.target is None:
        return
    relay, detector = relay_and_detector(e)
    if e.relay.gains is not None:
        gains_V, expected_period_s = [(g.h1_V, g.h2_V) for g in e.relay.gains], None
    else:
        gains_V, expected_period_s = search_gains(session, relay, detector, both=most != 1)
    session.found.gains_V = tuple(gains_V[:most])
    for number, pair_V in enumerate(session.found.gains_V, start=1):
        _test_relay(session, relay, detector, (number, pair_V), expected_period_s)
    _end_relay_tests(session, relay)


def test_further(session: Session, pair_V: tuple[float, float]) -> None:
    """One more relay test, from rest, at another amplitude than the tests before it; then let the shaft rest."""
    relay, detector = relay_and_detector(session.experiment)
    number = len(session.found.gains_V) + 1
    period_s = None if session.found.cycle is None else session.found.cycle.period_s
    _test_relay(session, relay, detector, (number, pair_V), period_s)
    _end_relay_tests(session, relay)


def relay_and_detector(e: Experiment) -> tuple[DualChannelRelay, CycleDetector]:
    """The relay, without gains yet, and what finds its cycles."""
    detector = CycleDetector(min_period_s=30.0 * e.period_s, min_amplitude_rad=20.0 * e.sensor.curve.lsb_rad)
    return DualChannelRelay(0.0, 0.0, integral_bound_rad_s(e)), detector


def _test_relay(
    session: Session,
    relay: DualChannelRelay,
    detector: CycleDetector,
    test: tuple[int, tuple[float, float]],
    expected_period_s: float | None,
) -> None:
    """One relay test, by its number and its gains."""
    e = session.experiment
    number, pair_V = test
    cycle_s = expected_period_s if expected_period_s is not None else 2.0
    timeout_s = RELAY_TIMEOUT_PERIODS * e.relay.cycles * cycle_s
    stage = str(Stage.test(StageKind.RELAY, number))
    session.note("gains", stage=stage, h1_V=pair_V[0], h2_V=pair_V[1], cycles=e.relay.cycles)
    watch = _watch_cycles(session, detector, stage)
    law, command = relay_law(session, (relay, detector), pair_V, e.relay.cycles, timeout_s)
    law.unshown = unshown_motion(session, session.loop.guard.static_V)
    if command is None:
        session.loop.run(law, stage, watch)
    else:
        session.loop.run_in_device(law, command, stage, watch)
        if law.relay.bound_reached:
            session.found.notes.append(f"{stage}: the relay's integral reached its bound in the device")
    session.found.cycle = SettledCycle(*pair_V, *detector.mean())


def relay_law(
    session: Session,
    shared: tuple[DualChannelRelay, CycleDetector],
    gains_V: tuple[float, float],
    cycles: int,
    timeout_s: float,
) -> tuple[RelayTest, RelayCommand | None]:
    """A relay test with the relay of the loop; or with the device's own, the same on the counts that come back.

    Returns the command, too, that such a device gets. Raises Fault CONFIG_MISMATCH for one that has no relay.
    """
    relay, detector = shared
    e = session.experiment
    if e.relay.where == "device":
        driver = session.bench.driver
        if not isinstance(driver, RelayDriver):
            raise Fault("CONFIG_MISMATCH", f"relay.where is device, but {driver.backend} has no relay")
        command = driver.relay_command(*gains_V, relay.z_bound_rad_s)
        return RelayTest(RelayOnCounts(command, gains_V), detector, gains_V, cycles, timeout_s), command
    law = RelayTest(relay, detector, gains_V, cycles, timeout_s)
    law.watch.wait(round(session.loop.latency_s / e.period_s))
    law.ahead_s = expected_delay_s(e.device, session.delay or BenchDelay())
    return law, None


def _end_relay_tests(session: Session, relay: DualChannelRelay) -> None:
    if relay.bound_reached:
        session.found.notes.append("the relay's integral reached its bound: that made the first cycles shorter")
    session.loop.run(Rest(REST_S), "rest")


def test_hysteretic(session: Session) -> None:
    """Run each hysteretic relay of the config from rest at zero, and let the shaft rest after each.

    Raises Fault DRIVE_TOO_SMALL and what the loop raises; ValueError without a breakaway check.
    """
    e = session.experiment
    if e.relay.hysteretic is None:
        return
    breakaway = session.found.checked
    for number, wanted in enumerate(e.relay.hysteretic, start=1):
        level_V = breakaway.plus_V if wanted.d_V > 0.0 else breakaway.minus_V
        if abs(wanted.d_V) <= level_V:
            raise Fault("DRIVE_TOO_SMALL", f"run {number}: d_V {wanted.d_V:+.3f} V; it broke away at {level_V:.3f} V")
    for number, wanted in enumerate(e.relay.hysteretic, start=1):
        stage = str(Stage.test(StageKind.HYSTERETIC, number))
        bring_home(session)
        session.note("hysteretic", stage=stage, d_V=wanted.d_V, eps_rad=wanted.eps_rad)
        relay = HystereticRelay(wanted.d_V, wanted.eps_rad)
        session.loop.run(HystereticRun(relay, START_REST_S, HYSTERETIC_SWITCHINGS, HYSTERETIC_TIMEOUT_S), stage)
        session.loop.run(Rest(REST_S), "rest")


def bring_home(session: Session) -> None:
    """Bring the shaft to rest at zero. Raises Fault NOT_HOME; ValueError without a breakaway check."""
    e, breakaway = session.experiment, session.found.checked
    lsb_rad, noise_rad = e.sensor.curve.lsb_rad, breakaway.noise_rad
    # without noise the mean of readings is as coarse as the sensor's steps, and the edge of a step may be at zero
    dithered = noise_rad > 0.4 * lsb_rad
    tolerance_rad = max(0.3 * lsb_rad, 0.45 * noise_rad) if dithered else 0.6 * lsb_rad
    homing = Homing(
        BreakawayFound(breakaway.plus_V, breakaway.minus_V, noise_rad),
        e.drive.max_V,
        tolerance_rad,
        e.period_s,
        HOMING_TIMEOUT_S,
    )
    session.loop.run(homing, "homing")
    session.note("home", rest_rad=homing.rest_rad, strokes=homing.strokes)


def search_gains(
    session: Session, relay: DualChannelRelay, detector: CycleDetector, both: bool
) -> tuple[list[tuple[float, float]], float]:
    """Search gains for the wanted cycle, and for the second test's. Returns (h1, h2) of each, V, and their period, s.

    both  False: the second test is left out
    Where the search finds no second cycle the first test is all, with a note. Raises Fault NO_CYCLE without a first;
    ValueError without relay.target or a breakaway check.
    """
    e, target, breakaway = session.experiment, session.experiment.relay.target, session.found.checked
    if target is None:
        raise ValueError("the gain search needs relay.target")
    s = e.relay.search
    search = GainSearch(
        relay,
        detector,
        CycleTarget(target.amplitude_rad, target.period_s, target.tolerance),
        SearchRange(s.h1_start_V, s.h2_start_V, s.h2_step_V, s.step_s, s.h_max_V, e.drive.max_V, s.timeout_s),
        # moving friction is a little less than the drive that breaks the shaft away
        friction_V=0.45 * (breakaway.plus_V + breakaway.minus_V),
        reach_rad=0.9 * reach_rad(e.device),
        top_speed_rad_s=0.95 * e.limits.max_speed_rad_s,
    )
    search.unshown = unshown_motion(session, session.loop.guard.static_V)
    search.ahead_s = expected_delay_s(e.device, session.delay or BenchDelay())
    session.found.search = search
    watch = watch_steps(session, search)
    session.loop.run(search, "search", watch)
    gains_V, period_s = [(relay.h1_V, relay.h2_V)], detector.mean()[0]
    if both:
        search.seek_second(e.relay.second_ratio)
        session.loop.run(search, "search", watch)
        if search.no_second:
            session.found.notes.append(f"no second relay test: {search.no_second}")
            return gains_V, period_s
        gains_V.append((relay.h1_V, relay.h2_V))
        session.found.further_gains_V = search.further_gains(e.relay.second_ratio**2)
    return gains_V, period_s


def identify_recorded(session: Session) -> None:
    """Identify the motor from the recording so far, by every method."""
    session.recorder.drain()
    session.note("stage", name="identify")
    identification = session.found.identification = identify([session.read()])
    session.found.notes += beside_data_sheet(session.experiment, identification)
    session.loop.check_stop()


def verify_models(session: Session) -> None:
    """Track the same trajectory with the model of each method, if a pre-run simulation on the best model is safe."""
    e, found = session.experiment, session.found
    if found.models is None and found.identification is not None:
        found.models = found.identification.as_result()
    if e.tracking is None or found.models is None:
        return
    answer, estimates = found.models.answer, found.models.estimates
    trusted, first = model_of(answer, in_its_time=True), estimates.get(LEADING)
    safe: dict[Method, FramedMotor] = {}
    further_delay_s = _further_delay_s(session)
    for method in e.tracking.methods:
        estimate = estimates.get(method)
        model: FramedMotor | None
        if answer is not None and method == answer.method and trusted is not None and e.tracking.with_law:
            model = trusted
            reason = _why_not(session, model, trusted)
        elif trusted is None or (first is not None and first.verdict == "refused"):
            # if the best estimator refuses the recording, a reference method's model must not drive the bench either
            model, reason = None, "no estimate is good enough for the simulation before the run"
        elif estimate is None or estimate.verdict == "refused":
            model, reason = None, NO_ESTIMATE if estimate is None else "its estimate was refused"
        else:
            model = plain_motor(estimate)
            reason = _why_not(session, model, trusted)
        if model is not None and not reason:
            safe[method] = model
        else:
            session.found.tracking[method] = TrackingResult(not_run=reason)
    for method, model in safe.items():
        session.found.tracking[method] = TrackingResult(not_run="the run ended before it")
        # a replay tracks with these models: it identifies nothing, and simulates nothing before
        further = {"further_delay_s": further_delay_s} if further_delay_s > 0.0 else {}
        session.note("model", method=method, **model.numbers, **further)
    if safe:
        track(session, safe, further_delay_s)


def _why_not(session: Session, model: FramedMotor, trusted: FramedMotor) -> str:
    """Why a model must not drive the bench, in words, by a simulation on the trusted motor; empty if it may."""
    further_delay_s = _further_delay_s(session)
    return why_not(session, _tracking_law(session, model, further_delay_s), trusted, further_delay_s)


def why_not(session: Session, law: Rehearsed, motor: FramedMotor, further_delay_s: float) -> str:
    """Why a law must not drive the bench, in words, by a simulation with that motor before it; empty if it may."""
    e, loop = session.experiment, session.loop
    settings, order = loop.guard.settings, session.bench.driver.order
    bench = PreRunBench(
        motor, loop.last_y_rad, settings.noise_rad, loop.latency_s, e.sensor.curve, e.drive.map, e.sensor.rails,
        e.period_s, order, further_delay_s,
    )  # fmt: skip
    return pre_run(law, bench, settings) or ""


def _further_delay_s(session: Session) -> float:
    """The delay that the device does not report, s: as identified, else by the strokes; 0 s if there is none."""
    delay, identification = session.delay or BenchDelay(), session.found.identification
    best = None if identification is None else identification.best
    if best is None or not best.fits_delay:
        return delay.shown_s[1]
    return max(best.delay_s - session.loop.latency_s, 0.0)


def track(session: Session, models: Mapping[Method, FramedMotor], further_delay_s: float = 0.0) -> None:
    """Track the config's trajectory with each of the models, from rest.

    further_delay_s  from the drive that the device reports to the motion of the reading
    """
    # an observer's gain takes longer than a tick
    laws = {method: _tracking_law(session, motor, further_delay_s) for method, motor in models.items()}
    ended, shaft = list[Method](), None
    try:
        with driving(session):
            for method, law in laws.items():
                session.loop.run(Rest(REST_S), "rest")
                session.loop.run(law, str(Stage.track(method)))
                _note_tracking(session, method, models[method], law.largest_u_V)
                ended.append(method)
            session.loop.run(Rest(REST_S), "rest")
            shaft = None if session.bench.shaft is None else session.bench.shaft()
    finally:  # also where a fault ended a later one
        for method in ended:
            tracked = session.found.tracking[method]
            errors = tracking_errors(session, laws[method], models[method], shaft)
            session.found.tracking[method] = tracked.model_copy(update=errors)


def _note_tracking(session: Session, method: Method, model: FramedMotor, largest_u_V: float) -> None:
    """The tracking run has come to its end: which laws its drive made up for, and whether it had all that it asked."""
    max_V = session.experiment.drive.max_V
    if largest_u_V > max_V:
        session.found.notes.append(
            f"tracking with {method} asked for {largest_u_V:.2f} V; it got drive.max_V, {max_V:.2f} V, and fell behind"
        )
    models = session.found.models
    answer = None if models is None else models.answer
    beyond = "" if answer is None else beyond_drive(answer.holds, min(largest_u_V, max_V))
    if beyond:
        session.found.notes.append(f"tracking with {method} had {beyond}: it says less of the model there")
    if not model.parts:
        session.found.tracking[method] = TrackingResult()
        return
    left_out = tuple(part for part in model.parts if part in NOT_COMPENSATED)
    session.found.tracking[method] = TrackingResult(
        law=tuple(part for part in model.parts if part not in left_out), law_left_out=left_out or None
    )
    if left_out:
        names = " and ".join(part.replace("_", " ") for part in left_out)
        session.found.notes.append(f"tracking with {method}: no drive makes up for {names}, which these tests show")


def _tracking_law(session: Session, motor: FramedMotor, further_delay_s: float) -> Tracking:
    e = session.experiment
    if e.tracking is None:
        raise ValueError("tracking needs a config with section tracking")
    tachometer_noise = None
    if e.tachometer is not None:
        # one count, seen at the shaft
        tachometer_noise = abs(e.tachometer.rad_s_per_count) / e.tachometer.gear_ratio
    observer = MotorObserver(
        motor, e.period_s, session.loop.guard.settings.noise_rad, tachometer_noise_rad_s=tachometer_noise
    )
    observer.latency_s, observer.further_s = session.loop.latency_s, further_delay_s
    return Tracking(
        motor,
        observer,
        SumOfSines(
            [(c.amplitude_rad, c.omega_rad_s) for c in e.tracking.trajectory],
            fade_s=FADE_S,
            turn_rad_s=e.tracking.turn_rad_s,
        ),
        e.tracking.k1_1_s,
        e.tracking.k2_1_s2,
        e.tracking.duration_s,
        e.tracking.friction_sign,
        e.tracking.offset_rad,
    )


def integral_bound_rad_s(e: Experiment) -> float:
    """Bound on the relay's integral: four times the largest |z| of any cycle to expect."""
    d = e.device
    if e.relay.until is not None:
        # a cycle that fills the soft limits takes ten time constants at most
        return 4.0 * swing_rad(d) * 10.0 * e.limits.coast_tau_s / 6.28
    if e.relay.target is not None:
        # a sine of the wanted period that fills the soft limits
        return 4.0 * swing_rad(d) * e.relay.target.period_s / 6.28
    # |z| = A/w with w = h1/(tau (h2 - f_c)) >= h1/(tau h2)
    longest_s = max(e.limits.coast_tau_s * g.h2_V / g.h1_V for g in e.relay.gains or ())
    return 4.0 * swing_rad(d) * longest_s


def watch_steps(session: Session, search: GainSearch | RisingGains) -> Callable[[float], None]:
    """What notes each new step of a search."""
    noted = 0

    def watch(t_s: float) -> None:
        nonlocal noted
        for step in search.steps[noted:]:
            session.note("search", **{name: value for name, value in step._asdict().items() if name != "t_s"})
        noted = len(search.steps)

    return watch


def _watch_cycles(session: Session, detector: CycleDetector, stage: str) -> Callable[[float], None]:
    noted = 0

    def watch(t_s: float) -> None:
        nonlocal noted
        if len(detector.cycles) > noted:
            noted = len(detector.cycles)
            c = detector.cycles[-1]
            sizes = {"period_s": c.period_s, "amplitude_rad": c.amplitude_rad}
            session.note("cycle", stage=stage, number=noted, settled=detector.settled, **sizes)

    return watch
