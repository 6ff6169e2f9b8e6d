"""Where a test ends, and where the next one begins, no shaft leaves the soft limits: in virtual time, with a script."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from rig.config.load import load
from rig.control.strokes import Stroke
from rig.design.advisor import Advice, AdvisorSettings
from rig.design.planned_test import Design, PlannedTest, Reach, RelayGains, Strokes
from rig.run_folder.recording.reader import read_run
from rig.run_folder.recording.recording import Recording
from rig.run_folder.results import ScriptCall
from rig.running.experiment.advisers import AtTurns
from rig.running.experiment.script import BREAKAWAY_LAW
from rig.running.experiment.until import drive_until
from rig.running.replay import replay
from rig.running.session import Session, record

pytestmark = pytest.mark.long

CONFIG = Path(__file__).resolve().parents[2] / "config" / "quick.yaml"
SOFT_RAD = 1.1
LITTLE_FRICTION = {"fc_plus_V": 0.1, "fc_minus_V": 0.1, "fs_plus_V": 0.11, "fs_minus_V": 0.11}
FAST = Strokes((Stroke(0.5, 0.9), Stroke(-0.5, -0.9)), 2.0)  # from its turn on the shaft would coast to 1.16 rad


def design_of(test: PlannedTest) -> Design:
    return Design(test, math.nan, math.nan, Reach(math.nan, math.nan, math.nan))


class Scripted:
    """Strokes half a second after the search has begun; a relay and the end where the shaft is fast and far out."""

    trouble, last_words = "its process is gone", "Traceback"

    def __init__(self, session: Session) -> None:
        self._session = session
        self._began_s = math.nan
        self._told = 0

    def begin(self, settings: AdvisorSettings) -> None:
        pass

    def braked(self) -> None:
        raise AssertionError("the guard had to brake")

    def advice(self, row: int, t_s: float) -> Advice | None:
        if math.isnan(self._began_s):
            self._began_s = t_s
        loop, due_s = self._session.loop, (0.5, 2.5, 4.5, 7.0)[self._told]
        v_rad_s, y_rad = loop.guard.velocity_rad_s, loop.last_y_rad
        wants_fast = self._told in (1, 3)
        if t_s - self._began_s < due_s or (wants_fast and not (v_rad_s > 2.0 and y_rad > 0.8)):
            return None
        self._told += 1
        if self._told == 4:
            return Advice(None, stop="enough")
        return Advice(None, design_of(RelayGains(0.15, 0.3) if self._told == 2 else FAST))


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Recording]:
    experiment = load(CONFIG)
    assert experiment.emulated is not None
    motor = experiment.emulated.motor.model_copy(update=LITTLE_FRICTION)
    emulated = experiment.emulated.model_copy(update={"motor": motor})
    what = ScriptCall(name="relay", breakaway=BREAKAWAY_LAW)

    def script(session: Session) -> None:
        drive_until(session, advisers=AtTurns(Scripted(session), session.loop.guard))

    folder = tmp_path_factory.mktemp("runs")
    outcome = record(experiment.model_copy(update={"emulated": emulated}), folder, what, script, None)
    assert outcome.fault is None
    return outcome.folder, read_run(outcome.folder)


def decided(recording: Recording, what: str) -> list[int]:
    """The rows after which such decisions took effect."""
    found = [e.detail["row"] for e in recording.events if e.kind == "decided" and e.detail["what"] == what]
    return [row for row in found if isinstance(row, int)]


def test_a_test_that_is_enough_goes_on_until_the_shaft_may_coast(driven: tuple[Path, Recording]) -> None:
    _, recording = driven
    assert float(np.abs(recording.y_rad).max()) < SOFT_RAD
    assert not recording.flags.any()
    (stop,) = decided(recording, "stop")
    assert recording.y_rad[stop] > 0.8 and recording.stage[stop + 1] == "strokes-3"
    assert recording.stage[-1] == "rest"


def test_a_test_begins_where_the_shaft_turns_whenever_it_was_designed(driven: tuple[Path, Recording]) -> None:
    _, recording = driven
    begins = decided(recording, "strokes") + decided(recording, "relay")
    assert len(begins) == 3
    for row in begins:
        y_rad = recording.y_rad[row - 8 : row + 1]
        assert abs(y_rad[-1] - y_rad[0]) < 0.5 * np.ptp(y_rad) or np.ptp(y_rad) < 0.05  # to and fro


def test_what_was_wrong_with_the_advisers_is_an_event(driven: tuple[Path, Recording]) -> None:
    _, recording = driven
    (event,) = (e for e in recording.events if e.kind == "no_advice")
    assert event.detail["why"] == "its process is gone" and event.detail["last_words"] == "Traceback"


def test_it_is_replayed_tick_for_tick(driven: tuple[Path, Recording]) -> None:
    done = replay(driven[0])
    assert done.is_same and done.ending == "its end", done.difference
