"""The run folder's name and its small files."""

from __future__ import annotations

import json
import os
import secrets
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest

from rig.run_folder.recording.errors import CannotWriteError, RecordingError
from rig.run_folder.recording.folder import META, RESULT, create_run, json_text, write_whole

NOW = datetime(2025, 1, 31, 9, 30, 0, tzinfo=UTC)


def test_a_run_has_its_time_and_name_and_never_reuses_a_folder(tmp_path: Path) -> None:
    folders = [create_run(tmp_path / "runs", "demo", NOW) for _ in range(3)]
    assert [folder.name for folder in folders] == [
        "20250131T093000Z-demo",
        "20250131T093000Z-demo-2",
        "20250131T093000Z-demo-3",
    ]
    assert all(folder.is_dir() for folder in folders)


def test_the_time_is_utc_whatever_the_zone(tmp_path: Path) -> None:
    local = NOW.astimezone(timezone(timedelta(hours=-7)))
    assert create_run(tmp_path, "a", local).name == "20250131T093000Z-a"
    assert create_run(tmp_path, "b", NOW.replace(tzinfo=None)).name == "20250131T093000Z-b"


def test_a_parent_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("")
    with pytest.raises(RecordingError, match="runs: cannot be written"):
        create_run(tmp_path / "runs", "demo", NOW)


def write_result(folder: Path, result: dict[str, object]) -> None:
    write_whole(folder / RESULT, json_text(result))


def test_json_is_strict_and_numpy_is_welcome(tmp_path: Path) -> None:
    write_result(
        tmp_path,
        {
            "nan": float("nan"),
            "deep": [{"inf": np.inf}, (1, np.float64("nan"))],
            "array": np.array([[1.0, np.nan], [2.0, 3.0]]),
            "count": np.int64(3),
            "yes": np.bool_(True),
        },
    )

    def refuse(text: str) -> float:
        raise AssertionError(f"{text} in strict JSON")

    found = json.loads((tmp_path / "result.json").read_text(), parse_constant=refuse)
    assert found == {
        "nan": None,
        "deep": [{"inf": None}, [1, None]],
        "array": [[1.0, None], [2.0, 3.0]],
        "count": 3,
        "yes": True,
    }


def test_a_result_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    write_result(tmp_path, {"a": 1})
    with pytest.raises(TypeError):
        write_result(tmp_path, {"a": object()})
    with pytest.raises(TypeError, match="keys are strings"):
        write_result(tmp_path, {"a": {1: 2}})
    assert json.loads((tmp_path / "result.json").read_text()) == {"a": 1}
    write_result(tmp_path, {"a": 2})
    assert json.loads((tmp_path / "result.json").read_text()) == {"a": 2}
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]


def test_text_is_written_as_utf_8(tmp_path: Path) -> None:
    write_whole(tmp_path / "config.yaml", "name: démo\n")
    assert (tmp_path / "config.yaml").read_bytes() == "name: démo\n".encode()


def test_a_missing_folder_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"gone/meta\.json: cannot be written: No such file"):
        write_whole(tmp_path / "gone" / META, "{}")


def test_a_link_that_waits_in_the_folder_is_never_written_through(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Under the name that older versions would have used, and under the very name that this one is about to use."""
    victim = tmp_path / "victim"
    victim.write_text("mine")
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / f".result.json.{os.getpid()}").symlink_to(victim)
    write_result(folder, {"schema": 1})
    assert victim.read_text() == "mine" and json.loads((folder / "result.json").read_text()) == {"schema": 1}

    monkeypatch.setattr(secrets, "token_hex", lambda size: "foreseen")
    (folder / ".result.json.foreseen").symlink_to(victim)
    with pytest.raises(RecordingError, match="cannot be written"):
        write_result(folder, {"schema": 2})
    assert victim.read_text() == "mine" and json.loads((folder / "result.json").read_text()) == {"schema": 1}
    assert (folder / ".result.json.foreseen").is_symlink()  # what is not ours is not removed either


def test_a_written_file_has_the_rights_that_the_user_gives_new_files(tmp_path: Path) -> None:
    write_result(tmp_path, {})
    (tmp_path / "other").write_text("")
    assert (tmp_path / "result.json").stat().st_mode == (tmp_path / "other").stat().st_mode
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other", "result.json"]


def test_a_run_that_goes_on_writes_through_no_link_in_the_place_of_its_folder(tmp_path: Path) -> None:
    """A folder of runs may be one that others write in, too. A link that a user names is followed."""
    (victim := tmp_path / "victim").mkdir()
    (folder := tmp_path / "run").symlink_to(victim)
    with pytest.raises(CannotWriteError, match="its folder is a link"):
        write_whole(folder / META, "{}", follows_links=False)
    assert list(victim.iterdir()) == []
    write_whole(folder / META, "{}")
    assert [path.name for path in victim.iterdir()] == ["meta.json"]
