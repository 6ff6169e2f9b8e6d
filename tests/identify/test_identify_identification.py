"""From files to estimates: rows, methods, notes, and errors for people."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evidence import evidence
from synthetic import LSB_RAD, Bench, Samples, dcr, motor, simulate, write_csv

from rig.identification import METHODS, IdentifyError, identify
from rig.identification.identification import Identification
from rig.run_folder.recording.csv_file import read_csv

pytestmark = pytest.mark.long

NOISY: dict[str, Any] = {"noise_rad": 0.003, "lsb_rad": LSB_RAD}
KEYS = {
    "tau_s", "K_rad_s_V", "fc_V", "asym_V", "delay_s", "fc_plus_V", "fc_minus_V", "bias_V", "ci95", "covariance",
    "covariance_of",
    "correlation", "residual", "rms_rad", "iterations", "verdict", "reasons", "rows",
}  # fmt: skip


def relay(h1: float = 0.8, h2: float = 1.0, rows: int = 1200, **bench: Any) -> Samples:
    return simulate(motor(), dcr(h1, h2), rows, Bench(**(NOISY | bench)))


def run_csv(path: Path) -> Path:
    """One file with two relay stages and a search before them, as a run records it."""
    lines = ["t_s,t_u_s,u_V,y_rad,stage"]
    offset = 0.0
    for stage, samples in (
        ("search", relay(rows=200)),
        ("relay-1", relay()),
        ("relay-2", relay(0.6, 1.2, 1600, seed=2)),
    ):
        for t, t_u, u, y in zip(samples.t_s, samples.t_u_s, samples.u_V, samples.y_rad, strict=True):
            lines.append(f"{t + offset:.9f},{t_u + offset:.9f},{u:.9g},{y:.9g},{stage}")
        offset += samples.t_s.size * 0.01
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Identification:
    """Of that file."""
    return identify([read_csv(run_csv(tmp_path_factory.mktemp("run") / "samples.csv"))])


def test_a_run_with_two_relay_tests_gives_all_three_methods(found: Identification) -> None:
    assert tuple(found.estimates) == tuple(method for method in METHODS if method != "least-squares")
    best = found.estimates["sampled-data"]
    assert found.best is not None and found.best.tau_s == pytest.approx(best.tau_s, rel=0.01)
    assert best.verdict == "ok", best.reasons
    assert (best.tau_s, best.K_rad_s_V, best.fc_V) == pytest.approx((0.17, 6.5, 0.5), rel=0.03)
    assert 200 <= best.rows[0] < 210
    assert best.rows[1] == 2999
    assert [(r.stage, round(r.h1_V, 6), round(r.h2_V, 6)) for r in found.relays] == [
        ("relay-1", 0.8, 1.0), ("relay-2", 0.6, 1.2),
    ]  # fmt: skip
    assert set(found.cycles) == {"relay-1", "relay-2"}
    assert any("h1 = 0.8 V" in note for note in found.notes)
    assert any("settled cycles of" in note for note in found.notes)
    for method in ("triple-relay", "describing-function"):
        assert abs(found.estimates[method].tau_s / 0.17 - 1.0) < 0.4
        assert found.estimates[method].rms_rad > best.rms_rad


def test_the_dictionary_is_that_of_result_json(found: Identification) -> None:
    for estimate in found.estimates.values():
        entry = json.loads(json.dumps(estimate.as_result().as_json(), allow_nan=False))
        assert set(entry) == KEYS
        assert np.array(entry["covariance"], dtype=object).shape == (5, 5)
        assert entry["fc_plus_V"] is None
        assert entry["verdict"] in ("ok", "doubtful", "refused")
        assert all(low is None or low <= entry[name] <= high for name, (low, high) in entry["ci95"].items())
    assert found.estimates["describing-function"].as_result().delay_s is None


@pytest.mark.parametrize("known", [True, *evidence(False)])
def test_a_plain_csv_of_one_relay_test_gives_two_methods_and_says_what_is_missing(tmp_path: Path, known: bool) -> None:
    found = identify([read_csv(write_csv(tmp_path / "log.csv", relay(), known))])
    assert set(found.estimates) == {"sampled-data", "triple-relay"}
    assert any("needs two relay tests" in note for note in found.notes)
    assert found.estimates["sampled-data"].tau_s == pytest.approx(0.17, rel=0.05)


def test_two_csv_files_are_two_tests(tmp_path: Path) -> None:
    files = [write_csv(tmp_path / "a.csv", relay()), write_csv(tmp_path / "b.csv", relay(0.6, 1.2, 1600))]
    found = identify([read_csv(file) for file in files], ["describing-function"], choose_law=False)
    assert set(found.estimates) == {"describing-function"}
    assert found.estimates["describing-function"].fc_V == pytest.approx(0.5, rel=0.5)
    assert [r.stage for r in found.relays] == ["a.csv", "b.csv"]


@pytest.mark.parametrize("known", [True, *evidence(False)])
def test_a_log_without_any_relay_is_identified_from_its_samples(tmp_path: Path, known: bool) -> None:
    samples = simulate(motor(), lambda t, y, z: 1.5 if t % 1.0 < 0.5 else -1.5, 1000, Bench(**NOISY))
    found = identify([read_csv(write_csv(tmp_path / "square.csv", samples, known))])
    assert set(found.estimates) == {"sampled-data"}
    assert found.best is not None
    assert (found.best.tau_s, found.best.fc_V) == pytest.approx((0.17, 0.5), rel=0.1)
    # that it is no relay's is no news to who drove it
    assert not any(words in note for note in found.notes for words in ("dual-channel", "triple-relay", "describing"))


@pytest.mark.parametrize(
    ("method", "words"),
    [("describing-function", "needs two"), ("triple-relay", "relay"), ("guess", "no method 'guess'")],
)
def test_a_wanted_method_that_cannot_work_says_why(tmp_path: Path, method: str, words: str) -> None:
    drive = (lambda t, y, z: 1.5 if t % 1.0 < 0.5 else -1.5) if method == "triple-relay" else dcr(0.8, 1.0)
    samples = simulate(motor(), drive, 1000, Bench(**NOISY))
    with pytest.raises(IdentifyError, match=words) as caught:
        identify([read_csv(write_csv(tmp_path / "a.csv", samples))], [method])
    assert caught.value.cure


@pytest.mark.parametrize(
    "spoil",
    [
        lambda s: s.u_V.__setitem__(slice(None), 0.0),
        lambda s: s.y_rad.__setitem__(slice(None), 0.1),
        lambda s: (s.u_V.__setitem__(slice(None), 1e9), s.y_rad.__setitem__(slice(None), s.t_s)),
        lambda s: s.y_rad.__setitem__(slice(None), np.sign(s.y_rad)),
        *evidence(
            lambda s: s.y_rad.__setitem__(slice(None), np.random.default_rng(1).standard_normal(s.y_rad.size)),
            lambda s: s.u_V.__setitem__(slice(None), np.random.default_rng(1).standard_normal(s.u_V.size)),
            lambda s: s.y_rad.__setitem__(slice(None), -s.y_rad),  # test_identify_foreign_csv.py has it, too
        ),
    ],
)
def test_nonsense_is_refused_in_words_and_never_believed(tmp_path: Path, spoil: Callable[[Samples], object]) -> None:
    samples = relay(rows=600)
    spoil(samples)
    recording = read_csv(write_csv(tmp_path / "a.csv", samples, t_u_known=False))
    try:
        found = identify([recording])
    except IdentifyError as error:
        assert error.cause
        assert error.cure
        return
    for estimate in found.estimates.values():
        json.dumps(estimate.as_result().as_json(), allow_nan=False)
    assert all(estimate.verdict != "ok" for estimate in found.estimates.values())
    assert all(estimate.reasons for estimate in found.estimates.values())


@pytest.mark.parametrize(
    ("y_scale", "t_scale", "u_scale"),
    [(1.0, 1e-3, 1.0), *evidence((1e6, 1.0, 100.0), (1e6, 1.0, 1.0), (1.0, 1e3, 1.0), (1.0, 1.0, 100.0))],
)
def test_other_units_give_the_same_motor_in_those_units(
    tmp_path: Path, y_scale: float, t_scale: float, u_scale: float
) -> None:
    samples = relay()
    scaled = Samples(
        samples.t_s * t_scale, samples.t_u_s * t_scale, samples.y_rad * y_scale, samples.u_V * u_scale, samples.z_rad_s
    )
    one, other = (identify([read_csv(write_csv(tmp_path / "a.csv", s))]).estimates for s in (samples, scaled))
    for method in ("sampled-data", "triple-relay"):
        assert other[method].tau_s == pytest.approx(one[method].tau_s * t_scale, rel=1e-5)
        assert other[method].K_rad_s_V == pytest.approx(one[method].K_rad_s_V * y_scale / t_scale / u_scale, rel=1e-5)
        assert other[method].fc_V == pytest.approx(one[method].fc_V * u_scale, rel=1e-5)
        assert other[method].verdict == "refused"
        assert any("?" in reason for reason in other[method].reasons)


@pytest.mark.evidence
def test_every_short_piece_of_a_record_is_identified_or_refused_and_never_wrong_with_confidence(tmp_path: Path) -> None:
    """Half a cycle to many, of two amplitudes: an estimate that calls itself ok is near the truth."""
    large, small = dcr(0.8, 1.0), dcr(0.55, 0.8)
    samples = simulate(motor(), lambda t, y, z: (large if t < 7.5 else small)(t, y, z), 1500, Bench(**NOISY))
    recording = read_csv(write_csv(tmp_path / "a.csv", samples))
    outcomes = []
    for first, last in ((300, 330), (300, 360), (300, 400), (200, 420), (100, 600), (0, 1499), (0, 80)):
        try:
            best = identify([recording.select(first, last)], ["sampled-data"]).estimates["sampled-data"]
        except IdentifyError:
            outcomes.append("none")
            continue
        outcomes.append(best.verdict)
        if best.verdict == "ok":
            assert (best.tau_s, best.K_rad_s_V, best.fc_V) == pytest.approx((0.17, 6.5, 0.5), rel=0.1)
    assert "ok" in outcomes
    assert outcomes[0] != "ok"


def test_a_run_without_a_relay_test_is_refused(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "a.csv", relay(rows=100), stage="jog")
    with pytest.raises(IdentifyError, match="no relay test"):
        identify([read_csv(path)])
    with pytest.raises(IdentifyError, match="no recording"):
        identify([])
