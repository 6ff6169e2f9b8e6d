"""Building the emulated board: from the repository, and as installed."""

from __future__ import annotations

import ctypes
import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from firmware_copy import copied_firmware

from rig.backends.emulated.errors import EmulationError
from rig.backends.serial.emulated import firmware_build


@pytest.mark.evidence
def test_an_installed_rig_builds_in_the_users_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    package = tmp_path / "site-packages" / "rig"
    sources = firmware_build.source_folder()
    for part in ("boards", "core", "motor"):  # what pyproject.toml packs into the wheel
        shutil.copytree(sources / part, package / "_firmware" / part)
    shutil.copy(sources / "Makefile", package / "_firmware" / "Makefile")
    monkeypatch.setattr(firmware_build, "_PACKAGE", package)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    packed = sorted(package.rglob("*"))
    built = firmware_build.build()
    assert built.is_relative_to(tmp_path / "cache" / "rig") and built.is_file()
    assert sorted(package.rglob("*")) == packed  # the package itself may be read-only

    source = package / "_firmware" / "core" / "rig_core.c"
    source.write_text(source.read_text() + "\n")
    assert firmware_build.build() != built  # other content, other folder


def test_a_clone_may_lie_in_a_folder_with_blanks_and_umlauts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No name that make builds may hold a blank. The compiler here writes empty files: it is about names alone."""
    clone = tmp_path / "Übung für alle"
    copied_firmware(clone / "firmware")
    compiler = tmp_path / "cc"
    compiler.write_text('#!/bin/sh\nwhile [ "$1" != -o ]; do shift; done\ntouch "$2"\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    monkeypatch.setattr(firmware_build, "_PACKAGE", clone / "rig")
    built = firmware_build.build()
    assert built.is_relative_to(clone) and built.is_file()
    with pytest.raises(EmulationError, match="blank"):
        firmware_build.build(tmp_path / "with a blank")


def test_missing_sources_are_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(firmware_build, "_PACKAGE", tmp_path / "rig")
    with pytest.raises(EmulationError, match="no firmware sources"):
        firmware_build.build()


def test_builds_at_the_same_time_wait_for_each_other(tmp_path: Path) -> None:
    with ThreadPoolExecutor(3) as pool:
        built = list(pool.map(lambda _: firmware_build.build(tmp_path), range(3)))
    assert len(set(built)) == 1
    assert ctypes.CDLL(str(built[0])).virtual_new


def test_a_build_that_takes_long_says_so_while_it_goes_on(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Here make goes on until three sentences have been said."""
    slow = tmp_path / "make"
    slow.write_text(f"#!/bin/sh\nuntil [ -e {tmp_path}/said ]; do sleep 0.01; done\n")
    slow.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    said: list[str] = []

    def say(words: str) -> None:
        said.append(words)
        if len(said) == 3:
            (tmp_path / "said").touch()

    monkeypatch.setattr(firmware_build, "SAY_AFTER_S", 0.01)
    monkeypatch.setattr(firmware_build, "SAY_EVERY_S", 0.01)
    monkeypatch.setattr(firmware_build, "_say", say)
    firmware_build.build(tmp_path / "build")
    assert said[2].startswith("rig: building the emulated board's firmware, once after an installation")
    monkeypatch.setattr(firmware_build, "SAY_AFTER_S", 1e9)
    said_before = len(said)
    firmware_build.build(tmp_path / "build")
    assert len(said) == said_before, "it is quick, and silent"


def test_it_says_so_to_a_terminal_and_into_the_panels_file_and_not_into_a_pipe(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    screen, terminal = os.openpty()
    seen, pipe = os.pipe()
    file = os.open(tmp_path / "one.stderr", os.O_WRONLY | os.O_CREAT)
    for end in (terminal, file, pipe):
        with os.fdopen(end, "w") as error:
            monkeypatch.setattr("sys.stderr", error)
            firmware_build._say("rig: building")
            if end == terminal:
                assert os.read(screen, 100).split() == [b"rig:", b"building"]
    assert (tmp_path / "one.stderr").read_text() == "rig: building\n"
    assert os.read(seen, 100) == b""
    os.close(screen)
    os.close(seen)
