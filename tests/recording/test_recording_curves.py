"""curves.json: what is written is read to the bit, and nothing is read that is damaged or of another run or answer."""

from __future__ import annotations

import base64
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.run_folder.recording.curves import Curves, read_curves, write_curves
from rig.run_folder.recording.errors import CannotWriteError, RecordingError
from rig.run_folder.recording.recording import Recording, from_columns
from rig.run_folder.results import Answer, FoundLawResult

ANSWER = Answer(method="sampled-data", tau_s=0.17, K_rad_s_V=6.5, fc_V=0.48, law=(FoundLawResult(name="dead_band"),))


def floats(*values: float) -> str:
    return base64.b64encode(np.array(values, "<f8").tobytes()).decode()


@pytest.fixture
def recording() -> Recording:
    t_s = np.arange(50) / 100.0
    return from_columns(Path("samples.csv"), t_s, np.sign(np.sin(9.0 * t_s)), np.cumsum(np.sin(9.0 * t_s)))


@pytest.fixture
def curves(recording: Recording) -> Curves:
    noise = np.random.default_rng(1).normal(size=40)
    trace = np.concatenate(([np.nan], 0.5 + 1.0 / np.arange(1.0, 12.0)))  # the first sample gives no friction yet
    return Curves(ANSWER, recording.t_s[:40], 1e-3 * noise, trace)


def refused(folder: Path, recording: Recording, answer: Answer | None = ANSWER) -> str:
    with pytest.raises(RecordingError) as raised:
        read_curves(folder, recording, answer)
    assert raised.value.path == folder / "curves.json"
    assert raised.value.cure
    return raised.value.cause


def test_what_is_written_is_read_to_the_bit(tmp_path: Path, recording: Recording, curves: Curves) -> None:
    write_curves(tmp_path, recording, curves)
    read = read_curves(tmp_path, recording, ANSWER)
    for name in ("residual_t_s", "residual_rad", "friction_V"):
        np.testing.assert_array_equal(getattr(read, name), getattr(curves, name))
    assert read.answer.method == "sampled-data"
    assert [path.name for path in tmp_path.iterdir()] == ["curves.json"]


def test_curves_of_other_rows_are_refused(tmp_path: Path, recording: Recording, curves: Curves) -> None:
    assert refused(tmp_path, recording) == "is missing"
    write_curves(tmp_path, recording, curves)
    moved_rad = recording.y_rad.copy()
    moved_rad[30] = np.nextafter(moved_rad[30], np.inf)
    others = (recording.select(0, 48), replace(recording, y_rad=moved_rad), replace(recording, u_V=recording.y_rad))
    for other in others:
        assert refused(tmp_path, other) == "is of other rows"


@pytest.mark.parametrize(
    "change",
    [{"method": "triple-relay"}, {"tau_s": 0.1701}, {"K_rad_s_V": None}, {"fc_V": 0.4801}, {"law": ()}, {"law": None}],
    ids=str,
)
def test_curves_of_another_answer_are_refused(
    tmp_path: Path, recording: Recording, curves: Curves, change: dict[str, Any]
) -> None:
    write_curves(tmp_path, recording, curves)
    other = ANSWER.model_copy(update=change)
    assert refused(tmp_path, recording, other) == "is of another answer than result.json"
    assert "another answer" in refused(tmp_path, recording, None)


def test_the_last_digits_of_another_processor_are_the_same_answer(
    tmp_path: Path, recording: Recording, curves: Curves
) -> None:
    write_curves(tmp_path, recording, curves)
    read_curves(tmp_path, recording, ANSWER.model_copy(update={"tau_s": 0.17 * (1.0 + 1e-9)}))


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("schema", 2, "has the form 2"),
        ("schema", "1", "schema must be a whole number"),
        ("rows_sha256", 0, "rows_sha256 must be"),
        ("method", None, "method must be"),
        ("law", [{}], "name is missing"),
        ("tau_s", "fast", "tau_s must be a number"),
        ("residual_rad", "AAAA", "is damaged"),  # three bytes
        ("residual_rad", "not base64!", "is damaged"),
        ("residual_rad", "\u00e4", "is damaged"),
        ("residual_rad", floats(1.0), "differ in length"),
        ("residual_rad", floats(*[0.0] * 39, np.nan), "no number"),
        ("residual_t_s", floats(*[0.0] * 39, np.inf), "no number"),
        ("friction_V", floats(-1e300), "too large"),
        ("friction_V", [0.5], "friction_V must be"),
    ],
)
def test_a_damaged_file_is_refused_in_words(
    tmp_path: Path, recording: Recording, curves: Curves, key: str, value: object, words: str
) -> None:
    write_curves(tmp_path, recording, curves)
    path = tmp_path / "curves.json"
    kept = json.loads(path.read_text())
    path.write_text(json.dumps(kept | {key: value}))
    assert words in refused(tmp_path, recording)
    path.write_text(json.dumps({name: kept[name] for name in kept if name != key}))
    assert f"{key} is missing" in refused(tmp_path, recording)


def test_a_torn_file_a_link_and_a_pipe_are_refused(tmp_path: Path, recording: Recording, curves: Curves) -> None:
    write_curves(tmp_path, recording, curves)
    path = tmp_path / "curves.json"
    whole = path.read_bytes()
    for torn in (b"", whole[:200], whole[:-3], b"\0" * 100, b"[]"):
        path.write_bytes(torn)
        refused(tmp_path, recording)
    path.write_bytes(whole)
    path.rename(tmp_path / "elsewhere.json")
    path.symlink_to("elsewhere.json")
    assert "link" in refused(tmp_path, recording)
    path.unlink()
    os.mkfifo(path)
    assert "pipe" in refused(tmp_path, recording)


@pytest.mark.parametrize("wrong", [-np.inf, np.inf, 1e200])
def test_what_the_reader_would_refuse_is_not_written(
    tmp_path: Path, recording: Recording, curves: Curves, wrong: float
) -> None:
    write_curves(tmp_path, recording, replace(curves, friction_V=np.array([0.5, wrong])))
    long = np.zeros(1_000_000)
    write_curves(tmp_path, recording, replace(curves, residual_t_s=long, residual_rad=long))
    assert not list(tmp_path.iterdir())


def test_a_file_that_cannot_be_written_is_an_error_and_leaves_nothing(
    tmp_path: Path, recording: Recording, curves: Curves
) -> None:
    (tmp_path / "curves.json").mkdir()
    with pytest.raises(CannotWriteError):
        write_curves(tmp_path, recording, curves)
    assert [path.name for path in tmp_path.iterdir()] == ["curves.json"]
