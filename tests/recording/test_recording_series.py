"""Records: what is refused, the sensor's step and noise, and clocks."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic import LSB_RAD, Bench, dcr, motor, record, simulate, write_csv

from rig.identification.preprocessing import clock_ratio, from_recording
from rig.run_folder.recording.csv_file import read_csv
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.series import TIMES_ERROR_S, TimeSeries, steps_of
from rig.run_folder.results import RunMeta

N = 50
T = np.arange(N, dtype=float) * 0.01


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"y_rad": np.r_[np.zeros(N - 1), np.nan]}, "y_rad is not a number in row 49"),
        ({"u_V": np.zeros(N - 1)}, "column u_V has 49 values"),
        ({"t_s": T[::-1]}, "t_s does not increase at row 1"),
        ({"t_u_s": np.r_[T[:-1], 0.0]}, "t_u_s decreases at row 49"),
        ({"t_s": T[:1], "y_rad": T[:1], "t_u_s": None, "u_V": T[:1]}, "too few"),
    ],
)
def test_unusable_columns_are_named_with_row_and_cure(change: dict[str, Any], words: str) -> None:
    columns: dict[str, Any] = {"t_s": T, "y_rad": np.zeros(N), "t_u_s": T, "u_V": np.zeros(N)} | change
    with pytest.raises(IdentifyError, match=words) as caught:
        TimeSeries(**columns)
    assert caught.value.cure
    assert "\n" not in caught.value.cause


def test_the_sensors_step_is_found_and_a_smooth_signal_has_none() -> None:
    samples = simulate(motor(), dcr(0.8, 1.0), 400, Bench(noise_rad=0.002, lsb_rad=LSB_RAD))
    assert record(samples).resolution_rad() == pytest.approx(LSB_RAD, rel=1e-6)
    assert record(simulate(motor(), dcr(0.8, 1.0), 400, Bench(noise_rad=0.002))).resolution_rad() == 0.0


@pytest.mark.parametrize("noise", [0.001, 0.003, 0.01])
def test_noise_is_measured_beside_the_motion(noise: float) -> None:
    samples = simulate(motor(), dcr(0.8, 1.0), 1500, Bench(noise_rad=noise))
    assert record(samples).noise_rad() == pytest.approx(noise, rel=0.25)


def test_a_part_knows_its_rows() -> None:
    whole = record(simulate(motor(), dcr(0.8, 1.0), 100, Bench()))
    part = whole.part(20, 60).part(10, 20)
    assert (part.first_row, len(part)) == (30, 10)
    assert part.t_s[0] == whole.t_s[30]


def recording(tmp_path: Path, clock: float, jitter_s: float = 0.0) -> Recording:
    """A recording whose device clock runs ``clock`` times as fast as the host's."""
    samples = simulate(motor(), dcr(0.8, 1.0), 1500, Bench())
    rng = np.random.default_rng(4)
    late = rng.uniform(0.0, 1e-4, 1500)
    lines = ["tick,t_s,t_u_s,u_V,y_rad,late_us"]
    for k in range(1500):
        t = (k * 0.01 + late[k]) * clock + jitter_s * rng.standard_normal()
        lines.append(f"{k},{t:.9f},{t + 0.002:.9f},{samples.u_V[k]:.9g},{samples.y_rad[k]:.9g},{1e6 * late[k]:.3f}")
    path = tmp_path / "samples.csv"
    path.write_text("\n".join(lines) + "\n")
    one = read_csv(path)
    return replace(one, meta=RunMeta(period_s=0.01))


def test_the_clocks_ratio_is_refined_where_it_is_significant(tmp_path: Path) -> None:
    off = recording(tmp_path, 1.0005, 2e-4)
    ratio = clock_ratio(off)
    assert ratio is not None
    assert ratio.significant
    assert ratio.ratio == pytest.approx(1.0005, abs=1e-5)
    one, notes = from_recording(off, slice(100, 900), "relay-1")
    assert one.period_s == pytest.approx(0.01, rel=2e-3)
    assert float(one.t_s[-1] - one.t_s[0]) == pytest.approx(7.99, abs=1e-3)
    assert any("clock ratio" in note for note in notes)
    assert one.first_row == 100


def test_a_true_clock_is_left_alone_and_a_wild_one_refused(tmp_path: Path) -> None:
    same = recording(tmp_path, 1.0, 2e-4)
    one, notes = from_recording(same, slice(0, 1500), "relay-1")
    assert notes == []
    assert np.array_equal(one.t_s, same.t_s)
    with pytest.raises(IdentifyError, match="against the ticks"):
        from_recording(recording(tmp_path, 1.2), slice(0, 1500), "relay-1")


@pytest.mark.parametrize(
    ("said", "error_s"),
    [(3.5e-4, 3.5e-4), (0, 0.0), (None, TIMES_ERROR_S), (-1.0, TIMES_ERROR_S), (math.nan, TIMES_ERROR_S)],
)
def test_what_the_times_may_be_wrong_by_is_metas_word_or_the_default_of_an_older_run(
    tmp_path: Path, said: float | None, error_s: float
) -> None:
    one = recording(tmp_path, 1.0)
    if said is not None:
        one = replace(one, meta=RunMeta(times_error_s=said))
    read, _ = from_recording(one, slice(0, 900), "relay-1")
    assert read.part(10, 500).times_error_s == error_s


def test_times_of_the_drive_that_are_missing_are_filled_in_and_noted(tmp_path: Path) -> None:
    samples = simulate(motor(), dcr(0.8, 1.0), 200, Bench(delay_s=0.004))
    samples.t_u_s[[0, 1, 50, 120]] = np.nan
    path = tmp_path / "a.csv"
    write_csv(path, samples)
    path.write_text(path.read_text().replace("nan", ""))
    one, notes = from_recording(read_csv(path), slice(0, 200), "a.csv")
    assert len(one) == 198
    assert one.first_row == 2
    assert one.t_u_s == pytest.approx(samples.t_s[2:] + 0.004)
    assert "filled in" in notes[0]
    samples.t_u_s[::2] = np.nan
    write_csv(path, samples)
    path.write_text(path.read_text().replace("nan", ""))
    one, notes = from_recording(read_csv(path), slice(0, 200), "a.csv")
    assert one.t_u_s is None
    assert "not used" in notes[0]


def test_a_drives_own_period_is_found_and_a_delay_of_a_link_is_looked_for() -> None:
    t = np.arange(4000, dtype=float) * 0.005
    square = np.where(t % 1.3 < 0.65, 1.0, -1.0)
    chirp = np.sin(2 * np.pi * (0.3 + 0.1 * t) * t)
    still = np.ones_like(t)
    assert TimeSeries(t, t, None, square).drive_period_s() == pytest.approx(1.3, abs=0.01)
    assert TimeSeries(t, t, None, np.sin(2 * np.pi * t / 0.7)).drive_period_s() == pytest.approx(0.7, abs=0.01)
    assert TimeSeries(t, t, None, chirp).drive_period_s() is None
    assert TimeSeries(t, t, None, still).drive_period_s() is None
    assert TimeSeries(t, t, None, square).longest_delay_s == pytest.approx(0.01)
    assert TimeSeries(t * 0.1, t, None, square).longest_delay_s == pytest.approx(0.01)
    assert TimeSeries(t * 4.0, t, None, square).longest_delay_s == pytest.approx(0.04)


def test_edges_that_change_nothing_are_dropped_and_falling_times_refused() -> None:
    steps = steps_of(np.array([0.0, 1.0, 2.0]), np.array([1.0, 1.0, -1.0]))
    assert steps.edge_s.tolist() == [0.0, 2.0]
    assert steps.u_V.tolist() == [1.0, -1.0]
    with pytest.raises(ValueError, match="decrease"):
        steps_of(np.array([1.0, 0.0]), np.array([1.0, 2.0]))
    with pytest.raises(ValueError, match="one length"):
        steps_of(np.array([1.0]), np.array([1.0, 2.0]))
