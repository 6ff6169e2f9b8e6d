"""The advisor's choices: the fit and the search for a test are stand-ins, which say what they are told to say."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.control.strokes import Stroke
from rig.design import advisor as module
from rig.design.advisor import Advice, Advisor, AdvisorSettings
from rig.design.best_test import Kind
from rig.design.outlook import Task
from rig.design.planned_test import Design, PlannedTest, Reach, Reading, RelayGains, Room, Strokes
from rig.identification.live import LiveEstimate, LiveSettings
from rig.model.real_motor import Frame, FramedMotor, RealMotor
from rig.run_folder.recording.recording import Recording, assembled

MOTOR = FramedMotor(RealMotor(0.17, 6.5, 0.48, 0.0), Frame())
RELAY, STROKES = RelayGains(0.4, 0.8), Strokes((Stroke(1.0, 0.3), Stroke(-1.0, -0.3)), 0.5)


def estimate(percent: float, *, differ: bool = True, residual: float = 1.0) -> LiveEstimate:
    share = percent / 196.0
    return LiveEstimate(
        row=0, t_s=0.0, tau_s=0.17, K_rad_s_V=6.5, fc_V=0.48, asym_V=0.0, delay_s=0.0,
        half_percent={"tau_s": percent, "K_rad_s_V": percent, "fc_V": percent},
        covariance=np.diag([share, share, share * 0.48, share * 0.48, 0.0]) ** 2,
        residual_over_noise=residual, residual_error=0.0, drives_differ=differ, laws=(),
        seconds_of_data=1.0, framed=MOTOR,
    )  # fmt: skip


@dataclass
class Bench:
    """A run of 0.1 s a row, and what the stand-ins say."""

    settings: AdvisorSettings
    monkeypatch: pytest.MonkeyPatch
    says: LiveEstimate | None = None
    sought: LiveEstimate | None = None  # what it says once laws are looked for; None: the same
    design: PlannedTest | None = STROKES
    seconds: float = 1.0
    left_s: float = 10.0
    asked: list[tuple[Task, Collection[Kind]]] = field(default_factory=list)
    rows: list[tuple[float, float, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        bench = self

        class Fit:
            def __init__(self, settings: LiveSettings) -> None:
                self.taken = 0

            def take(self, rows: Any) -> None:
                assert rows.row[0] == self.taken
                self.taken = int(rows.row[-1]) + 1

            def estimate(self, *, seeks_laws: bool = False) -> LiveEstimate | None:
                if seeks_laws and bench.sought is not None:
                    bench.says = bench.sought
                return bench.says

        def best(task: Task, kinds: Collection[Kind]) -> Design | None:
            bench.asked.append((task, kinds))
            if bench.design is None:
                return None
            return Design(bench.design, bench.seconds, 1.0, Reach(-0.5, 0.5, 3.0))

        @dataclass
        class Told:
            seconds: float

        self.monkeypatch.setattr(module, "LiveFit", Fit)
        self.monkeypatch.setattr(module, "best_test", best)
        self.monkeypatch.setattr(module, "told", lambda task, law: Told(bench.left_s))
        self.advisor = Advisor(self.settings)

    def drive(self, stage: str, seconds: float, amplitude_rad: float = 0.3) -> None:
        """So many seconds of a swing every second."""
        for _ in range(round(10 * seconds)):
            k = round(10 * self.rows[-1][0]) + 1 if self.rows else 0
            self.rows.append((0.1 * k, amplitude_rad * float(np.sin(2 * np.pi * 0.1 * k)), stage))
        self.advisor.take(self.recording)

    def rest(self, seconds: float, noise_rad: float) -> None:
        """So many seconds at rest, 0.01 s a row."""
        rng, t_s = np.random.default_rng(3), self.rows[-1][0]
        for k in range(round(100 * seconds)):
            self.rows.append((t_s + 0.01 * (k + 1), noise_rad * float(rng.standard_normal()), "rest"))
        self.advisor.take(self.recording)

    @property
    def recording(self) -> Recording:
        t, y, stage = zip(*self.rows, strict=True)
        columns: dict[str, Any] = {"t_s": np.array(t), "y_rad": np.array(y), "u_V": np.zeros(len(t))}
        return assembled(Path("run"), columns | {"stage": np.array(stage)}, range(len(t)), columns_present=("t_s",))


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    settings = AdvisorSettings(
        1.0,
        LiveSettings(0.01, 0.003, 0.0, 3.0),
        Room(-1.0, 1.0, 3.0, 4.9, stop_rad=(-1.1, 1.1)),
        Reading(0.01, 0.003),
        turn_rad=0.08,
    )
    return Bench(settings, monkeypatch)


def test_nothing_is_said_before_there_is_an_estimate(bench: Bench) -> None:
    bench.drive("search", 1.0)
    assert bench.advisor.advise() is None


def test_the_first_test_is_designed_as_soon_as_all_is_known_to_a_fifth(bench: Bench) -> None:
    bench.drive("search", 1.0)
    bench.says = estimate(25.0)
    advice = bench.advisor.advise()
    assert advice is not None and advice.design is None and not bench.asked
    bench.says = estimate(19.0)
    advice = bench.advisor.advise()
    assert advice is not None and advice.design is not None and advice.design.test == STROKES
    task, kinds = bench.asked[-1]
    assert task.wanted_percent == 1.0 and set(kinds) == {"relay", "strokes"} and task.belief.delay_is_known
    assert task.seen[0, 0] == pytest.approx((196.0 / 19.0) ** 2) and task.seen[4, 4] == 0.0


@pytest.mark.parametrize("stage", ["search", "relay-2"])
def test_the_first_test_waits_for_swings_that_are_not_much_narrower_than_the_room(bench: Bench, stage: str) -> None:
    """Bristles bend in small swings: an estimate that explains these may be three times off in wide ones.

    A search that begins again, after pushes, is a stage of its own.
    """
    bench.drive(stage, 2.0, 0.1)  # the room is 1 rad
    bench.says = estimate(10.0)
    advice = bench.advisor.advise()
    assert advice is not None and advice.design is None and not bench.asked
    bench.drive(stage, 2.0, 0.2)
    advice = bench.advisor.advise()
    assert advice is not None and advice.design is not None


def test_it_does_not_wait_where_the_shaft_turns_without_end(bench: Bench) -> None:
    room = replace(bench.settings.room, stop_rad=(-math.inf, math.inf))
    endless = Bench(replace(bench.settings, room=room), bench.monkeypatch)
    endless.drive("search", 2.0, 0.1)
    endless.says = estimate(10.0)
    advice = endless.advisor.advise()
    assert advice is not None and advice.design is not None


def test_it_does_not_wait_for_ever_where_speed_bounds_the_swings(bench: Bench) -> None:
    bench.drive("search", 9.0, 0.1)
    bench.says = estimate(10.0)
    assert bench.advisor.advise() == Advice(bench.says)
    bench.drive("search", 2.0, 0.1)
    advice = bench.advisor.advise()
    assert advice is not None and advice.design is not None


def test_laws_are_looked_for_before_the_tests_end_and_they_go_on_where_one_shows(bench: Bench) -> None:
    started(bench)
    bench.says, bench.sought = estimate(0.5), replace(estimate(0.5), laws=("dead_band",))
    advices = []
    for _ in range(3):
        advices.append(bench.advisor.advise())
        bench.drive("strokes-1", 1.0)
    assert [one is not None and one.stop is not None for one in advices] == [False, False, True]
    assert advices[1] is not None and advices[1].estimate is bench.sought
    assert advices[2] is not None and (advices[2].stop or "").endswith("with dead band")


def test_a_known_motor_gets_its_first_test_without_any_row_in_motion(bench: Bench) -> None:
    live = replace(bench.settings.live, prior=MOTOR)
    known = Bench(replace(bench.settings, live=live), bench.monkeypatch)
    known.drive("rest", 0.5)
    known.says = estimate(30.0)
    advice = known.advisor.advise()
    assert advice is not None and advice.design is not None


def test_no_test_is_designed_for_a_known_motor_without_friction(bench: Bench) -> None:
    live = replace(bench.settings.live, prior=FramedMotor(MOTOR.motor._replace(fc_V=0.0), Frame()))
    known = Bench(replace(bench.settings, live=live), bench.monkeypatch)
    known.drive("rest", 0.5)
    known.says = replace(estimate(30.0), fc_V=0.0)
    assert known.advisor.advise() == Advice(known.says)


def started(bench: Bench, stage: str = "strokes-1", seconds: float = 3.0) -> None:
    """The first test is given, and has run for a while."""
    bench.drive("search", 1.0)
    bench.says = estimate(10.0)
    bench.advisor.advise()
    bench.drive(stage, seconds)


@pytest.mark.parametrize(
    ("seconds", "left_s", "changes"), [(3.0, 10.0, True), (3.0, 1.2, False), (1.0, 10.0, False), (0.0, 10.0, False)]
)
def test_another_test_takes_its_place_only_once_it_ran_and_if_it_is_clearly_quicker(
    bench: Bench, seconds: float, left_s: float, *, changes: bool
) -> None:
    """One second is less than a test has to run; none: the stage before it still runs."""
    started(bench, seconds=seconds)
    bench.says, bench.left_s, bench.design = estimate(3.0), left_s, RELAY
    advice = bench.advisor.advise()
    assert advice is not None and (advice.design is not None) == changes


def test_after_braking_the_next_test_comes_at_once_and_within_less_room(bench: Bench) -> None:
    started(bench, seconds=0.5)
    bench.advisor.braked()
    advice = bench.advisor.advise()
    assert advice is not None and advice.design is not None
    room = bench.asked[-1][0].room
    assert (room.low_rad, room.high_rad) == pytest.approx((-0.85, 0.85)) and room.max_speed_rad_s < 4.2


def test_well_known_by_drives_that_are_alike_asks_for_the_other_kind(bench: Bench) -> None:
    started(bench)
    bench.says, bench.design = estimate(0.8, differ=False), RELAY
    advice = bench.advisor.advise()
    assert advice is not None and advice.design is not None and advice.design.test == RELAY
    assert tuple(bench.asked[-1][1]) == ("relay",)


def test_enough_is_said_once_it_is_enough_twice_and_no_test_meanwhile(bench: Bench) -> None:
    started(bench)
    bench.says = estimate(0.8)
    first, second = bench.advisor.advise(), bench.advisor.advise()
    assert first is not None and first.stop is None and first.design is None
    assert second is not None and second.stop is not None and second.design is None


def test_without_any_test_that_fits_the_present_one_goes_on(bench: Bench) -> None:
    started(bench)
    bench.design, bench.says = None, estimate(3.0)
    advice = bench.advisor.advise()
    assert advice is not None and advice.design is None and advice.stop is None


def test_before_more_is_driven_the_noise_is_measured_again_and_the_estimates_judged_anew(bench: Bench) -> None:
    """The residual is 1.18 of a noise at rest that is known to 6 %; a rest shows that noise to be larger."""
    one = Bench(replace(bench.settings, noise_error=0.06), bench.monkeypatch)
    started(one)
    one.says = estimate(0.8, residual=1.18)
    first, second = one.advisor.advise(), one.advisor.advise()
    assert first is not None and first.rest_s == 0.0
    assert second is not None and second.rest_s > 0.0 and second.stop is None and second.design is None
    one.drive("strokes-1", 0.5)  # until the shaft may coast
    waits = one.advisor.advise()
    assert waits is not None and waits.rest_s == 0.0 and waits.stop is None
    one.rest(second.rest_s + 0.2, noise_rad=0.0036)
    after = one.advisor.advise()
    assert after is not None and after.stop is not None


def test_it_is_not_measured_again_and_again(bench: Bench) -> None:
    one = Bench(replace(bench.settings, noise_error=0.06), bench.monkeypatch)
    started(one)
    one.says = estimate(0.8, residual=1.18)
    rests = 0
    for _ in range(20):
        advice = one.advisor.advise()
        assert advice is not None and advice.stop is None
        if advice.rest_s > 0.0:
            rests += 1
            one.rest(advice.rest_s + 0.2, noise_rad=0.0026)
        one.drive("relay-2", 1.0)
    assert 1 <= rests <= 3
