"""What a calibration asks, in which order, and what it does with answers; the bench is a list of readings."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from rig.config import ready
from rig.config.load import load
from rig.config.yaml12 import parse
from rig.core.faults import Fault
from rig.running.calibrate.dialogue import (
    Ask,
    Hold,
    Motion,
    Read,
    Reading,
    Refusal,
    Say,
    SetZero,
    Skipped,
    Strokes,
    StrokesSeen,
    Talk,
)
from rig.running.calibrate.draft import Draft
from rig.running.calibrate.steps import calibration
from rig.running.calibrate.wiring import drive, sensor, svg, swapped_motor, text


@dataclass
class Talked:
    """Gone through: what was shown, what the motor was asked for, the draft. As ``Front``, and for a bench, meanwhile.

    answers   in turn; `(skip)` leaves the step out
    readings  in turn, a Refusal for one that fails; strokes: the same; turned_rad: by each hold
    """

    answers: Iterator[str]
    readings: Iterator[float | Reading | Refusal]
    strokes: Iterator[StrokesSeen]
    turned_rad: float
    said: list[Say] = field(default_factory=list)
    driven: list[Motion] = field(default_factory=list)
    draft: Draft | None = None

    @property
    def words(self) -> str:
        return "\n".join(say.words for say in self.said)

    @property
    def changes(self) -> dict[str, Any]:
        assert self.draft is not None
        return {".".join(map(str, path)): value for path, value in self.draft.changes.items()}

    def say(self, what: Say) -> None:
        self.said.append(what)

    def ask(self, question: Ask) -> str:
        answer = next(self.answers, None)
        assert answer is not None, f"no answer to: {question.words}"
        if answer == "(skip)":
            raise Skipped("skipped")
        return answer

    def does(self, motion: Motion) -> None:
        if not isinstance(motion, Read):
            self.driven.append(motion)

    def writes(self) -> None:
        raise AssertionError("no step writes")

    def perform(self, motion: Motion) -> Any:
        match motion:
            case Read():
                one = next(self.readings, None)
                assert one is not None, "one reading too few"
                if isinstance(one, Refusal):
                    raise one
                return one if isinstance(one, Reading) else Reading(one, 0.5, 0.0, "uno")
            case Strokes():
                return next(self.strokes, SEEN)
            case Hold():
                return self.turned_rad
        return None


def talk(
    config: str,
    step: str,
    answers: Iterable[str],
    readings: Iterable[float | Reading | Refusal] = (),
    strokes: Iterable[StrokesSeen] = (),
    turned_rad: float = 0.0,
) -> Talked:
    """The whole step, or steps, with these answers."""
    done = Talked(iter(answers), iter(readings), iter(strokes), turned_rad)
    experiment = load(parse(config, "config").data)
    draft = Draft(experiment, parse(config, "config").data)
    done.draft = calibration(Talk(done, done.perform), draft, step.split())
    assert next(done.answers, None) is None, "an answer nobody asked for"
    return done


UNO, ENCODER = ready.text("uno"), ready.text("encoder")
ALL_ANGLES = ["", "", "-100", "-50", "50", "100", ""]
ALL_COUNTS = [512.0, 140.0, 326.0, 698.0, 884.0]
SEEN = StrokesSeen(None, 0.6, 0.5, "runs/breakaway", ("friction differs",))


def fault(code: str) -> StrokesSeen:
    return StrokesSeen(Fault(code, "strokes of up to +0.60 V"), float("nan"), float("nan"), "runs/breakaway")


def test_five_angles_make_the_section() -> None:
    done = talk(UNO, "angles", ALL_ANGLES, ALL_COUNTS)
    assert done.changes == {
        "sensor.calibration": [{"counts": 140, "rad": -1.74533}, {"counts": 884, "rad": 1.74533}],
        "sensor.linearity_percent": 0.21,
    }
    assert "  -100.00°    140.0        -0.00°" in done.words
    assert done.driven == []


def test_a_slip_is_asked_for_again_while_the_shaft_stands_there() -> None:
    """0.6 for 6: refused with the number that was meant; the right one goes on."""
    done = talk(UNO, "angles", ["0.5", "", "-90", "0.6", "6", "90", ""], [512, 177, 534, 534, 847])
    refused = [say.words for say in done.said if say.kind == "refused"]
    assert len(refused) == 1 and "did you mean 6° instead of 0.6° at 534 counts?" in refused[0]
    assert [point["counts"] for point in done.changes["sensor.calibration"]] == [177, 847]
    assert done.changes["sensor.calibration_error_rad"] == 0.0087


def test_an_earlier_angle_can_be_dropped() -> None:
    done = talk(UNO, "angles", ["", "", "-100", "-50", "drop 9", "drop 3", "-50", "100", ""], [512, 140, 326, 326, 884])
    assert "there is no angle 9 to drop" in done.words
    assert "-50° is dropped; left are 1: +0°, 2: -100°" in done.words
    assert len(done.changes["sensor.calibration"]) == 2


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ("4,5", "'4,5' is no angle"),
        ("nan", "'nan' is no angle"),
        ("1e9", "is no angle of a shaft"),
        ("", "1 angles are too few"),
        ("0", "0° is given already"),
        ("\x1b[31m", "is no angle"),
    ],
)
def test_answers_that_are_none(answer: str, words: str) -> None:
    readings = [512.0] * (2 if answer == "0" else 1)
    assert words in talk(UNO, "angles", ["", "", answer, "(skip)"], readings).words


@pytest.mark.parametrize(
    ("reading", "words", "wires"),
    [
        (Reading(1020, 0.3, 0.0, "uno"), "its rail (8 and 1015)", True),
        (Reading(600, 4.0, 7.0, "uno"), "the shaft still turns: +7.0 counts", False),
        (Reading(512, 0.5, 0.0, "uno"), "the reading has not moved: 512 counts at 45°", True),
        (Refusal("LINK_TIMEOUT: no valid reply", "check the cable"), "LINK_TIMEOUT", False),
    ],
)
def test_readings_that_are_none(reading: Reading | Refusal, words: str, wires: bool) -> None:
    done = talk(UNO, "angles", ["", "", "45", "(skip)"], [512, reading])
    assert words in done.words
    assert done.changes == {}
    drawings = [drawing for say in done.said for drawing in say.drawings]
    assert drawings == (list(sensor("uno")) if wires else [])


def test_travel_from_stop_to_stop() -> None:
    """The wrong stop first is refused, and asked for again; less room asks for less speed."""
    done = talk(UNO, "travel", ["yes", "", "", "", "", "", "yes"], [850.0, 170.0, 170.0, 850.0])
    assert "the wrong way round" in done.words
    assert done.changes == {
        "limits.soft_rad": [-0.77, 0.76],
        "limits.hard_rad": [-1.37, 1.36],
        "limits.max_speed_rad_s": 3.92,
    }


def test_travel_keeps_limits_that_lie_inside() -> None:
    assert talk(UNO, "travel", ["yes", "", "", "keep"], [10.0, 1010.0]).changes == {}


def test_the_motor_moves_only_after_a_yes() -> None:
    for answer in ("", "no", "(skip)"):
        assert talk(UNO, "strokes", [answer]).driven == []
    done = talk(UNO, "strokes", ["maybe", "yes"], strokes=[SEEN])
    assert [type(request) for request in done.driven] == [Strokes]
    assert "friction differs" in done.words
    assert done.changes == {}  # breakaway.max_V 1.5 is two to three times 0.6


def test_the_motor_never_moves_on_a_config_that_rig_check_refuses() -> None:
    done = talk(UNO.replace("hard_rad: [-1.6, 1.6]", "hard_rad: [-1.0, 1.0]"), "strokes", [])
    assert done.driven == []
    assert "limits.max_speed_rad_s: no room to stop" in done.words


def test_moved_the_wrong_way_shows_two_wires_and_proves_the_cure() -> None:
    done = talk(UNO, "strokes", ["yes", "reversed", "yes"], strokes=[fault("POLARITY"), SEEN])
    assert done.changes == {"drive.reversed": True}
    first, second = (request for request in done.driven if isinstance(request, Strokes))
    assert (first.experiment.drive.reversed, second.experiment.drive.reversed) == (False, True)
    [drawing] = [drawing for say in done.said for drawing in say.drawings]
    assert drawing == swapped_motor(load(parse(UNO, "config").data))[0]


@pytest.mark.parametrize(("turned", "part"), [("no", "motor supply"), ("yes", "Arduino Uno")])
def test_not_moved_shows_the_way_of_the_drive_or_the_sensor(turned: str, part: str) -> None:
    done = talk(UNO, "strokes", ["yes", turned, "stop"], strokes=[fault("NO_MOTION")])
    drawings = [drawing for say in done.said for drawing in say.drawings]
    assert part in {drawings[0].left, "Arduino Uno"} and (len(drawings) == 3) is (turned == "no")
    assert done.changes == {}


def test_another_fault_says_its_cure() -> None:
    done = talk(UNO, "strokes", ["yes", "again", "yes"], strokes=[fault("DEVICE_ESTOP"), SEEN])
    assert "release the e-stop" in done.words


def test_a_dead_band_is_measured_with_the_motor_off() -> None:
    volts = ["0.928", "1.86", "2.784", "-1.20", "-2.10", "-3.00"]  # at duties of 0.12, 0.21, 0.3
    done = talk(UNO, "strokes dead-band", ["yes", "yes", *volts], strokes=[SEEN])
    assert done.changes == {"drive.dead_band_duty": {"plus": pytest.approx(0.03, abs=0.001), "minus": 0.0}}
    assert [round(r.u_V, 2) for r in done.driven if isinstance(r, Hold)] == [1.2, 2.1, 3.0, -1.2, -2.1, -3.0]


def test_a_dead_band_is_not_measured_with_the_motor_on() -> None:
    done = talk(UNO, "strokes dead-band", ["yes", "yes", "(skip)"], strokes=[SEEN], turned_rad=0.03)
    assert "the motor is still at the bridge" in done.words
    assert [type(request) for request in done.driven] == [Strokes, Hold]
    assert done.changes == {}


def test_the_bridge_drives_nothing_before_the_strokes_have_proven_the_sensor() -> None:
    done = talk(UNO, "dead-band", [])
    assert done.driven == [] and "the bridge does not drive" in done.words


@pytest.mark.parametrize(
    ("counts", "answers", "changes"),
    [
        pytest.param(1245, [], {}, id="as the config says"),
        pytest.param(-1244, ["sign"], {"sensor.encoder.sign": -1}, id="the other way"),
        pytest.param(-1244, ["swap"], {}, id="wires swapped by hand"),
        pytest.param(4978, [], {"sensor.encoder.counts_per_turn": 256}, id="lines for edges"),
    ],
)
def test_a_turn_of_an_encoder(counts: int, answers: list[str], changes: dict[str, Any]) -> None:
    done = talk(ENCODER, "turn", ["", "", "140", *answers], [0.0, float(counts)])
    assert done.changes == changes
    assert [type(request) for request in done.driven] == [SetZero]
    crossing = [drawing.swap for say in done.said for drawing in say.drawings]
    assert crossing == ([0] if counts < 0 else [])


def test_an_encoder_that_has_not_moved() -> None:
    done = talk(ENCODER, "turn", ["", "", "140", "(skip)"], [0.0, 2.0])
    assert "the encoder has not moved: +2 counts" in done.words
    assert [drawing.wires[0] for say in done.said for drawing in say.drawings] == [("D2", "A")]


@pytest.mark.parametrize("board", ["uno", "pico", "other"])
@pytest.mark.parametrize("bridge", ["in1-in2", "pwm-dir"])
def test_drawings_are_readable_in_both_forms(board: str, bridge: str) -> None:
    e = load(parse(UNO.replace("bridge: in1-in2", f"bridge: {bridge}"), "config").data)
    for drawing in (*sensor(board), *drive(e, board), *swapped_motor(e)):
        lines = text(drawing).splitlines()
        assert max(map(len, lines)) <= 75 and lines[0] == drawing.title
        page = ET.fromstring(svg(drawing))
        words = [element.text for element in page.iter() if element.text]
        assert {end for wire in drawing.wires for end in wire} < set(words)
        assert all(end in text(drawing) for wire in drawing.wires for end in wire)
