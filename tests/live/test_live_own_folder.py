"""What strangers put in the place of rig's own folder beside the run folders, or into it is not used, not harmed."""

from __future__ import annotations

import json
import os
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rig.panel import processes
from rig.panel.calibration import Attendance, watched
from rig.panel.messages import RefusedError
from rig.run_folder.live.lease import HeldLease, Leaser
from rig.run_folder.live.own_folder import NAME, START_LOCK, HeldError, NotOwnError, OwnFolder
from rig.run_folder.live.stop_flag import born

NOTE = f"{'a' * 16}.json"
OVER = json.dumps({"command": "run", "pid": 2**22 + 1, "born": "long ago"})  # no process has this number
NOBODY = 65534


@pytest.fixture(autouse=True)
def nothing_waits() -> Iterator[None]:
    """An open that waits for a pipe is cut off: a test that hangs names nothing."""

    def cut_off(*_: object) -> None:
        raise TimeoutError("it waits")

    before = signal.signal(signal.SIGALRM, cut_off)
    signal.alarm(30)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def runs_of(tmp_path: Path) -> Path:
    (tmp_path / "runs" / NAME).mkdir(parents=True, mode=0o700)
    return tmp_path / "runs"


def refused(runs: Path) -> str:
    """What a start says that must not come to pass."""
    with pytest.raises(RefusedError) as told, processes.one_at_a_time(runs):
        pytest.fail("it went on")
    assert told.value.status == 503
    with pytest.raises(RefusedError):
        processes.start(runs, "run", [])
    return told.value.what


@pytest.mark.parametrize("lead", ["folder", "nowhere", "file"])
def test_a_link_in_the_folders_place_leads_nowhere_and_what_is_behind_it_stays(tmp_path: Path, lead: str) -> None:
    victim = tmp_path / "victim"
    if lead == "folder":
        victim.mkdir()
        (victim / NOTE).write_text(OVER)  # even what looks like rig's
        (victim / "precious.json").write_text("{}")
    elif lead == "file":
        victim.write_text("precious")
    before = sorted(victim.iterdir()) if victim.is_dir() else None
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / NAME).symlink_to(victim)
    runs = tmp_path / "runs"
    assert processes.found_again(runs) == [] and processes.of_others(runs, ()) == []
    assert "is a link" in refused(runs)
    with pytest.raises(NotOwnError, match="is a link"), watched(runs):
        pytest.fail("it went on")
    Attendance(runs, os.getpid()).renew()
    assert (sorted(victim.iterdir()) if victim.is_dir() else None) == before
    assert lead != "file" or victim.read_text() == "precious"
    assert lead != "nowhere" or not victim.exists()


def test_a_file_or_a_pipe_in_the_folders_place_is_named(tmp_path: Path) -> None:
    for make in (Path.touch, os.mkfifo):
        make(tmp_path / NAME)
        assert "is no folder" in refused(tmp_path)
        (tmp_path / NAME).unlink()


def test_the_folder_of_another_user_is_neither_used_nor_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = runs_of(tmp_path)
    (runs / NAME / NOTE).write_text(OVER)
    monkeypatch.setattr(os, "geteuid", lambda: NOBODY)  # this user is another one than the folder's
    (runs / NAME).chmod(0o755)
    assert processes.found_again(runs) == []
    assert "belongs to user" in refused(runs)
    assert stat.S_IMODE((runs / NAME).stat().st_mode) == 0o755 and names(runs / NAME) == [NOTE]


def test_a_file_of_another_user_in_it_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = runs_of(tmp_path)
    (runs / NAME / NOTE).write_text(OVER)
    (runs / NAME / START_LOCK).touch()
    with OwnFolder(runs) as folder:
        monkeypatch.setattr(os, "geteuid", lambda: NOBODY)
        for touch in (folder.open, folder.delete, lambda name: folder.read(name, 99)):
            with pytest.raises(NotOwnError, match="belongs to user"):
                touch(NOTE)
        with pytest.raises(NotOwnError, match="belongs to user"), folder.locked(START_LOCK, 0.0):
            pytest.fail("it went on")
    assert (runs / NAME / NOTE).exists()


@pytest.mark.parametrize("mask", [0o000, 0o022, 0o077, 0o777])
def test_the_folder_is_for_this_user_alone_whatever_the_mask_and_whoever_made_it(tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        with OwnFolder(tmp_path), processes.one_at_a_time(tmp_path):
            assert stat.S_IMODE((tmp_path / NAME).stat().st_mode) == 0o700
        if mask == 0o777:  # then a file that is made cannot be opened again by anyone but root
            return
        assert stat.S_IMODE((tmp_path / NAME / START_LOCK).stat().st_mode) & 0o077 == 0
        (tmp_path / NAME).chmod(0o777)  # of an older rig
        with processes.one_at_a_time(tmp_path):
            assert stat.S_IMODE((tmp_path / NAME).stat().st_mode) == 0o700
    finally:
        os.umask(before)


def a_link(path: Path, victim: Path) -> None:
    path.symlink_to(victim)


def a_pipe(path: Path, _: Path) -> None:
    os.mkfifo(path)


def a_folder(path: Path, _: Path) -> None:
    path.mkdir()


def a_second_name(path: Path, victim: Path) -> None:
    path.hardlink_to(victim)


def a_terminal(path: Path, _: Path) -> None:
    path.symlink_to("/dev/ptmx")


@pytest.mark.parametrize("put", [a_link, a_pipe, a_folder, a_second_name, a_terminal])
def test_what_is_no_file_of_rigs_is_neither_locked_nor_read_nor_deleted(
    tmp_path: Path, put: Callable[[Path, Path], None]
) -> None:
    runs, victim = runs_of(tmp_path), tmp_path / "victim"
    for name in (START_LOCK, NOTE, NOTE.replace("json", "stderr")):
        victim.write_text(OVER)
        place = runs / NAME / name
        put(place, victim)
        assert processes.found_again(runs) == []
        assert processes.StartedProcess(runs, NOTE, "run", 2**22 + 1, "?", None).end().words == ""
        if name == START_LOCK:
            with pytest.raises(RefusedError, match=START_LOCK), processes.one_at_a_time(runs):
                pytest.fail("it went on")
        assert os.path.lexists(place) and victim.read_text() == OVER
        place.rmdir() if put is a_folder else place.unlink()


def test_only_notes_that_rig_wrote_are_deleted(tmp_path: Path) -> None:
    runs = runs_of(tmp_path)
    said: dict[str, object] = {"command": "run", "pid": 2**22 + 1, "born": "long ago"}
    strangers = {
        "notes.json": OVER,
        f"{'b' * 16}.json": "",
        f"{'c' * 16}.json": "[" * 100_000,
        f"{'d' * 16}.json": json.dumps({**said, "more": 1}),
        f"{'e' * 16}.json": json.dumps({**said, "pid": "1"}),
        f"{'f' * 16}.json": json.dumps({**said, "pid": -1}),
        f"{'0' * 16}.json": OVER + " " * 5000,
        f"{'1' * 16}.JSON": OVER,
        f"{'2' * 17}.json": OVER,
    }
    for name, content in strangers.items():
        (runs / NAME / name).write_text(content)
    (runs / NAME / NOTE).write_text(OVER)
    (runs / NAME / NOTE.replace("json", "stderr")).write_text("its last words")
    assert processes.found_again(runs) == []
    assert names(runs / NAME) == sorted(strangers)


def test_a_look_makes_no_folder(tmp_path: Path) -> None:
    assert processes.found_again(tmp_path) == [] and list(tmp_path.iterdir()) == []


def test_whoever_swaps_folder_and_link_all_the_time_gets_nothing_deleted_or_made_behind_it(tmp_path: Path) -> None:
    """Between a look at the name and the use of it there is no gap: the folder is opened once."""
    runs, victim = runs_of(tmp_path), tmp_path / "victim"
    victim.mkdir()
    (victim / NOTE).write_text(OVER)
    (tmp_path / "link").symlink_to(victim)
    swap = (
        "import ctypes, sys\n"
        "libc, a, b = ctypes.CDLL(None, use_errno=True), sys.argv[1].encode(), sys.argv[2].encode()\n"
        "while True: libc.renameat2(-100, a, -100, b, 2)\n"  # RENAME_EXCHANGE
    )
    with subprocess.Popen([sys.executable, "-c", swap, str(runs / NAME), str(tmp_path / "link")]) as swapper:
        try:
            went = 0
            for _ in range(2000):
                processes.found_again(runs)
                try:
                    with processes.one_at_a_time(runs):
                        went += 1
                    with OwnFolder(runs) as folder, HeldLease(folder, name="x.lease"):
                        Leaser(folder, name="x.lease").close()
                except (RefusedError, OSError):
                    continue
        finally:
            swapper.kill()
    assert went > 0, "the folder itself was never met: the swap was too fast to say anything"
    assert names(victim) == [NOTE]


def test_a_lease_deletes_its_own_file_and_not_what_stands_in_its_place(tmp_path: Path) -> None:
    with HeldLease(tmp_path, name="x.lease"):
        (tmp_path / "x.lease").unlink()
        (tmp_path / "x.lease").write_text("precious")
    assert (tmp_path / "x.lease").read_text() == "precious"


def test_the_lock_is_for_one_and_free_again_when_its_process_is_killed(tmp_path: Path) -> None:
    code = (
        "import sys, time; from pathlib import Path; from rig.run_folder.live.own_folder import OwnFolder\n"
        "with OwnFolder(Path(sys.argv[1])) as folder, folder.locked('start.lock', 0.0):\n"
        "    print('has it', flush=True); time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE) as other:
        assert other.stdout is not None and other.stdout.readline()
        with OwnFolder(tmp_path) as folder:
            with pytest.raises(HeldError), folder.locked(START_LOCK, 0.05):
                pytest.fail("two have it")
            threading.Timer(0.2, other.kill).start()
            with folder.locked(START_LOCK, 30.0):
                pass


def test_a_process_that_was_noted_is_found_again_and_its_note_goes_with_it(tmp_path: Path) -> None:
    with OwnFolder(tmp_path) as folder:
        folder.write(NOTE, json.dumps({"command": "run", "pid": os.getpid(), "born": born(os.getpid())}).encode())
    (one,) = processes.found_again(tmp_path)
    assert one.lives and one.pid == os.getpid()
    one.end()
    assert names(tmp_path / NAME) == []
