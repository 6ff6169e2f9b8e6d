"""Several recordings that should be of one motor: the one that is not is named, in words, with what to type."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from command_line import rig
from synthetic import Bench, Samples, dcr, motor, record, simulate, write_csv

from rig.identification.agreement import disagreement, estimates_of_each
from rig.identification.opinion import RecordingEstimate

MOTORS = {
    "a": (motor(), 0.8, 1.0), "b": (motor(), 0.7, 0.95), "c": (motor(), 0.6, 0.9),
    "odd": (motor(K_rad_s_V=6.5 * 1.12), 0.8, 1.0), "weak": (motor(fc_V=0.4), 0.8, 1.0),
}  # fmt: skip


@cache
def samples(name: str) -> Samples:
    of, h1_V, h2_V = MOTORS[name]
    return simulate(of, dcr(h1_V, h2_V), 600, Bench(noise_rad=0.002, seed=list(MOTORS).index(name)))


@cache
def opinion(name: str) -> RecordingEstimate:
    [found] = estimates_of_each([(f"{name}.csv", [record(samples(name))])])
    return found


@pytest.mark.parametrize("order", [("a", "b", "odd"), ("odd", "c", "b"), ("a", "odd", "b", "c"), ("weak", "a", "c")])
def test_the_one_that_does_not_belong_is_named(order: tuple[str, ...]) -> None:
    said = disagreement([opinion(name) for name in order])
    assert said is not None
    [odd] = {"odd", "weak"} & set(order)
    differs = {"odd": "K is 7.", "weak": "f_c is 0.39"}[odd]
    assert said.startswith(f"{odd}.csv does not belong with the others, which agree: {differs}")
    others = " ".join(f"{name}.csv" for name in order if name != odd)
    assert said.endswith(f"Leave it out: `rig identify {others}`")


def test_recordings_of_one_motor_agree() -> None:
    assert disagreement([opinion(name) for name in "abc"]) is None
    assert disagreement([opinion("a")]) is None


def test_of_two_neither_is_named() -> None:
    said = disagreement([opinion("a"), opinion("odd")])
    assert said is not None
    assert said.startswith("a.csv and odd.csv do not agree: in odd.csv K is 7.")
    assert "with a third one rig names the odd one" in said


def test_where_several_differ_none_is_named() -> None:
    said = disagreement([opinion(name) for name in ("a", "weak", "odd")])
    assert said is not None
    assert said.startswith("the 3 recordings do not agree, and more than one differs")


def test_a_run_in_a_file_of_several_is_to_be_cut_out_of_it() -> None:
    """The command that was named has no such file."""
    runs = [replace(opinion(name), name=f"log.csv (run {k} of 3)") for k, name in enumerate(("a", "odd", "b"), 1)]
    said = disagreement(runs)
    assert said is not None
    assert said.endswith("Leave it out: `rig identify run-1.csv run-3.csv`, cut out of log.csv")


def test_one_that_cannot_be_identified_alone_has_no_opinion() -> None:
    still = Samples(*(getattr(samples("a"), name).copy() for name in ("t_s", "t_u_s", "y_rad", "u_V", "z_rad_s")))
    still.y_rad[:] = 0.0
    assert estimates_of_each([("still.csv", [record(still)]), ("none.csv", [])]) == []


def test_one_motor_is_seldom_called_two() -> None:
    """Of 2,000 sets of three recordings with the error that they tell, the odd one is named as often as is promised."""
    rng = np.random.default_rng(1)
    base = opinion("a")
    spread = np.linalg.cholesky(base.covariance)
    named = sum(
        disagreement(
            [RecordingEstimate(name, base.values + spread @ rng.standard_normal(3), base.covariance) for name in "abc"]
        )
        is not None
        for _ in range(2000)
    )
    assert named <= 2  # 0.2 to be expected


@pytest.mark.evidence
@pytest.mark.usefixtures("plain_motor")
def test_identify_says_it_and_calls_the_estimate_doubtful(tmp_path: Path) -> None:
    paths = [write_csv(tmp_path / f"{name}.csv", samples(name)) for name in ("a", "b", "odd")]
    result = rig("identify", *paths, "--method", "sampled-data", "--verbose")
    assert result.exit_code == 0, result.output
    assert f"sampled-data: {paths[2]} does not belong with the others" in result.stdout
    assert f"`rig identify {paths[0]} {paths[1]}`" in result.stdout
    assert "doubtful" in result.stdout
