"""What others put beside the runs, or into one, while a run goes on and a panel looks at them."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from unittest.mock import patch

from faults.injector import FaultInjector
from rig.panel.bench import Bench
from rig.panel.messages import RefusedError
from rig.panel.past_runs import Runs
from rig.panel.watch import Follower, Watch
from rig.run_folder.catalogue import catalogue
from rig.run_folder.live.own_folder import NAME

_NOTE = {"command": "run", "pid": 2**22 + 1, "born": "long ago"}  # of a process that there is not
_PRECIOUS = f"{'a' * 16}.json"
_NEIGHBOUR = "20990101T000000Z-x"
_LOOKS = 10


def _as_link(panel: Path, victim: Path) -> AbstractContextManager[object]:
    panel.symlink_to(victim)
    return nullcontext()


def _as_pipe(panel: Path, victim: Path) -> AbstractContextManager[object]:
    os.mkfifo(panel)
    return nullcontext()


def _as_others(panel: Path, victim: Path) -> AbstractContextManager[object]:
    victim.rename(panel)
    victim.symlink_to(panel)
    return patch("os.geteuid", lambda: panel.stat().st_uid + 1)  # also without root: this user is another one


def panel_folder(put: Callable[[Path, Path], AbstractContextManager[object]]) -> Callable[[FaultInjector], None]:
    """``.panel`` is not rig's: a panel starts nothing, and what is there stays."""

    def act(injector: FaultInjector) -> None:
        runs, victim = injector.folder / "runs", injector.folder / "victim"
        victim.mkdir()
        (victim / _PRECIOUS).write_text(json.dumps(_NOTE), encoding="utf-8")
        with _cleared(runs), put(runs / NAME, victim):
            bench = Bench(None, runs)
            _look(bench, runs)
            try:
                bench._start("run", "config")
            except RefusedError as error:
                if error.status != 503:
                    raise
            else:
                raise AssertionError("a panel has started a run from a folder that is not rig's")
            if [path.name for path in victim.iterdir()] != [_PRECIOUS]:
                raise AssertionError("a panel has deleted what is not rig's")

    return act


HOSTILE: Mapping[str, bytes] = {
    "events.jsonl": b'{"kind": "link", "errors": 1e400}\n' + b"[" * 100_000 + b'\n{"kind": "stage", "name": "rest"}\n',
    "meta.json": b'{"a":' * 900 + b"1" + b"}" * 900,
    "config.yaml": b"a: &a {k: 1}\nb: {<<: [*a, *a]}\nc: 2001-99-99\nd: " + b"9" * 5000,
}


def neighbour(file: str) -> Callable[[FaultInjector], None]:
    """A run beside this one holds a hostile file: pages and list show this run and that one."""

    def act(injector: FaultInjector) -> None:
        runs = injector.folder / "runs"
        other = runs / _NEIGHBOUR
        with _cleared(runs):
            other.mkdir()
            for name in {"meta.json", file}:
                (other / name).write_bytes(HOSTILE[file] if name == file else b"{}")
            bench = Bench(None, runs)
            _look(bench, runs, Watch(bench, Runs(runs), opened=other))
            listed = {run.name for run in catalogue(runs).runs}
        if not any(one.folder.name in listed for one in bench.running) or _NEIGHBOUR not in listed:
            raise AssertionError(f"a run is not listed: {listed}")

    return act


@contextmanager
def _cleared(runs: Path) -> Iterator[None]:
    """After the block there is nothing in the folder but what was there before: whoever judges takes what he finds."""
    before = set(runs.iterdir())
    yield
    for path in set(runs.iterdir()) - before:
        shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()


def _look(bench: Bench, runs: Path, watch: Watch | None = None) -> None:
    """As a panel does: some looks, and what its pages are told. They have to see the run that goes on."""
    watch = watch or Watch(bench, Runs(runs))
    page = Follower(0)
    for k in range(_LOOKS):
        watch.look()
        page.due(watch.scene, operator=False, now_s=float(k))
    if not bench.running or watch.scene.run != bench.running[-1].folder.name or watch.scene.snapshot is None:
        raise AssertionError(f"the pages do not see the run: {watch.scene}")


ACTS: Mapping[str, Callable[[FaultInjector], None]] = {
    ".panel is a link": panel_folder(_as_link),
    ".panel is a pipe": panel_folder(_as_pipe),
    ".panel is another user's": panel_folder(_as_others),
    "hostile events beside": neighbour("events.jsonl"),
    "hostile meta beside": neighbour("meta.json"),
    "hostile config beside": neighbour("config.yaml"),
}
