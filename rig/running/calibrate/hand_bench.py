"""Readings by hand, strokes and holds, on the bench of a config. An emulated bench gets a hand."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from statistics import fmean, median, stdev
from typing import Any, Self

from rig.backends.registry import Bench, backend_of, connect
from rig.config.schema import Experiment
from rig.control.guard import Guard
from rig.control.law import BareLaw, Rest
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import Gone, stop_on_signals
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.run_folder.live.stop_flag import StopFlag
from rig.run_folder.recording.sink import NullSink
from rig.running.calibrate import dialogue
from rig.running.experiment import zero
from rig.running.experiment.script import run_breakaway
from rig.running.preflight.room_to_stop import guard_settings_of

_SAMPLES = 30
_LOOK_S = 0.2  # before a hold, at 0 V


class HandBench:
    """Does what a calibration asks for; a context manager that closes the bench.

    experiment  the config as it was read: it says which bench
    runs        folder in which the strokes' run folders are made
    flag        of the calibration; a Stop that comes while nothing drives refuses the next drive
    gone        who has to be there while it drives, and is not: as of ``StopRequest``

    On an emulated bench nobody can turn the shaft. So for each reading the emulated device starts anew with its shaft
    where the hand would have turned it. A board's encoder counts from its start and would not show that, so there the
    same bench in simulation is read (``daq.driver: simulated``).
    """

    def __init__(self, experiment: Experiment, runs: Path, flag: StopFlag, gone: Gone | None = None) -> None:
        self._runs = runs
        self._flag = flag
        self._gone = gone
        self._is_emulated = backend_of(experiment.device).is_emulated(experiment.device)
        self._readings = 0
        self._stack = ExitStack()
        self._bench: Bench | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def perform(self, request: dialogue.Motion) -> Any:
        """What the request wants.

        Raises Refusal for a fault of link, device or guard, and for a Stop, for the dialogue: the bench is opened anew
        for the next request.
        """
        try:
            return self._perform(request)
        except Fault as fault:
            self._close()
            if fault.code == "INTERRUPTED":
                self._flag.forget()
                raise dialogue.Refusal(dialogue.stopped(fault), "measure again, or leave this step out") from fault
            raise dialogue.Refusal(str(fault), fault.cure) from fault

    def _perform(self, request: dialogue.Motion) -> Any:
        match request:
            case dialogue.Read():
                return self._read(request)
            case dialogue.SetZero():
                self._close()
                if not self._is_emulated:  # there the hand has done it
                    zero.by_hand(request.experiment, 0.0)
                return None
            case dialogue.Strokes():
                self._close()
                self._flag.check()  # a Stop since the last drive: who asked was told that nothing drives
                seen = _strokes(request.experiment, self._runs, self._stop_or_gone)
                if seen.fault is not None and seen.fault.code == "INTERRUPTED":
                    self._flag.forget()
                return seen
            case dialogue.Hold():
                self._close()
                e = _motor_off(request.experiment) if self._is_emulated else request.experiment
                return _hold(e, request, self._flag, self._gone)

    def _stop_or_gone(self) -> str:
        """For a run of its own, with a flag of its own: why it has to end; empty: it need not."""
        by = self._flag.asked_by()
        return f"Stop by {by}" if by else "" if self._gone is None else self._gone()

    def _close(self) -> None:
        self._bench = None
        self._stack.close()

    def _read(self, request: dialogue.Read) -> dialogue.Reading:
        self._readings += 1
        if self._is_emulated:
            with connect(_turned_by_hand(request.experiment, request.pose, self._readings).device) as bench:
                return _reading(bench, request.experiment.period_s)
        if self._bench is None:  # it stays open: opening it resets some boards
            self._bench = self._stack.enter_context(connect(request.experiment.device))
        return _reading(self._bench, request.experiment.period_s)


def _turned_by_hand(e: Experiment, pose: dialogue.Pose, number: int) -> Experiment:
    """The emulated bench with its shaft at this pose."""
    if e.emulated is None:
        raise ValueError("only an emulated bench has this hand")
    motor = e.emulated.motor
    at_rad = {"low stop": motor.stop_rad[0], "high stop": motor.stop_rad[1]}[pose] if isinstance(pose, str) else pose
    emulated = e.emulated.model_copy(update={"motor": motor.model_copy(update={"start_rad": at_rad})})
    daq = e.daq
    if e.sensor.encoder is not None:
        daq = daq.model_copy(update={"driver": "simulated", "port": None})
    return e.model_copy(update={"emulated": emulated, "daq": daq, "seed": (e.seed + number) % 2**31})


def _reading(bench: Bench, period_s: float) -> dialogue.Reading:
    counts: list[int] = []
    due_s = bench.clock.now_s()
    for _ in range(_SAMPLES):
        due_s = max(due_s + period_s, bench.clock.now_s())
        bench.clock.sleep_until(due_s)
        counts.append(bench.driver.read().y_counts)
    half = _SAMPLES // 2
    return dialogue.Reading(
        median(counts), stdev(counts), fmean(counts[half:]) - fmean(counts[:half]), bench.info.board
    )


def _strokes(e: Experiment, runs: Path, gone: Gone) -> dialogue.StrokesSeen:
    try:
        outcome = run_breakaway(e, runs, gone=gone)
    except Fault as fault:  # the bench could not be opened
        return dialogue.StrokesSeen(fault, math.nan, math.nan, "")
    found = outcome.result.breakaway
    seen = (None, None) if found is None else (found.seen_plus_V, found.seen_minus_V)
    plus_V, minus_V = (math.nan if level is None else level for level in seen)
    notes = tuple(note for note in outcome.result.notes if not note.startswith("loop: "))  # of the bench alone
    return dialogue.StrokesSeen(outcome.fault, plus_V, minus_V, str(outcome.folder), notes)


def _motor_off(e: Experiment) -> Experiment:
    """The emulated bench with its motor taken off the bridge."""
    if e.emulated is None:
        raise ValueError("only an emulated bench has this hand")
    wiring = e.emulated.wiring.model_copy(update={"drive": "dead", "fault_after_s": 0.0})
    return e.model_copy(update={"emulated": e.emulated.model_copy(update={"wiring": wiring})})


def _hold(e: Experiment, request: dialogue.Hold, flag: StopFlag, gone: Gone | None = None) -> float:
    """How far the shaft turned, rad. Nothing is recorded."""
    d = e.device
    law = _Held(request.u_V, request.seconds, e.breakaway.motion_rad)
    with stop_on_signals(flag, gone) as stop, connect(d) as bench:
        guard = Guard(replace(guard_settings_of(e), limits=d.arming))
        loop = Loop(bench.driver, bench.clock, guard, NullSink(), e.period_s, stop)
        try:
            with loop.armed(d.arming):
                loop.run(Rest(_LOOK_S), "rest")
                loop.run(law, "jog")
                loop.run(Rest(_LOOK_S), "rest")
        finally:
            loop.close()
    return law.moved_rad


class _Held(BareLaw):
    """A constant drive that ends as soon as the shaft has turned by ``motion_rad``: ``moved_rad`` tells how far."""

    def __init__(self, u_V: float, seconds: float, motion_rad: float) -> None:
        self._u_V = u_V
        self._seconds = seconds
        self._motion_rad = motion_rad
        self._first: Sample | None = None
        self.moved_rad = 0.0

    def step(self, sample: Sample) -> float:
        """The drive, V; 0 V at the end."""
        first = self._first = self._first or sample
        self.moved_rad = sample.y_rad - first.y_rad
        self.finished = abs(self.moved_rad) > self._motion_rad or sample.t_s - first.t_s >= self._seconds
        return 0.0 if self.finished else self._u_V
