"""Any CSV from anyone's bench: right with what t_s,u_V,y_rad can tell, refused with a reason where they cannot."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from evidence import evidence, examples
from foreign_bench import (
    PAPER,
    QUICK,
    SLOW,
    Columns,
    Law,
    binary,
    by_hand,
    certain_but_for_laws,
    chirp,
    constant,
    motor,
    plain_csv,
    relay,
    sampled,
    sines,
    square,
    step,
    ticks,
    triangle,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rig.identification import identify
from rig.identification.departures.departure import Bench
from rig.identification.departures.laws import orders
from rig.identification.estimate import Estimate
from rig.identification.plausibility import judge_records
from rig.identification.preprocessing import from_recording
from rig.run_folder.recording.errors import IdentifyError, RecordingError
from rig.run_folder.recording.log_format import LogColumn, LogFormat
from rig.run_folder.recording.reader import read
from rig.run_folder.recording.sample_columns import COLUMNS
from rig.run_folder.recording.series import TimeSeries

pytestmark = pytest.mark.long

WITH_DRIVE_TIMES = ("t_s", "u_V", "y_rad", "t_u_s")
PLAIN = WITH_DRIVE_TIMES[:3]
NAMES = ("tau_s", "K_rad_s_V", "fc_V")


def estimate(path: Path) -> Estimate:
    return identify([read(path)], ["sampled-data"], choose_law=False).estimates["sampled-data"]


def errors(found: Estimate, truth: dict[str, float]) -> np.ndarray:
    """Relative errors of tau, K, fc."""
    return np.array([getattr(found, name) / truth[name] - 1.0 for name in NAMES])


def within_reason(found: Estimate, truth: dict[str, float]) -> bool:
    """Each parameter within three times its own half interval or 2 %, and none beyond 5 %."""
    half = np.array([0.5 * (found.ci95[name][1] - found.ci95[name][0]) / getattr(found, name) for name in NAMES])
    return bool(np.all(np.abs(errors(found, truth)) <= np.minimum(0.05, np.maximum(3.0 * half, 0.02))))


def not_believed(path: Path, words: str = "") -> None:
    """A declared error, a refusal or a doubt, with these words in it; never a number called ok."""
    try:
        found = estimate(path)
    except (RecordingError, IdentifyError) as error:
        assert words in str(error)
        return
    assert found.verdict != "ok", (found.tau_s, found.K_rad_s_V, found.fc_V)
    assert any(words in reason for reason in found.reasons), found.reasons


@pytest.fixture(scope="module")
def relay_test() -> Columns:
    """A relay test as a bench without times of its drive records it."""
    return sampled(motor(**PAPER), relay(PAPER["fc_V"]), ticks(1200), 0.004)


# -- right where the input tells --------------------------------------------------------------------------------------

DRIVES = {
    "relay": relay(0.5),
    "square": square(1.2, 1.0),
    "chirp": chirp(1.4, 12.0),
    "binary": binary(-1.2, 1.2, 0.1),
    "sines": sines(1.8),
    "triangle": triangle(2.0),
    "by hand": by_hand(1.6),
}
OF_ONE_SIZE = ("relay", "square", "binary")  # of drive; the others tell laws from tau, K and friction


SPACINGS = ("even", "jittered", "uneven")
STAY = (("relay", "uneven"), ("chirp", "jittered"), ("by hand", "even"))


@pytest.mark.parametrize(("drive", "spacing"), [*STAY, *evidence(*sorted({*product(DRIVES, SPACINGS)} - {*STAY}))])
def test_any_drive_at_any_spacing_of_samples(tmp_path: Path, drive: str, spacing: str) -> None:
    """The drive acts at an unknown constant delay after each sample."""
    columns = sampled(motor(**PAPER), DRIVES[drive], ticks(1200, spacing), 0.0025)
    found = estimate(plain_csv(tmp_path / "a.csv", columns))
    assert certain_but_for_laws(found) if drive in OF_ONE_SIZE else found.verdict == "ok", found.reasons
    assert within_reason(found, PAPER)
    assert found.delay_s == pytest.approx(0.0025, abs=2e-3)


@pytest.mark.evidence
def test_the_accuracies_at_ten_milliseconds(tmp_path: Path) -> None:
    """Ten cycles or so of three motors, plain columns: median 0.5 %, 95th percentile 1.7 % (docs/theory.md 7.10)."""
    seen = []
    for truth, rows in ((PAPER, 1200), (QUICK, 900), (SLOW, 3000)):
        for seed in range(4):
            shaft = motor(**truth, asym_V=0.03 * (-1) ** seed)
            columns = sampled(shaft, relay(truth["fc_V"]), ticks(rows), 0.001 + 0.002 * seed, seed=seed)
            found = estimate(plain_csv(tmp_path / "a.csv", columns))
            assert certain_but_for_laws(found), found.reasons
            assert within_reason(found, truth)
            seen.append(np.abs(errors(found, truth)))
    assert np.all(np.median(seen, axis=0) <= 0.005)
    assert np.quantile(seen, 0.95) <= 0.017


def test_a_finely_sampled_relay_test(tmp_path: Path) -> None:
    """0.2 ms, and a delay of most of a period."""
    columns = sampled(motor(**PAPER), relay(0.5), ticks(20_000, period_s=2e-4), 1.5e-4)
    found = estimate(plain_csv(tmp_path / "a.csv", columns))
    assert certain_but_for_laws(found), found.reasons
    assert np.abs(errors(found, PAPER)).max() < 0.017


def test_the_same_file_in_other_forms_is_the_same_recording(tmp_path: Path, relay_test: Columns) -> None:
    plain = read(plain_csv(tmp_path / "a.csv", relay_test))
    text = (tmp_path / "a.csv").read_text()
    rows = [line.split(",") for line in text.splitlines()]
    forms = {
        "other order, more columns": "\n".join(f"{y},x,{u},{t},9" for t, u, y in rows) + "\n",
        "semicolons": text.replace(",", ";"),
        "tabs, CRLF, BOM": "\ufeff" + text.replace(",", "\t").replace("\n", "\r\n"),
        "decimal commas": text.replace(",", ";").replace(".", ","),
        "exponents": "".join(
            [text.splitlines()[0] + "\n", *(",".join(f"{float(x):.17e}" for x in r) + "\n" for r in rows[1:])]
        ),
        "quotes": "\n".join(",".join(f'"{x}"' for x in row) for row in rows) + "\n",
        "comments, empty lines": "# my bench\n\n" + text.replace("\n0.5,", "\n# half a second\n0.5,") + "\n\n# end\n\n",
    }
    for form, content in forms.items():
        (tmp_path / "b.csv").write_bytes(content.encode())
        other = read(tmp_path / "b.csv")
        for name in COLUMNS:
            assert np.array_equal(getattr(other, name), getattr(plain, name), equal_nan=name != "stage"), (form, name)


def test_origins_do_not_matter(tmp_path: Path, relay_test: Columns) -> None:
    """Time since 1970, position since the encoder was made."""
    plain = estimate(plain_csv(tmp_path / "a.csv", relay_test))
    moved = relay_test | {"t_s": relay_test["t_s"] + 1.7e9, "y_rad": relay_test["y_rad"] - 512.0}
    other = estimate(plain_csv(tmp_path / "b.csv", moved))
    assert certain_but_for_laws(plain)
    assert certain_but_for_laws(other)
    for name in (
        "tau_s",
        "K_rad_s_V",
        "fc_V",
    ):  # the shaft stops at other rounded instants: another of many equal minima
        low, high = plain.ci95[name]
        assert abs(getattr(other, name) - getattr(plain, name)) < 0.05 * (high - low), name


# -- refused where it does not ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("names", [PLAIN, *evidence((WITH_DRIVE_TIMES,))])
@pytest.mark.parametrize(
    ("law", "words"),
    [
        (constant(0.0), "the drive never changes"),
        (square(0.3, 1.0), "no more than its noise"),
        *evidence(
            (constant(1.0), "the drive never changes"),
        ),
    ],
)
def test_what_the_input_cannot_tell_is_refused_with_the_reason(
    tmp_path: Path, names: tuple[str, ...], law: Law, words: str
) -> None:
    columns = sampled(motor(**PAPER), law, ticks(600), 0.004)
    path = plain_csv(tmp_path / "a.csv", columns, names)
    try:
        found = estimate(path)
    except IdentifyError as error:
        assert words in error.cause
        assert error.cure
        return
    assert found.verdict == "refused"
    assert any(words in reason for reason in found.reasons), found.reasons


@pytest.mark.parametrize("law", [step(-1.0), binary(0.8, 1.2, 0.3), *evidence(step(1.0), step(1.2, end_s=2.0))])
def test_one_way_is_never_ok_and_says_so(tmp_path: Path, law: Law) -> None:
    not_believed(plain_csv(tmp_path / "a.csv", sampled(motor(**PAPER), law, ticks(600), 0.004)), "one way only")


def test_standing_still_under_a_drive_asks_for_more_of_it_and_a_rest_at_0_V_does_not(tmp_path: Path) -> None:
    def pushes(between_V: float) -> Law:
        return lambda t, y, z: (1.0 if t % 4.0 < 2.0 else -1.0) * (2.0 if t % 2.0 < 1.0 else between_V)

    for between_V in (0.0, 0.3):
        columns = sampled(motor(**PAPER), pushes(between_V), ticks(800), 0.004)
        reasons = " ".join(estimate(plain_csv(tmp_path / "a.csv", columns)).reasons)
        assert ("stands still under its drive" in reasons) == (between_V > 0.0)


# -- wrong columns ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("names", [PLAIN, *evidence((WITH_DRIVE_TIMES,))])
@pytest.mark.parametrize("drive", ["relay", *evidence("chirp")])
@pytest.mark.parametrize("factor", [1e-3, 1e3, *evidence(1e-6, 1e6)])
@pytest.mark.parametrize("column", ["t_s", "u_V", "y_rad"])
def test_units_wrong_by_a_thousand_either_way_are_refused_with_a_question(
    tmp_path: Path, names: tuple[str, ...], drive: str, factor: float, column: str
) -> None:
    columns = sampled(motor(**PAPER), DRIVES[drive], ticks(600), 0.004)
    columns[column] = columns[column] * factor
    if column == "t_s":
        columns["t_u_s"] = columns["t_u_s"] * factor
    found = estimate(plain_csv(tmp_path / "a.csv", columns, names))
    assert found.verdict == "refused"
    assert any(column in reason and "?" in reason for reason in found.reasons), found.reasons


def part(columns: Columns, rows: int = 500) -> Columns:
    """The first rows of what takes long to refuse."""
    return {name: column[:rows] for name, column in columns.items()}


# a fit of these takes a second to fail
UNFIT: tuple[tuple[Callable[[Columns], Columns], str], ...] = (
    (lambda c: part(c) | {"y_rad": part(c)["u_V"], "u_V": part(c)["y_rad"]}, "swapped?"),
    (lambda c: part(c, 250) | {"u_V": -part(c, 250)["u_V"]}, "reverse the sign"),
    (lambda c: part(c) | {"y_rad": (part(c)["y_rad"] + 0.2) % 0.5}, "unwrap"),
)


@pytest.mark.parametrize(("spoil", "words"), UNFIT)
def test_columns_that_no_motor_fits_are_refused_before_one_is_sought(
    tmp_path: Path, relay_test: Columns, spoil: Callable[[Columns], Columns], words: str
) -> None:
    names = WITH_DRIVE_TIMES if words == "swapped?" else PLAIN
    recording = read(plain_csv(tmp_path / "a.csv", relay_test | spoil(relay_test), names))
    series, _ = from_recording(recording, slice(0, len(recording)), "a")
    assert any(one.verdict == "refused" and one.spoils and words in one.reason for one in judge_records([series]))


def test_a_sensor_that_flickers_while_the_motor_stands_is_no_swapped_column() -> None:
    t_s = np.linspace(0.0, 4.0, 401)
    flicker = TimeSeries(
        t_s, np.where(np.arange(401) // 3 % 2, 0.004, 0.0), None, 3.0 * np.sin(t_s), name="a", units_stated=True
    )
    (said,) = judge_records([flicker])
    assert said.verdict == "refused" and "did the shaft turn?" in said.reason and "swapped" not in said.reason


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda c: {"y_rad": np.degrees(c["y_rad"])}, "degrees"),
        (lambda c: {"y_rad": np.round(c["y_rad"] / 0.0041) + 512.0}, "raw counts"),
        (lambda c: {"y_rad": np.full_like(c["y_rad"], 0.3)}, "the position never changes"),
        (lambda c: {"u_V": np.full_like(c["u_V"], 0.3)}, "the drive never changes"),
        (lambda c: {"y_rad": np.clip(c["y_rad"], -1.0, np.quantile(c["y_rad"], 0.9))}, "stays at exactly"),
        (lambda c: {"y_rad": c["y_rad"][np.minimum(np.arange(c["y_rad"].size), 400)]}, "stands still from row 400 to"),
        (lambda c: {"y_rad": np.round(c["y_rad"], 1)}, ""),
        (lambda c: {"y_rad": c["y_rad"] + (np.arange(c["y_rad"].size) == 700) * 0.2}, "from the rows around it"),
        (lambda c: {"t_u_s": c["t_u_s"] * 1e3}, "one clock"),
        (lambda c: {"t_u_s": c["t_u_s"] - 5.0}, "one clock"),
        (lambda c: {"u_V": np.roll(c["u_V"], 1)}, "t_u_s"),
        (lambda c: {"y_rad": np.roll(c["y_rad"], -1)}, "t_u_s"),
        *evidence(
            *UNFIT,
            (lambda c: {"y_rad": -c["y_rad"]}, "reverse the sign"),
            (lambda c: {"u_V": np.roll(c["u_V"], -1)}, "t_u_s"),
            (lambda c: {"y_rad": np.roll(c["y_rad"], 1)}, "t_u_s"),
        ),
    ],
)
@pytest.mark.parametrize("with_times", [False, *evidence(True)])
def test_columns_that_are_not_what_they_say(
    tmp_path: Path, relay_test: Columns, spoil: Callable[[Columns], Columns], words: str, with_times: bool
) -> None:
    """Without t_u_s, but for what only t_u_s shows, and for what takes long without; and with it."""
    names = WITH_DRIVE_TIMES if with_times or words in ("one clock", "t_u_s", "swapped?") else PLAIN
    not_believed(plain_csv(tmp_path / "a.csv", relay_test | spoil(relay_test), names), words)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda c: {"y_rad": np.clip(c["y_rad"], -1.0, np.quantile(c["y_rad"], 0.9))}, "the position was cut off"),
        (lambda c: {"u_V": np.roll(c["u_V"], 1)}, "at other times than t_u_s says"),
    ],
)
def test_no_law_of_the_motor_imitates_what_is_wrong_in_the_columns(
    tmp_path: Path, relay_test: Columns, spoil: Callable[[Columns], Columns], words: str
) -> None:
    found = identify([read(plain_csv(tmp_path / "a.csv", relay_test | spoil(relay_test), WITH_DRIVE_TIMES))])
    assert found.motor_law is None
    assert "laws would only imitate that" in found.estimates["sampled-data"].reasons[-1]
    assert words in found.estimates["sampled-data"].reasons[-1]
    assert all(estimate.verdict != "ok" for estimate in found.estimates.values())


@pytest.mark.parametrize("rows", [-1, 2, *evidence(-3, -2, 1, 3)])
@pytest.mark.parametrize("drive", ["relay", *evidence("square", "chirp")])
def test_a_drive_some_rows_off_without_its_times_is_right_or_not_believed(
    tmp_path: Path, drive: str, rows: int
) -> None:
    """The free delay covers what lies between 0 and 2 periods, and says so where it would have to be beyond."""
    columns = sampled(motor(**PAPER), DRIVES[drive], ticks(1200), 0.004)
    columns["u_V"] = np.roll(columns["u_V"], rows)
    found = estimate(plain_csv(tmp_path / "a.csv", columns))
    if rows == -1:
        assert found.delay_s == pytest.approx(0.014, abs=2e-3)
    assert found.verdict != "ok" or within_reason(found, PAPER)


@pytest.mark.evidence
@pytest.mark.parametrize("names", [WITH_DRIVE_TIMES, *evidence((PLAIN,))])
def test_all_methods_take_what_the_others_refuse_without_a_traceback(
    tmp_path: Path, relay_test: Columns, names: tuple[str, ...]
) -> None:
    spoils: tuple[Callable[[Columns], Columns], ...] = (
        lambda c: {},
        lambda c: {"y_rad": c["u_V"], "u_V": c["y_rad"]},
        lambda c: {"u_V": np.sign(c["u_V"]) * 1e-5},
    )
    for spoil in spoils:
        change = spoil(relay_test)
        try:
            found = identify([read(plain_csv(tmp_path / "a.csv", relay_test | change, names))])
        except (RecordingError, IdentifyError):
            assert change
            continue
        believed = [method for method, e in found.estimates.items() if certain_but_for_laws(e)]
        assert believed == ([] if change else ["sampled-data"])


@pytest.mark.parametrize("rows", [3, 10, 19])
def test_a_handful_of_rows_is_one_clear_line(tmp_path: Path, relay_test: Columns, rows: int) -> None:
    short = {name: column[:rows] for name, column in relay_test.items()}
    with pytest.raises(IdentifyError, match=f"{rows} rows are too few"):
        identify([read(plain_csv(tmp_path / "a.csv", short))])


@pytest.mark.parametrize("step_rad, objections", [(0.15, 1), (2.0 * np.pi / 44, 0), (2.0 * np.pi / 12, 0)])
def test_many_turns_in_coarse_steps_are_degrees_but_for_steps_that_divide_a_turn(
    tmp_path: Path, step_rad: float, objections: int
) -> None:
    """300 rad: in steps of 0.15 it may be degrees, as an encoder's 44 or 12 counts a turn they are not."""
    columns = sampled(motor(**PAPER), binary(-3.0, 4.0, 0.9), ticks(2000), 0.004, 0.0, step_rad)
    path = plain_csv(tmp_path / "a.csv", columns)
    unsaid = read(path)
    said = read(path, LogFormat(LogColumn("s"), LogColumn("V"), LogColumn("rad")))
    for recording, expected in ((unsaid, objections), (said, 0)):
        series, _ = from_recording(recording, slice(0, len(recording)), "a")
        assert float(np.ptp(series.y_rad)) > 100.0
        assert len(judge_records([series])) == expected


def test_beyond_one_turn_cogging_has_whole_orders() -> None:
    """Else their number would grow with the turns, and with it the time: 2,700 orders over 300 rad."""
    far, near = (Bench(6.5, 0.5, 3.0, 20.0, half_rad, 0.01, 0.05) for half_rad in (150.0, 1.0))
    assert orders(far) == list(range(3, 30))
    assert len(orders(near)) == 18


# -- anything else ----------------------------------------------------------------------------------------------------


@st.composite
def damage(draw: st.DrawFn) -> list[tuple[str, int, int, str, float]]:
    kinds = st.sampled_from(["drop", "double", "exchange", "cell", "scale", "move", "cut"])
    cells = st.sampled_from(["nan", "", "inf", "x", "1e9", "-1", "0", "1e-9", "0.5", "-0.5"])
    one = st.tuples(
        kinds, st.integers(0, 10**6), st.integers(1, 40), cells, st.sampled_from([1e-6, 1e-3, 0.1, 10.0, 1e3, 1e6])
    )
    return draw(st.lists(one, min_size=1, max_size=3))


def damaged(
    rows: list[list[str]], how: list[tuple[str, int, int, str, float]]
) -> tuple[list[list[str]], dict[int, float]]:
    """The rows after this damage, and the factors by which whole columns were multiplied."""
    rows = [row.copy() for row in rows]
    factors: dict[int, float] = {}
    for kind, seed, count, text, factor in how:
        column, k = seed % 3, (seed // 3) % max(1, len(rows) - 1)
        if kind == "drop":
            del rows[k : k + count]
        elif kind == "double":
            rows.insert(k, rows[k].copy())
        elif kind == "exchange":
            rows[k], rows[k - 1] = rows[k - 1], rows[k]
        elif kind == "cell":
            rows[k][column] = text
        elif kind == "cut":
            rows = rows[: max(1, k)]
        elif kind == "move":  # one column, some rows down
            moved = [row[column] for row in rows]
            for row, value in zip(rows[count % 4 :], moved, strict=False):
                row[column] = value
        else:
            for row in rows:
                try:
                    row[column] = repr(float(row[column]) * factor)
                except ValueError:
                    continue
            factors[column] = factors.get(column, 1.0) * factor
    return rows, factors


@settings(
    max_examples=examples(60),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(how=damage(), drive_times=st.booleans())
def test_any_damage_ends_in_an_error_a_refusal_a_doubt_or_the_right_motor(
    tmp_path: Path, relay_test: Columns, how: list[tuple[str, int, int, str, float]], drive_times: bool
) -> None:
    names = WITH_DRIVE_TIMES if drive_times else PLAIN
    rows = [list(map(repr, row)) for row in zip(*(relay_test[name].tolist() for name in names), strict=True)]
    rows, factors = damaged(rows, how)
    path = tmp_path / "a.csv"
    path.write_text("\n".join([",".join(names), *(",".join(row) for row in rows)]) + "\n")
    try:
        found = estimate(path)
    except (RecordingError, IdentifyError) as error:
        assert "\n" not in error.cause
        assert error.cure
        return
    if found.verdict != "ok":
        assert found.reasons
        return
    # A factor that leaves everything plausible is another motor, and that one has to be right.
    t, u, y = (factors.get(column, 1.0) for column in range(3))
    truth = {"tau_s": 0.17 * t, "K_rad_s_V": 6.5 * y / t / u, "fc_V": 0.5 * u}
    assert within_reason(found, truth), (how, errors(found, truth))
    assert all(1e-2 < factor < 1e2 for factor in factors.values()), factors
