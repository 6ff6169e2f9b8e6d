"""Who ends together with the first process of a container, from how each process was called, and in real containers."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rig.core.first_process import first_that_ends_with

GROUP = 50
ASKS = "import os; from rig.core.first_process import first_that_ends_with as first; print(first(os.getpid()))"

Told = tuple[str, int]  # how a process was called, and its group


def container(tmp_path: Path, *line: Told) -> tuple[int, Path]:
    """The number of the last one of processes that have started each other, the first one as 1; and their /proc."""
    pid, parent = 1, 0
    for words, group in line:
        (one := tmp_path / str(pid)).mkdir()
        (one / "cmdline").write_text("".join(f"{word}\0" for word in words.split()))
        (one / "stat").write_text(f"{pid} ({Path(words.split()[0]).name}) S {parent} {group} 1 0 -1")
        parent, pid = pid, pid + 7
    (tmp_path / "self/ns").mkdir(parents=True)
    (tmp_path / "self/ns/pid").touch()
    return parent, tmp_path


@pytest.mark.parametrize("line", [
    (("rig run", 1),),  # docker run IMAGE rig run
    (("/sbin/docker-init -- rig run", 1), ("rig run", 7)),  # the same with --init
    (("sh -c cd$x;rig$run", 1), ("rig run", 1)),
    (("bash -lc rig", 1), ("rig run", GROUP)),  # set -m
    (("/bin/bash go.sh", 1), ("rig run", GROUP)),
    (("sh", 1), ("rig run", 1)),  # its commands on standard input
    (("make all", 1), ("sh -c rig$run", 1), ("timeout 60 rig", GROUP), ("rig run", GROUP)),
    (("tini -- sudo rig", 1), ("sudo rig", 7), ("rig run", 8)),
    (("sh -c cd$x&&rig$run", 1), ("su - u -c rig$run", 1), ("rig run", 8)),  # su gives its command a session
    (("bash -eo pipefail -c rig$run", 1), ("rig run", GROUP)),
    (("bash --rcfile x -o vi go.sh", 1), ("rig run", GROUP)),
    (("busybox sh -c rig$run", 1), ("rig run", GROUP)),
])  # fmt: skip
def test_a_container_that_lives_for_rig_is_told_by_its_first_process(line: tuple[Told, ...], tmp_path: Path) -> None:
    assert first_that_ends_with(*container(tmp_path, *line)) == line[0][0]


@pytest.mark.parametrize("line", [
    (("bash", 1), ("rig run", GROUP)),  # docker run -it IMAGE bash
    (("-bash -l --norc", 1), ("sh -c rig", GROUP), ("rig run", GROUP)),
    (("bash --rcfile env.sh", 1), ("rig run", GROUP)),
    (("bash -O extglob -eo vi", 1), ("rig run", GROUP)),
    (("busybox sh", 1), ("rig run", GROUP)),
    (("sleep inf", 1), ("su - u -c rig$run", 7), ("rig run", 8)),
    (("/sbin/init", 1), ("sshd", 7), ("-bash", 8), ("rig run", GROUP)),
    (("tini -- jupyter lab", 1), ("jupyter lab", 7), ("python kernel", GROUP)),
])  # fmt: skip
def test_one_that_lives_on_is_told_apart(line: tuple[Told, ...], tmp_path: Path) -> None:
    assert first_that_ends_with(*container(tmp_path, *line)) == ""


def test_who_came_into_a_container_from_outside_does_not_end_it(tmp_path: Path) -> None:
    pid, proc = container(tmp_path, ("sleep inf", 1), ("rig run", 1))
    (proc / f"{pid}/stat").write_text(f"{pid} (rig) S 0 {pid} 1 0 -1")
    assert first_that_ends_with(pid, proc) == ""


def test_where_nobody_may_see_its_parents_nothing_is_said(tmp_path: Path) -> None:
    assert first_that_ends_with(7, tmp_path) == ""


@pytest.mark.skipif(shutil.which("unshare") is None, reason="no unshare(1)")
@pytest.mark.parametrize(("shell", "is_told"), [("", True), ("; :", True), (None, False)])
def test_the_kernel_tells_it_so(shell: str | None, is_told: bool) -> None:
    """As the first process itself, as the child of a shell that ends with it, and outside of a container."""
    if shell is None:
        assert first_that_ends_with(1 << 30) == ""
        return
    command = f"{sys.executable} -c '{ASKS}'{shell}"
    inside = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--mount-proc", "sh", "-c", command]
    ended = subprocess.run(inside, capture_output=True, text=True, check=False)
    if "unshare" in ended.stderr:
        pytest.skip(f"this machine makes no container: {ended.stderr.strip()}")
    assert bool(ended.stdout.strip()) == is_told, ended
