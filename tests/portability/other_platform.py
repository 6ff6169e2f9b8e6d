"""Python as on another system, as far as this one can pretend: ``other_platform.py PLATFORM -m MODULE ...``

Runs like ``python``, and so do the processes that it starts: what only Linux has is hidden before rig is imported. The
packages that rig uses are loaded before that, since on another system they are that system's.
"""

from __future__ import annotations

import builtins
import importlib
import mmap
import multiprocessing
import os
import platform
import runpy
import select
import signal
import stat
import subprocess
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

HIDDEN_MODULES = ("fcntl", "termios", "tty", "pty", "grp", "pwd", "resource", "syslog", "_posixshmem")
NOT_ON_MACOS = (
    (os, ("posix_fallocate", "pidfd_open", "memfd_create")),
    (os, tuple(name for name in dir(os) if name.startswith(("sched_", "SCHED_")))),
    (mmap, ("MAP_POPULATE",)),
    (signal, ("pidfd_send_signal",)),
)
NOT_ON_WINDOWS = (
    (os, ("fork", "forkpty", "pread", "pwrite", "preadv", "openpty", "getpgid", "getsid", "setsid", "geteuid")),
    (os, ("getuid", "fchmod", "killpg", "O_CLOEXEC", "O_NONBLOCK", "O_NOCTTY", "O_NOFOLLOW", "O_DIRECTORY")),
    (mmap, ("MAP_SHARED", "MAP_PRIVATE")),
    (select, ("poll", "epoll")),
    (
        signal,
        ("SIGHUP", "SIGCONT", "SIGSTOP", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGKILL", "SIGCHLD", "pthread_sigmask"),
    ),
)
LOADED_BEFORE: tuple[str, ...] = (
    "numpy",
    "scipy.optimize",
    "scipy.signal",
    "scipy.io",
    "scipy.linalg",
    "scipy.special",
    "yaml",
)
LOADED_BEFORE += (
    "pydantic",
    "click",
    "rich.console",
    "rich.table",
    "rich.progress",
    "rich.live",
    "jinja2",
    "click.testing",
)
LOADED_BEFORE += ("matplotlib.figure", "matplotlib.backends.backend_agg", "matplotlib.backends.backend_svg", "tempfile")
LOADED_BEFORE += (
    "asyncio",
    "concurrent.futures",
    "importlib.metadata",
    "joblib",
    "json",
    "csv",
    "shutil",
    "logging",
    "uuid",
    "rig.model.library",  # a wheel of that system has its own
)


def pretend(name: str) -> None:
    """Hide what ``name``, win32 or darwin, does not have."""
    assert stat and tempfile and subprocess  # loaded while they can be
    lists = NOT_ON_MACOS if name == "darwin" else NOT_ON_MACOS + NOT_ON_WINDOWS
    platform.platform()  # from here on from its cache
    for module, names in lists:
        for attribute in names:
            if hasattr(module, attribute):
                delattr(module, attribute)
    if name == "win32":
        multiprocessing.set_start_method("spawn")
        _refuse_what_windows_refuses()
    hidden = HIDDEN_MODULES if name == "win32" else ()
    real_import = builtins.__import__

    def imported(name: str, *arguments: Any, **more: Any) -> ModuleType:
        if name in hidden:
            raise ImportError(f"No module named {name!r}")
        return real_import(name, *arguments, **more)

    builtins.__import__ = imported
    for module_name in hidden:
        sys.modules.pop(module_name, None)
    sys.platform = name


def _refuse_what_windows_refuses() -> None:
    real_start = subprocess.Popen.__init__

    def start(self: Any, *arguments: Any, **more: Any) -> None:
        if more.get("pass_fds"):
            raise ValueError("pass_fds not supported on Windows.")
        real_start(self, *arguments, **more)

    subprocess.Popen.__init__ = start  # type: ignore[method-assign]  # as on Windows
    real_open, real_mkdir = os.open, os.mkdir

    def plain(path: Any) -> None:
        if isinstance(path, str | os.PathLike) and set(Path(path).name) & set('<>:"|?*'):
            raise OSError(22, "Invalid argument", str(path))

    def opened(path: Any, *arguments: Any, **more: Any) -> int:
        plain(path)
        return real_open(path, *arguments, **more)

    def made(path: Any, *arguments: Any, **more: Any) -> None:
        plain(path)
        real_mkdir(path, *arguments, **more)

    os.open, os.mkdir = opened, made
    real_file_open = builtins.open

    def file_opened(file: Any, mode: str = "r", *arguments: Any, **more: Any) -> Any:
        caller = sys._getframe(1).f_globals.get("__name__", "")
        if caller.startswith("rig") and "b" not in mode and not more.get("encoding"):
            raise AssertionError(f"{file} is opened as text without encoding, by {caller}")
        plain(file)
        return real_file_open(file, mode, *arguments, **more)

    builtins.open = file_opened


def main(arguments: list[str]) -> None:
    name, *rest = arguments
    while rest and rest[0] in ("-S", "-P", "-I", "-s", "-E"):
        rest.pop(0)
    assert rest[0] == "-m", rest
    sys.path.pop(0)  # this file's folder
    if not rest[1].startswith("rig.run_folder.recording"):  # these load nothing but Python's own
        for module in LOADED_BEFORE:
            importlib.import_module(module)
    elif rest[1] == "rig.run_folder.recording.follow":
        importlib.import_module("rich.live")
    pretend(name)
    # what this process starts is started the same way
    sys.executable = os.environ["PRETENDED_PYTHON"]
    sys.argv = [rest[1], *rest[2:]]
    runpy.run_module(rest[1], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main(sys.argv[1:])
