"""The tool of docs/evidence/safety-table.md: few phases, a broken promise, and the page that is checked in."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest
from evidence import evidence

from safety import garbage
from safety.__main__ import BAUDS, chip_load
from safety.driven_chip import PICO, UNO, DrivenChip, Way
from safety.page import Found, is_kept, render, render_pico, replaced, row
from safety.promises import PICO_PROMISES, PROMISES, Promise, measure
from shared.physics import stopping_distance

PAGE = Path(__file__).resolve().parents[2] / "docs" / "evidence" / "safety-table.md"
PICO_PAGE = PAGE.with_name("safety-table-pico.md")
COAST_RAD = max(stopping_distance(UNO.bench.motor, UNO.steady(direction)[1]) for direction in (1, -1))


SOME = {
    ("host silent", "host"),
    ("hang: main loop", "strokes"),
    ("put beyond a hard limit", "device"),
    ("wiper wire broken", "strokes"),
    ("reset: power-on, external, brown-out", "device"),
}


def stays(promise: Promise) -> bool:
    """In `make test`; all others are at the pin in test_hil_chip_safety.py and test_hil_encoder.py, or evidence."""
    if promise.what == "host silent":  # each way in which a host keeps the drive up
        return promise.way == Way(promise.way.where)
    is_encoders = promise.what == "encoder: both channels change at once"
    return promise.way.baud == BAUDS[0] and (is_encoders or (promise.what, promise.way.where) in SOME)


@pytest.mark.parametrize(
    "promise",
    [*filter(stays, PROMISES), *evidence(*((promise,) for promise in PROMISES if not stays(promise)))],
    ids=lambda p: f"{p.what}-{p.way.where}-{p.way.baud}-{p.way.bridge}",
)
def test_every_promise_is_kept_and_the_coast_is_the_exact_motors(promise: Promise) -> None:
    found = measure(promise, 3, seed=2)
    assert found.late == 0 and found.off_s <= promise.bound_s
    if not promise.way.full:
        assert found.coast_rad == pytest.approx(COAST_RAD, rel=0.03)  # the slower direction coasts less far
    speed = abs(UNO.steady(1)[1])
    assert found.travel_rad >= found.coast_rad + 0.9 * speed * found.off_s - 1e-3


def test_what_is_promised_is_what_was_asked_for() -> None:
    bounds_s = {promise.what: promise.bound_s for promise in PROMISES}
    tick_s = 1e-3
    assert bounds_s["host silent"] == 1e-3 * UNO.setup.watchdog_ms + tick_s
    assert bounds_s["hang: everything"] == 0.150
    assert bounds_s["put beyond a hard limit"] == bounds_s["wiper wire broken"] == 2 * tick_s
    assert bounds_s["e-stop opens"] == tick_s
    for what in ("host silent", "hang: main loop", "put beyond a hard limit", "e-stop opens", "end switch opens"):
        assert {promise.way.where for promise in PROMISES if promise.what == what} == {"host", "device", "strokes"}
    assert {promise.way.baud for promise in PROMISES if promise.what == "host silent"} == {115200, 1_000_000}


def test_a_broken_promise_is_found_and_shown() -> None:
    broken = measure(PROMISES[0]._replace(bound_s=0.095), 2)
    assert broken.late == 2 and "**late: 2**" in row(broken)[3]
    errors, guesses = garbage.Errors(1, 1, 0), garbage.Guesses(1, 0)
    kept = Found("", [broken._replace(late=0)], [garbage.Thrown(115200, 1, 0)], errors, guesses, {})
    assert is_kept(kept)
    assert not is_kept(kept._replace(promises=[broken]))
    assert not is_kept(kept._replace(thrown=[garbage.Thrown(115200, 1, 1)]))
    assert not is_kept(kept._replace(errors=garbage.Errors(1, 1, 1)))


@pytest.mark.parametrize("baud", BAUDS)
def test_garbage_moves_nothing(baud: int) -> None:
    assert garbage.throw(baud, 400, seed=2).moves == 0


def test_a_frame_with_the_right_crc_does_move_it() -> None:
    """What the garbage is made of drives, whole."""
    driven = DrivenChip(Way(), random.Random(1))
    driven.arm()
    changed_s = driven.truth().pin_changed_s
    driven.write(garbage._drive(random.Random(1)))
    driven.wait_for_wire()
    assert driven.truth().pin_changed_s > changed_s and driven.truth().pin_V != 0.0


def test_no_error_of_one_or_two_bits_gives_a_frame() -> None:
    assert garbage.errors(20, seed=3).taken == 0


def test_few_guessed_crcs_are_taken() -> None:
    found = garbage.guesses(5000)
    assert found.frames == 5000 and found.taken <= 3  # 0.08 to be expected


@pytest.mark.parametrize("baud", [BAUDS[-1], *evidence(*BAUDS[:-1])])
def test_the_tick_takes_its_share_and_no_byte_is_lost(baud: int) -> None:
    is_well, text = chip_load(baud)
    assert is_well, text
    share = re.search(r"^1 kHz +([\d.]+) %", text, re.MULTILINE)
    masked = re.search(r"^masked +([\d.]+) us", text, re.MULTILINE)
    assert share is not None and 5.0 < float(share[1]) < 30.0
    assert masked is not None and 1.0 < float(masked[1]) < 15.0
    assert re.search(r"^lost +0 bytes", text, re.MULTILINE)


PICO_SOME = [p for p in PICO_PROMISES if (p.what, p.way.where) in SOME or (p.what == "e-stop opens" and p.way.floods)]


@pytest.mark.parametrize(
    "promise", [PICO_SOME[0], *evidence(*((promise,) for promise in PICO_SOME[1:]))], ids=lambda p: p.what
)
def test_the_picos_promises_are_measured_alike(promise: Promise) -> None:
    """Some of them; all are in test_hil_chip_safety."""
    found = measure(promise, 2, seed=2)
    motor = PICO.bench.motor
    coast_rad = max(stopping_distance(motor, PICO.steady(direction)[1]) for direction in (1, -1))
    assert found.late == 0 and found.off_s <= promise.bound_s
    assert found.coast_rad == pytest.approx(coast_rad, rel=0.03)


def rows_of(page: str) -> list[list[str]]:
    return [line.split(" | ") for line in page.splitlines() if line.startswith("| ") and " ms | " in line]


@pytest.mark.parametrize(
    ("path", "promises", "phases"), [(PAGE, PROMISES, 200), (PICO_PAGE, PICO_PROMISES, 20)], ids=("uno", "pico")
)
def test_the_page_has_every_promise_with_its_phases_and_none_broken(
    path: Path, promises: tuple[Promise, ...], phases: int
) -> None:
    page = path.read_text(encoding="utf-8")
    assert re.search(rf"Each row is {phases} random\s+phases", page)
    lines = rows_of(page)
    assert len(lines) == len(promises)
    for cells, promise in zip(lines, promises, strict=True):
        assert cells[0] == f"| {promise.what}" and cells[1].startswith(promise.way.where)
        assert cells[2] == f"{1e3 * promise.bound_s:.0f} ms"
        number, unit = cells[3].split()
        assert float(number) * {"ms": 1e-3, "us": 1e-6}[unit] <= promise.bound_s
    assert "**late" not in page
    for baud in BAUDS:
        assert re.search(rf"^\| {baud} \| \d+ \| 0 \|$", page, re.MULTILINE)


def test_the_page_is_what_the_command_writes() -> None:
    some = measure(next(promise for promise in PROMISES if promise.way.full), 1)
    found = Found("today", [some], [garbage.throw(115200, 8)], garbage.errors(1), garbage.Guesses(65536, 2), {9: "x"})
    page = render(found)
    head = "| what happens | driven by | off within | worst | coast, rad | in all, rad |"
    assert head in page and head in PAGE.read_text(encoding="utf-8")
    assert f"| {' | '.join(row(some))} |" in page and "took 2 (1.0 are to be expected)" in page and "7e-13" in page
    assert f"| {' | '.join(row(some))} |" in render_pico("today", [some], found.thrown)


def test_rows_measured_anew_take_their_place_and_the_rest_stays() -> None:
    page = PAGE.read_text(encoding="utf-8")
    new = ("host silent", "device", "101 ms", "99.99 ms", "0.11", "0.22")
    text = replaced(page, [new], "2026-01-02, `a.hex`")
    assert "| host silent | device | 101 ms | 99.99 ms | 0.11 | 0.22 |" in text
    assert "Measured anew on 2026-01-02, `a.hex`: host silent." in text
    assert len(set(page.splitlines()) - set(text.splitlines())) == 1
    with pytest.raises(ValueError, match="the page has 0 rows"):
        replaced(page, [("no such row", "host")], "")
