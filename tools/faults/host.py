"""Faults of the host: of its process, its disk, its clock, its files."""

from __future__ import annotations

import ctypes
import os
import signal
import time
from pathlib import Path

from faults.injector import FaultInjector

_CLONE_NEWNS, _CLONE_NEWUSER = 0x20000, 0x10000000
_MS_REC, _MS_PRIVATE = 0x4000, 0x40000
_CAP_DAC_OVERRIDE = 1
_CAPABILITIES_3 = 0x20080522
_WAIT_S = 20.0


def writer_pid() -> int:
    """Process id of the recorder's writer, which is a child of this process."""
    children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text(encoding="ascii").split()
    for pid in children:
        if b"rig.run_folder.recording.writer" in Path(f"/proc/{pid}/cmdline").read_bytes():
            return int(pid)
    raise RuntimeError("no recorder runs")


def kill_recorder(injector: FaultInjector) -> None:
    """SIGKILL to the writer; returns when it is dead."""
    pid = writer_pid()
    os.kill(pid, signal.SIGKILL)
    deadline_s = time.monotonic() + _WAIT_S
    while Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()[0] != "Z":
        if time.monotonic() > deadline_s:
            raise RuntimeError("the recorder does not die")
        time.sleep(0.001)


def step_clock(injector: FaultInjector) -> None:
    """The wall clock of this process jumps an hour back."""
    right = time.time

    def wrong() -> float:
        return right() - 3600.0

    def undo() -> None:
        time.time = right

    time.time = wrong
    injector.to_undo.append(undo)


def own_mounts() -> None:
    """From here on this process may mount file systems that nobody else sees.

    Raises PermissionError, and OSError in a chroot whose root is no mount point.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    uid = os.getuid()
    if libc.unshare(_CLONE_NEWNS if uid == 0 else _CLONE_NEWNS | _CLONE_NEWUSER) != 0:
        raise PermissionError("a small disk is a file system of its own: be root, or allow user namespaces")
    if uid != 0:
        Path("/proc/self/uid_map").write_text(f"0 {uid} 1", encoding="ascii")
    if libc.mount(None, b"/", None, _MS_REC | _MS_PRIVATE, None) != 0:
        number = ctypes.get_errno()
        raise OSError(
            number, f"mounts stay shared, {os.strerror(number)}; the root of a chroot: bind it to itself first"
        )


def small_disk(folder: Path, size: int) -> None:
    """A file system of ``size`` bytes at ``folder``, for this process and its children."""
    own_mounts()
    libc = ctypes.CDLL(None, use_errno=True)
    _must(libc.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", 0, f"size={size}".encode()))


def fill_disk(folder: Path) -> None:
    """Write until nothing more fits."""
    with (folder / "filler").open("wb", buffering=0) as file:
        for piece in (65536, 4096, 512, 1):
            try:
                while True:
                    file.write(b"\0" * piece)
            except OSError:
                continue


class _Header(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint32), ("pid", ctypes.c_int32))


class _Sets(ctypes.Structure):
    _fields_ = (("effective", ctypes.c_uint32), ("permitted", ctypes.c_uint32), ("inheritable", ctypes.c_uint32))


def obey_permissions() -> None:
    """From here on this process is held to the permissions of files and folders, even where it is root's."""
    if os.geteuid() != 0:
        return
    libc = ctypes.CDLL(None, use_errno=True)
    header, sets = _Header(_CAPABILITIES_3, 0), (_Sets * 2)()
    _must(libc.capget(ctypes.byref(header), sets))
    sets[0].effective &= ~(1 << _CAP_DAC_OVERRIDE)
    _must(libc.capset(ctypes.byref(header), sets))


def _must(result: int) -> None:
    if result != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
