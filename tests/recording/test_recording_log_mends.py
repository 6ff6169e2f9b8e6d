"""Logs as people have them: clocks and numbers that wrap, signs that were lost, no time, several runs in one file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.log_format import LogColumn, LogFormat, LogFormatError, parse_period
from rig.run_folder.recording.log_mends import added_up, has_no_sign
from rig.run_folder.recording.reader import read, read_all
from rig.run_folder.recording.recording import Floats, Recording

PERIOD_S, TURN = 0.005, 2.0 * np.pi
COUNTED = LogFormat(LogColumn("ms"), LogColumn("pwm"), LogColumn("counts"), counts_per_turn=1440, full=255, supply_V=12)
SPEED = LogFormat(LogColumn("ms"), LogColumn("V"), velocity=LogColumn("counts/s"), counts_per_turn=8192)


class Bench:
    """A motor of tau 0.05 s and K 20 (rad/s)/V with friction, driven to and fro by two sizes of PWM for 6 s."""

    def __init__(self) -> None:
        rng = np.random.default_rng(4)
        strokes = [(way * size, int(rng.integers(20, 60))) for size in (149, 64, 106) for way in (1, -1)] * 5
        self.pwm = np.concatenate([np.full(rows, pwm) for pwm, rows in strokes])[:1200].astype(float)
        self.ms = np.arange(self.pwm.size) * np.float64(1e3 * PERIOD_S)
        v, y = np.zeros(self.pwm.size), np.zeros(self.pwm.size)
        for k in range(1, v.size):
            drive_V = self.pwm[k - 1] * 12.0 / 255.0
            goal = 20.0 * (drive_V - 0.6 * np.sign(v[k - 1] or drive_V))
            v[k] = goal + (v[k - 1] - goal) * np.exp(-PERIOD_S / 0.05)
            y[k] = y[k - 1] + PERIOD_S * 0.5 * (v[k] + v[k - 1])
        self.v_rad_per_s, self.counts = v, np.round(y * 1440 / TURN)


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


def log_of(folder: Path, columns: Mapping[str, Floats]) -> Path:
    path = folder / "log.csv"
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    path.write_text("\n".join([",".join(columns), *(",".join(f"{x:.12g}" for x in row) for row in rows)]) + "\n")
    return path


def same(found: Recording, bench: Bench) -> None:
    assert found.t_s - found.t_s[0] == pytest.approx(1e-3 * bench.ms)
    assert found.u_V == pytest.approx(bench.pwm * 12.0 / 255.0)
    assert found.y_rad == pytest.approx(bench.counts * TURN / 1440)


@pytest.mark.parametrize("after", [1000.0, 65536.0, 60000.0, 1707.0])
def test_a_clock_that_begins_anew_goes_on(tmp_path: Path, bench: Bench, after: float) -> None:
    late = after - 2000.0 if after > 2000.0 else 0.0
    path = log_of(tmp_path, {"ms": (bench.ms + late) % after, "pwm": bench.pwm, "counts": bench.counts})
    found = read(path, COUNTED)
    same(found, bench)
    assert any(f"begins anew after {1e-3 * after:g} s" in note for note in found.notes)


def test_a_clock_that_stands_is_refused_with_the_period_to_type(tmp_path: Path, bench: Bench) -> None:
    coarse = np.floor(bench.ms / 15.625) * 15.625
    path = log_of(tmp_path, {"ms": coarse, "pwm": bench.pwm, "counts": bench.counts})
    with pytest.raises(RecordingError, match=r"goes on by 15\.62 ms: it is too coarse.*--period 5ms"):
        read(path, COUNTED)
    same(read(path, replace(COUNTED, time=None, period_s=parse_period("5ms"))), bench)


@pytest.mark.parametrize("late", ["the same", "back"])
def test_stamps_that_came_in_bursts_are_refused_for_that_with_the_period_to_type(
    tmp_path: Path, bench: Bench, late: str
) -> None:
    """They were called a clock that is too coarse, or rows to be put in order."""
    burst = np.arange(bench.ms.size) // 6 % 4 == 0
    back = np.where(burst, bench.ms + 30.0, bench.ms)
    last = np.where(burst, bench.ms[np.minimum(np.arange(bench.ms.size) // 6 * 6 + 5, bench.ms.size - 1)], bench.ms)
    path = log_of(tmp_path, {"ms": last if late == "the same" else back, "pwm": bench.pwm, "counts": bench.counts})
    with pytest.raises(RecordingError, match=r"stamps late, or in bursts.*--period (5|4.999)ms"):
        read(path, COUNTED)


def test_rows_that_are_said_twice_count_once(tmp_path: Path, bench: Bench) -> None:
    columns = {"ms": bench.ms, "pwm": bench.pwm, "counts": bench.counts}
    found = read(log_of(tmp_path, {name: np.repeat(values, 2) for name, values in columns.items()}), COUNTED)
    same(found, bench)
    assert any("1200 rows say the one before again" in note for note in found.notes)
    own = {"t_s": 1e-3 * bench.ms, "u_V": bench.pwm, "y_rad": bench.counts}
    assert len(read(log_of(tmp_path, {name: np.repeat(values, 2) for name, values in own.items()}))) == bench.ms.size


def test_a_log_without_a_time_takes_the_period_of_its_rows(tmp_path: Path, bench: Bench) -> None:
    path = log_of(tmp_path, {"pwm": bench.pwm, "counts": bench.counts})
    found = read(path, replace(COUNTED, time=None, period_s=parse_period("5 ms")))
    same(found, bench)
    assert any("each row is 0.005 s after the one before" in note for note in found.notes)
    for text in ("5", "0ms", "5min", "-1ms", "1e-ms"):
        with pytest.raises(LogFormatError, match="no time above 0"):
            parse_period(text)
    with pytest.raises(LogFormatError, match="both given"):
        replace(COUNTED, period_s=0.005)


def test_runs_in_a_file_without_a_time_begin_behind_a_greeting_or_where_a_counter_or_the_position_does(
    tmp_path: Path, bench: Bench
) -> None:
    """As one run, tau of nine was sixty times too large, or refused for a jump to be unwrapped."""
    cut = 200  # at full speed
    pwm, counts = (np.concatenate((one[:cut], one, one)) for one in (bench.pwm, bench.counts))
    goes_on = np.concatenate((bench.counts[:cut], bench.counts + counts[cut - 1], bench.counts + counts[cut - 1]))
    row = np.concatenate((np.arange(cut), np.arange(bench.pwm.size), np.arange(bench.pwm.size))).astype(float)
    log = replace(COUNTED, time=None, period_s=PERIOD_S)
    lines = log_of(tmp_path, {"pwm": pwm, "counts": goes_on}).read_text().splitlines()
    greeted = "\n".join([*lines[: cut + 1], "ready", *lines[cut + 1 : cut + 1201], lines[0], *lines[cut + 1201 :], ""])
    files = (
        log_of(tmp_path, {"pwm": pwm, "counts": counts}).read_text(),
        log_of(tmp_path, {"row": row, "pwm": pwm, "counts": goes_on}).read_text(),
        greeted,
    )
    for text in files:
        (tmp_path / "log.csv").write_text(text)
        runs = read_all(tmp_path / "log.csv", log)
        assert [len(run) for run in runs] == [cut, 1200, 1200]
        assert any("3 runs, one after the other" in note for note in runs[0].notes)


def test_a_drive_an_angle_or_a_velocity_that_comes_back_begins_no_run(tmp_path: Path) -> None:
    """A ramp that begins again, an angle that wraps while the shaft turns on, a shaft that stops at once."""
    row = np.arange(600.0)
    ramp, turned, stopped = row % 50.0 - 25.0, (7.0 * row) % 360.0, np.where(row < 300.0, row, 0.0)
    log = LogFormat(drive=LogColumn("V", "u"), position=LogColumn("deg", "y"), period_s=PERIOD_S)
    speed = replace(log, position=None, velocity=LogColumn("deg/s", "v"))
    for columns, one in (({"u": ramp, "y": turned}, log), ({"u": np.sign(ramp), "v": stopped}, speed)):
        (run,) = read_all(log_of(tmp_path, columns), one)
        assert len(run) == row.size


def test_a_drive_whose_middle_is_0_V_is_refused_with_what_to_subtract(tmp_path: Path, bench: Bench) -> None:
    """K was twice as large as it is, called exact: full drive is half of the range."""
    path = log_of(tmp_path, {"ms": bench.ms, "pwm": 512.0 + 2.0 * bench.pwm, "counts": bench.counts})
    with pytest.raises(RecordingError, match=r"evenly about 512, .*subtract 512 .*--full 511"):
        read(path, replace(COUNTED, full=1023))
    pulses = log_of(tmp_path, {"ms": bench.ms, "pwm": 1500.0 + 3.0 * bench.pwm, "counts": bench.counts})
    with pytest.raises(RecordingError, match=r"evenly about 1500, .*subtract 1500 .*--full 500"):
        read(pulses, replace(COUNTED, full=2000))
    # sizes without a sign may lie so, too, and so may a drive of one way
    unsigned = np.where(np.abs(bench.pwm) > 100.0, 155.0, 100.0)
    for counts in (bench.counts, np.cumsum(unsigned)):
        assert read(log_of(tmp_path, {"ms": bench.ms, "pwm": unsigned, "counts": counts}), COUNTED).u_V.min() > 0.0


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_negative_drives_that_were_kept_as_unsigned_numbers_get_their_sign(
    tmp_path: Path, bench: Bench, bits: int
) -> None:
    pwm, full = (np.round(bench.pwm / 2), 100) if bits == 8 else (bench.pwm, 255)
    path = log_of(tmp_path, {"ms": bench.ms, "pwm": pwm % 2**bits, "counts": bench.counts})
    found = read(path, replace(COUNTED, full=full))
    assert found.u_V == pytest.approx(pwm * 12.0 / full)
    assert any(f"unsigned numbers of {bits} bits" in note for note in found.notes)


@pytest.mark.parametrize("bits", [16, 32])
def test_a_position_that_was_kept_as_an_unsigned_number_goes_on_below_zero(
    tmp_path: Path, bench: Bench, bits: int
) -> None:
    path = log_of(tmp_path, {"ms": bench.ms, "pwm": bench.pwm, "counts": (bench.counts - 700) % 2**bits})
    found = read(path, COUNTED)
    assert np.diff(found.y_rad) == pytest.approx(np.diff(bench.counts) * TURN / 1440)
    assert any(f"the counter, of {bits} bits, wrapped" in note for note in found.notes)


@pytest.mark.parametrize("size", [256, 1024])
def test_a_counter_of_few_bits_goes_on_also_where_it_is_shorter_than_a_turn(
    tmp_path: Path, bench: Bench, size: int
) -> None:
    """A turn is 360 counts: read as an angle that wraps, 256 counts made K 55 % too large."""
    counts, log = np.round(bench.counts / 4), replace(COUNTED, counts_per_turn=360)
    path = log_of(tmp_path, {"ms": bench.ms, "pwm": bench.pwm, "counts": counts % size})
    assert np.diff(read(path, log).y_rad) == pytest.approx(np.diff(counts) * TURN / 360)
    fast = log_of(tmp_path, {"ms": bench.ms, "pwm": bench.pwm, "counts": bench.counts % 256})  # by 0.6 of it in a row
    assert not any("wrapped" in note for note in read(fast, COUNTED).notes)


def test_a_potentiometer_with_a_gap_in_its_turn_goes_on_by_the_turn(tmp_path: Path, bench: Bench) -> None:
    """It shows 1024 of the 1229 counts of a turn: taken for a counter of 10 bits it made K 17 % too small."""
    per_turn = 1228.8
    counts = np.round(bench.counts * 0.5)
    shown = np.mod(counts, per_turn)
    shown = np.floor(np.where(shown > 1126.0, 0.0, np.minimum(shown, 1023.0)))
    path = log_of(tmp_path, {"ms": bench.ms, "pwm": bench.pwm, "counts": shown})
    found = read(path, replace(COUNTED, counts_per_turn=per_turn))
    assert np.ptp(found.y_rad) == pytest.approx(np.ptp(counts) * TURN / per_turn, rel=0.01, abs=0.2 * TURN)
    assert any("an angle that wraps" in note for note in found.notes)


def test_a_velocity_that_was_kept_as_an_unsigned_number_gets_its_sign(tmp_path: Path, bench: Bench) -> None:
    rpm = np.round(bench.v_rad_per_s * 30.0 / np.pi)
    path = log_of(tmp_path, {"ms": bench.ms, "volts": bench.pwm * 12.0 / 255.0, "rpm": rpm % 2**16})
    found = read(path, replace(SPEED, velocity=LogColumn("rpm"), counts_per_turn=None))
    assert np.diff(found.y_rad) == pytest.approx(PERIOD_S * 0.5 * (rpm[1:] + rpm[:-1]) * np.pi / 30.0)
    assert any("negative velocities stand as unsigned" in note for note in found.notes)


@pytest.mark.parametrize("lowest", [-32768.0, 0.0])
def test_a_velocity_of_16_bits_that_wraps_within_a_reversal_is_told_by_the_drive(
    tmp_path: Path, bench: Bench, lowest: float
) -> None:
    """At a reversal it changes by more than half of what 16 bits can be: no rule of the nearest row tells that."""
    counts_per_s = np.round(bench.v_rad_per_s * 8192 / TURN)
    assert np.abs(np.diff(counts_per_s)).max() > 2**15
    wrapped = (counts_per_s - lowest) % 2**16 + lowest
    path = log_of(tmp_path, {"ms": bench.ms, "volts": bench.pwm * 12.0 / 255.0, "vel": wrapped})
    found = read(path, SPEED)
    v = counts_per_s * TURN / 8192
    assert np.diff(found.y_rad) == pytest.approx(PERIOD_S * 0.5 * (v[1:] + v[:-1]))
    assert any("of 16 bits, wrapped" in note for note in found.notes)


@pytest.mark.parametrize(("bits", "lsb"), [(8, 1.0), (12, 0.1), (16, 0.01)])
def test_a_velocity_of_other_bits_or_units_that_wraps_goes_on(
    tmp_path: Path, bench: Bench, bits: int, lsb: float
) -> None:
    """They were refused: "the motor turns against its drive"."""
    size = lsb * 2.0**bits
    v = np.round(0.8 * 0.5 * size / lsb * bench.v_rad_per_s / np.abs(bench.v_rad_per_s).max()) * lsb
    columns = {"ms": bench.ms, "volts": bench.pwm * 12.0 / 255.0}
    log = replace(SPEED, velocity=LogColumn("rad/s"), counts_per_turn=None)
    for scale in (1.0, 1.5):
        whole = np.round(scale * v / lsb)
        wrapped = lsb * ((whole + 2.0 ** (bits - 1)) % 2.0**bits - 2.0 ** (bits - 1))
        found = read(log_of(tmp_path, columns | {"vel": wrapped}), log)
        assert np.ptp(found.y_rad) == pytest.approx(np.ptp(np.cumsum(PERIOD_S * lsb * whole)), rel=0.02)
        assert any(f"of {bits} bits, wrapped" in note for note in found.notes) == (scale > 1.0)


@pytest.mark.parametrize(("step_rad", "tick_s"), [(0.01, 64e-6), (0.3, 1e-6)])
def test_a_velocity_that_is_one_count_over_its_time_is_refused(
    tmp_path: Path, bench: Bench, step_rad: float, tick_s: float
) -> None:
    """K of such a log was 10 % off beside 9 %, tau 49 % beside 16 %."""
    fine_s = np.linspace(0.0, 1e-3 * bench.ms[-1], 400 * bench.ms.size)
    y = np.interp(fine_s, 1e-3 * bench.ms, np.cumsum(PERIOD_S * bench.v_rad_per_s))
    at = np.flatnonzero(np.diff(np.floor(y / step_rad)))
    ticks = np.maximum(np.round(np.diff(fine_s[at]) / tick_s), 1.0)
    v = np.sign(np.diff(y)[at[1:]]) * step_rad / (ticks * tick_s)
    last = np.searchsorted(fine_s[at[1:]], 1e-3 * bench.ms, side="right") - 1
    told: Floats = np.asarray(np.round(np.where(last < 0, 0.0, v[last]), 4), dtype=np.float64)
    columns = {"ms": bench.ms, "volts": bench.pwm * 12.0 / 255.0}
    log = replace(SPEED, velocity=LogColumn("rad/s"), counts_per_turn=None)
    with pytest.raises(RecordingError, match="one count over the time that it took"):
        read(log_of(tmp_path, columns | {"vel": told}), log)
    for digits in (0, 2):
        assert read(log_of(tmp_path, columns | {"vel": np.round(bench.v_rad_per_s, digits)}), log)


def test_counts_of_a_coarse_encoder_over_the_time_of_uneven_rows_are_not_one_count(
    tmp_path: Path, bench: Bench
) -> None:
    """Their velocities are few counts over few ticks, too, but over the row's own time: they add up to the counts."""
    at_s = np.cumsum(0.005 * (0.5 + np.random.default_rng(2).exponential(0.5, 1200)))
    y = np.interp(at_s, 1e-3 * bench.ms, np.cumsum(PERIOD_S * bench.v_rad_per_s))
    counts, shown = np.floor(y * 8.0 / TURN), at_s <= 1e-3 * bench.ms[-1]
    v = np.diff(counts, prepend=0.0) * TURN / 8.0 / np.diff(at_s, prepend=0.0)
    volts = np.interp(at_s, 1e-3 * bench.ms, bench.pwm * 12.0 / 255.0)
    columns = {"ms": 1e3 * at_s[shown], "volts": volts[shown], "vel": np.round(v[shown], 4)}
    found = read(log_of(tmp_path, columns), replace(SPEED, velocity=LogColumn("rad/s"), counts_per_turn=None))
    assert np.diff(found.y_rad) * 8.0 / TURN == pytest.approx(np.diff(counts[shown]), abs=0.01)


def test_a_velocity_that_wraps_without_a_motor_in_it_is_refused(tmp_path: Path, bench: Bench) -> None:
    noise = np.random.default_rng(3).integers(-32768, 32767, bench.ms.size).astype(float)
    path = log_of(tmp_path, {"ms": bench.ms, "volts": bench.pwm, "vel": noise})
    with pytest.raises(RecordingError, match="it wraps, and nobody can tell how often"):
        read(path, SPEED)


@pytest.mark.parametrize("rows", [None, 90])
def test_a_velocity_without_its_sign_is_refused(tmp_path: Path, bench: Bench, rows: int | None) -> None:
    path = log_of(tmp_path, {"ms": bench.ms[:rows], "volts": bench.pwm[:rows], "vel": np.abs(bench.v_rad_per_s[:rows])})
    with pytest.raises(RecordingError, match="its sign is missing"):
        read(path, SPEED)


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_velocity_that_is_cut_off_is_refused(tmp_path: Path, bench: Bench, noise: float) -> None:
    """Summed up, K of such a log was up to 90 % off, and graded."""
    v = bench.v_rad_per_s + noise * np.random.default_rng(5).standard_normal(bench.ms.size)
    columns, log = (
        {"ms": bench.ms, "volts": bench.pwm * 12.0 / 255.0},
        LogFormat(LogColumn("ms"), LogColumn("V"), velocity=LogColumn("rad/s")),
    )
    for digits in (2, 9):  # a motor stays at its largest speed, too, to a few digits
        read(log_of(tmp_path, columns | {"vel": np.round(v, digits)}), log)
    end = 0.6 * float(np.abs(v).max())
    with pytest.raises(RecordingError, match="it is cut off"):
        read(log_of(tmp_path, columns | {"vel": np.clip(v, -end, end)}), log)


@given(
    st.lists(st.tuples(st.floats(-9.0, 9.0), st.integers(1, 30)), min_size=1, max_size=12), st.floats(0.01, 0.5),
    st.floats(0.0, 2.0),
)  # fmt: skip
def test_a_velocity_that_a_brake_never_turns_round_keeps_its_sign(
    strokes: list[tuple[float, int]], tau_s: float, friction_V: float
) -> None:
    u = np.concatenate([np.full(rows, drive) for drive, rows in strokes])
    v = np.zeros(u.size)
    for k in range(1, v.size):
        v[k] = max(0.0, v[k - 1] + (u[k - 1] - friction_V - v[k - 1]) * (1.0 - np.exp(-0.01 / tau_s)))
    assert not has_no_sign(v, u)


@given(st.lists(st.floats(1e-3, 0.1), min_size=22, max_size=200), st.floats(-1e3, 1e3))
def test_only_times_since_the_row_before_are_added_up(steps: list[float], begins: float) -> None:
    steps_s, notes = np.array(steps), list[str]()
    clock = begins + np.cumsum(steps_s)
    assert added_up(clock, notes) is clock and not notes
    again = np.concatenate((clock, clock))  # another run
    assert added_up(again, notes) is again and not notes
    if np.mean(np.diff(steps_s) < 0.0) > 0.2:
        assert np.diff(added_up(steps_s, notes)) == pytest.approx(steps_s[1:]) and notes


@pytest.mark.parametrize("late", [0, 9])
def test_times_since_the_row_before_may_be_alike(late: int) -> None:
    """They were refused: "repeats the time before it"."""
    steps_s, notes = np.full(40, 0.005), list[str]()
    steps_s[:late] += 0.001
    assert np.diff(added_up(steps_s, notes)) == pytest.approx(steps_s[1:]) and notes
    still = np.full(40, 84.0)
    assert added_up(still, notes) is still


@pytest.mark.parametrize("share", [0.2, 0.7])
def test_times_since_the_row_before_that_scatter_a_little_are_no_clock_that_begins_anew(
    tmp_path: Path, bench: Bench, share: float
) -> None:
    """Microseconds within 3 of 5,000: "the clock begins anew after 4e-06 s", and then "repeats the time before it"."""
    rng = np.random.default_rng(5)
    off_us = rng.integers(-3, 4, bench.ms.size) * (rng.random(bench.ms.size) < share)
    steps_us = 5000.0 + off_us.astype(np.float64)
    log = replace(COUNTED, time=LogColumn("us", "dt"))
    path = log_of(tmp_path, {"dt": steps_us, "pwm": bench.pwm, "counts": bench.counts})
    recording = read(path, log)
    assert np.diff(recording.t_s) == pytest.approx(PERIOD_S, abs=5e-6)
    assert [note for note in recording.notes if "begins anew" in note] == []


def test_a_velocity_that_is_held_over_rows_is_read_where_it_is_new_and_keeps_each_drive(
    tmp_path: Path, bench: Bench
) -> None:
    """Differences of counts over four rows, as a slow task computes them, in a log of each row."""
    every = 4
    new = np.arange(0, bench.ms.size, every)
    means = np.diff(bench.counts[new], prepend=0.0) / (every * PERIOD_S)
    held = np.repeat(means, every)[: bench.ms.size]
    log = replace(SPEED, counts_per_turn=1440)
    found = read(log_of(tmp_path, {"ms": bench.ms, "volts": bench.pwm * 0.02, "vel": held}), log)
    assert found.t_s == pytest.approx(1e-3 * bench.ms[new])
    assert found.y_rad == pytest.approx(bench.counts[new] * TURN / 1440)
    assert found.drive_steps is not None and found.drive_steps[1] == pytest.approx(bench.pwm * 0.02)
    assert any("new in every 4th row" in note for note in found.notes)


@pytest.mark.parametrize(("largest", "is_told"), [(255, True), (250, False)])
def test_a_drive_that_ends_at_full_drive_of_fewer_bits_is_told(
    tmp_path: Path, bench: Bench, largest: int, is_told: bool
) -> None:
    """K was four times as large, and f_c a quarter, without a word."""
    pwm = np.round(bench.pwm * largest / np.abs(bench.pwm).max())
    log = log_of(tmp_path, {"ms": bench.ms, "pwm": pwm, "counts": bench.counts})
    told = [note for note in read(log, replace(COUNTED, full=1023)).notes if "is it --full 255?" in note]
    assert bool(told) == is_told


def test_a_drive_beyond_full_is_refused_with_what_full_may_be(tmp_path: Path, bench: Bench) -> None:
    columns = {"ms": bench.ms, "pwm": 4.0 * bench.pwm, "counts": bench.counts}
    with pytest.raises(RecordingError, match=r"the drive is 596, and --full says 255; .*such as --full 1023"):
        read(log_of(tmp_path, columns), COUNTED)
    percent = replace(COUNTED, drive=LogColumn("duty", "pwm"), full=None)
    with pytest.raises(RecordingError, match="in duty full drive is 1; give the unit that it is in; or"):
        read(log_of(tmp_path, columns), percent)
    with pytest.raises(RecordingError, match="such as per cent: --drive COLUMN:percent"):
        read(log_of(tmp_path, columns | {"pwm": 0.5 * bench.pwm}), percent)


@pytest.mark.parametrize("rows", [-1, 1, -2])
@pytest.mark.parametrize("what", ["pwm", "ms"])
def test_a_drive_or_a_time_that_stands_in_another_row_moves_back(
    tmp_path: Path, bench: Bench, what: str, rows: int
) -> None:
    columns = {"ms": bench.ms, "pwm": bench.pwm, "counts": bench.counts}
    path = log_of(tmp_path, columns | {what: np.roll(columns[what], -rows)})
    moved = replace(COUNTED, drive_row=rows) if what == "pwm" else replace(COUNTED, time_row=rows)
    found = read(path, moved)
    kept = slice(rows, None) if rows > 0 else slice(None, rows)
    assert found.t_s == pytest.approx(1e-3 * bench.ms[kept])
    assert found.u_V == pytest.approx(bench.pwm[kept] * 12.0 / 255.0)
    assert found.y_rad == pytest.approx(bench.counts[kept] * TURN / 1440)
    with pytest.raises(LogFormatError, match="more than 5 rows"):
        replace(COUNTED, drive_row=9)


def test_a_time_that_begins_again_begins_another_run(tmp_path: Path, bench: Bench) -> None:
    twice = {"ms": np.tile(bench.ms, 2), "pwm": np.tile(bench.pwm, 2), "counts": np.tile(bench.counts, 2)}
    path = log_of(tmp_path, twice)
    first, second = read_all(path, COUNTED)
    same(first, bench)
    same(second, bench)
    assert second.source.name == "log.csv (run 2 of 2)"
    with pytest.raises(RecordingError, match="holds 2 runs"):
        read(path, COUNTED)
    own = log_of(tmp_path, {"t_s": 1e-3 * twice["ms"], "u_V": twice["pwm"], "y_rad": twice["counts"]})
    assert [len(one) for one in read_all(own)] == [bench.ms.size, bench.ms.size]


def test_runs_of_a_noisy_velocity_are_no_clock_that_begins_anew(tmp_path: Path, bench: Bench) -> None:
    """Noise changes as much from row to row as a shaft that turns on, but to and fro."""
    rows, noise, alike = 210, np.random.default_rng(1), []
    for _ in range(40):
        v = np.tile(bench.v_rad_per_s[:rows], 4) + noise.normal(0.0, 10.0, 4 * rows)
        columns = {"ms": np.tile(bench.ms[:rows], 4), "volts": np.tile(bench.pwm[:rows], 4) / 20.0, "vel": v}
        path = log_of(tmp_path, columns)
        alike.append(len(read_all(path, replace(SPEED, velocity=LogColumn("rad/s"), counts_per_turn=None))))
    assert alike == [4] * 40


def test_a_column_may_say_which_run_a_row_is_of(tmp_path: Path, bench: Bench) -> None:
    """One after the other on one clock, with a gap."""
    trial = np.repeat([7.0, 3.0], bench.ms.size)
    ms = np.concatenate([bench.ms, bench.ms + 60000.0])
    columns = {"trial": trial, "ms": ms, "pwm": np.tile(bench.pwm, 2), "counts": np.tile(bench.counts, 2)}
    found = read_all(log_of(tmp_path, columns), replace(COUNTED, run="trial"))
    assert [len(one) for one in found] == [bench.ms.size, bench.ms.size]
    for one in found:
        same(one, bench)
    columns["trial"] = ms
    with pytest.raises(RecordingError, match="in fewer than 3 rows: that is no run; give the column that says which"):
        read_all(log_of(tmp_path, columns), replace(COUNTED, run="trial"))


@pytest.mark.parametrize(
    "head",
    [
        "# millis,pwm,counts\nms,-,counts\n",
        "#millis,pwm,counts\n# ms,-,counts\n",
        "# bench 3\n# millis,pwm,counts\n[ms],[],[counts]\n",
        "millis,pwm,counts\nmilliseconds,1,ticks\n",
        "% Matlab\n%millis,pwm,counts\nms,-,Counts\n",
    ],
)
def test_names_behind_a_hash_and_a_row_of_units_below_them(tmp_path: Path, head: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"{head}0,255,0\n10,-51,360\n20,0,720\n")
    assert read(path, COUNTED).t_s.tolist() == [0.0, 0.01, 0.02]


def test_a_current_is_no_drive() -> None:
    with pytest.raises(LogFormatError, match="a current is a torque"):
        LogColumn.parse("drive", "amps:A")
