"""What is found goes into the file in one step, and the file as it was stays beside it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rig.config import ready
from rig.config.edit import EditError, Value
from rig.run_folder.recording.errors import CannotWriteError
from rig.running.calibrate.draft import read_text, save
from rig.running.calibrate.session import open_config

TEXT = "\ufeffdrive:  # the bridge\r\n  max_V: 3.0  # little\r\n"
VALUES: dict[tuple[str | int, ...], Value] = {("drive", "max_V"): 2.5}


def test_the_file_changes_in_place_with_a_dated_backup(tmp_path: Path) -> None:
    """Byte order mark, line breaks, comments, mode and a link to the file stay."""
    real, link = tmp_path / "real.yaml", tmp_path / "bench.yaml"
    real.write_bytes(TEXT.encode())
    real.chmod(0o640)
    link.symlink_to(real)
    backups = [save(link, read_text(link), VALUES)]
    assert real.read_bytes().decode() == TEXT.replace("3.0", "2.5")
    assert link.is_symlink()
    backups.append(save(link, read_text(link), VALUES))
    assert backups[0] != backups[1]
    assert backups[0].read_bytes().decode() == TEXT
    assert backups[0].name.startswith("real.yaml.2")
    assert {path.stat().st_mode & 0o777 for path in (real, *backups)} == {0o640}
    assert len(list(tmp_path.iterdir())) == 4


def test_a_file_that_is_marked_read_only_is_left_alone(tmp_path: Path) -> None:
    """To replace it would need no right to write it."""
    file = tmp_path / "bench.yaml"
    file.write_text("drive: {max_V: 3.0}\n")
    file.chmod(0o444)
    with pytest.raises(EditError, match="marked read-only") as refused:
        save(file, read_text(file), VALUES)
    assert refused.value.cure.endswith(f"chmod u+w {file}")
    assert list(tmp_path.iterdir()) == [file]


def test_a_file_that_somebody_changed_meanwhile_is_left_alone(tmp_path: Path) -> None:
    file = tmp_path / "bench.yaml"
    file.write_text("drive: {max_V: 3.0}\n")
    text = read_text(file)
    file.write_text("drive: {max_V: 2.0}\n")
    with pytest.raises(EditError, match="has changed since it was read"):
        save(file, text, VALUES)
    assert file.read_text() == "drive: {max_V: 2.0}\n"
    assert len(list(tmp_path.iterdir())) == 1


def test_what_is_calibrated_is_what_was_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody changes the file right after that: then nothing is written over it."""
    file = tmp_path / "bench.yaml"
    text = "\ufeff" + ready.text("simulated").replace("\n", "\r\n")
    file.write_bytes(text.encode())

    def changes(_: object) -> None:
        file.write_bytes(text.replace("max_V: 3.0", "max_V: 2.0").encode())

    monkeypatch.setattr("rig.running.calibrate.session.require_device_file", changes)
    opened = open_config(file)
    assert (opened.text, opened.draft.original.drive.max_V) == (text, 3.0)
    with pytest.raises(EditError, match="has changed since it was read"):
        save(file, opened.text, VALUES)


def test_a_disk_that_takes_nothing_leaves_the_file_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "bench.yaml"
    file.write_text("drive: {max_V: 3.0}\n")

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CannotWriteError):
        save(file, read_text(file), VALUES)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["drive: {max_V: 3.0}\n"]
