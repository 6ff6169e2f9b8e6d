"""How the machine is set up: one function for each setting, from the kernel's files.

Every function takes ``root``, the folder that stands for ``/``.
"""

from __future__ import annotations

import os
import platform
import shutil
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from shlex import quote

from serial.tools import list_ports

from rig.backends.links.usb_adapters import Adapter, adapter_delay_s
from rig.backends.links.usb_port import LATENCY_MS, usb_port
from rig.control.loop import kernel_workers as kernel_workers_module
from rig.control.loop.kernel_workers import workers
from rig.control.loop.real_time import real_time
from rig.running.doctor.finding import Finding, State, bad, good, note, poor

ROOT = Path("/")
_FAST_CLOCKS = ("tsc", "kvm-clock", "hyperv_clocksource_tsc_page", "arch_sys_counter")
_FIFO = "1"  # SCHED_FIFO, as the kernel writes it
_ADAPTER = "USB adapter"
_LEAST_FREE_BYTES = 200e6
_NO_RUN_BYTES = 20e6  # one run with its report takes 4 to 11
_UDEV_RULE = (
    'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1" '
    "in /etc/udev/rules.d/99-rig.rules keeps it"
)


def examine(run_folder: Path, *, ports: bool = True) -> Iterator[Finding]:
    """Everything about this machine that can be checked without a run; ``ports``: all its serial ports, too."""
    yield kernel()
    yield clock_source()
    yield governor()
    yield cores()
    yield from scheduling()
    yield kernel_workers()
    if ports:
        yield from serial_ports()
    yield from latency_timers()
    yield modem_manager()
    yield disk(run_folder)


def _text(path: Path) -> str | None:
    """Text of a kernel's file, stripped; None where there is no such file or it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return None


def kernel(root: Path = ROOT) -> Finding:
    """Whether the kernel can be interrupted while it works for other programs."""
    release, build = platform.release(), platform.version()
    if _text(root / "sys/kernel/realtime") == "1" or "PREEMPT_RT" in build:
        return good("kernel", f"{release}, fully preemptible (PREEMPT_RT)")
    if "PREEMPT" in build:
        return good("kernel", f"{release}, preemptible")
    return note(
        "kernel",
        f"{release}, not preemptible: a wake-up can wait for milliseconds while the kernel works for other programs",
        "if the wake-ups measured below are too late, install a preemptible kernel: in Debian `sudo apt install "
        "linux-image-rt-amd64`",
    )


def clock_source(root: Path = ROOT) -> Finding:
    """The kernel's source of time; with some, each reading costs a microsecond or more."""
    source = _text(root / "sys/devices/system/clocksource/clocksource0/current_clocksource")
    if source is None:
        return note("clock", "the kernel does not say what it reads the time from")
    if source in _FAST_CLOCKS:
        return good("clock", f"read from {source}")
    return poor("clock", f"read from {source}, which is slow", "boot with `tsc=reliable`, if the machine has a TSC")


def governor(root: Path = ROOT) -> Finding:
    """Whether cores slow down while the loop sleeps."""
    files = sorted((root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor"))
    governors = Counter(filter(None, map(_text, files)))
    if not governors:
        return good("governor", "no frequency scaling on this machine")
    words = ", ".join(f"{name} on {count} cores" for name, count in sorted(governors.items()))
    if set(governors) == {"performance"}:
        return good("governor", words)
    return poor(
        "governor",
        f"{words}: a core that slows down while the loop sleeps wakes it late",
        "`echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor`, until the next boot",
    )


def cores(root: Path = ROOT) -> Finding:
    """How many cores there are, and whether the machine is virtual."""
    count = os.cpu_count() or 1
    flags = _text(root / "proc/cpuinfo") or ""
    if any("hypervisor" in line.split() for line in flags.splitlines() if line.startswith("flags")):
        return note(
            "cores",
            f"{count}, of a virtual machine: others on its host can stop it for milliseconds at any time",
            "for a real motor use a machine that is not virtual",
        )
    if count == 1:
        return poor("cores", "1: the recorder runs on the loop's core", "use a machine with two cores or more")
    return good("cores", f"{count}")


def scheduling() -> Iterator[Finding]:
    """Which real-time settings this user may use: rig asks for them as a run does, and gives them back."""
    with real_time() as done:
        pass
    for line in done.granted:
        yield good("real time", line)
    for line in done.refused:
        words, _, cure = line.partition(": ")
        yield poor("real time", words, cure)


def kernel_workers(root: Path = ROOT) -> Finding:
    """Whether a killed run has left the kernel's worker threads at the priority of `raise_workers`."""
    stats = (_text(root / f"proc/{worker.number}/stat") or "" for worker in workers(root / "proc"))
    # proc(5): after the name in brackets, which may have blanks in it, fields 3 and on; 41 is the policy
    policies = (text.rpartition(")")[2].split()[38:39] for text in stats)
    raised = sum(policy == [_FIFO] for policy in policies)
    if raised == 0:
        return good("workers", "the kernel's workers have their ordinary priority")
    keeper = Path(kernel_workers_module.__file__).name
    if any(keeper in (_text(line) or "") for line in (root / "proc").glob("[0-9]*/cmdline")):
        return note("workers", f"{raised} of the kernel's workers go first, for a run in progress")
    return poor(
        "workers",
        f"{raised} of the kernel's workers have real-time priority, and no run that raised them is left: it was killed",
        "`for p in $(pgrep '^kworker/u'); do sudo chrt --other --pid 0 $p; done`, or restart the machine",
    )


def serial_ports() -> Iterator[Finding]:
    """The serial ports of this machine, and whether this user may open them."""
    ports = sorted(port.device for port in list_ports.comports())
    if not ports:
        yield note(
            "serial port", "none is there", "if the board should be there, plug it in with a cable that has data wires"
        )
    for device in ports:
        yield serial_port(Path(device))
        yield usb_adapter(device, None)


def usb_adapter(device: str, reckoned: Adapter | None, root: Path = ROOT) -> Finding:
    """What sits between USB and the line behind a port, by its USB ids and an FTDI's timer.

    reckoned  the adapter that the config's sums assume; None: there is no config
    """
    port = usb_port(device, root)
    found, words = port.adapter, port.words
    if found is None:
        against = "" if reckoned is None else f"; the config's sums are made with daq.adapter: {reckoned}"
        return note(_ADAPTER, f"{words}{against}")
    if reckoned is None:
        return good(_ADAPTER, f"{words}; daq.adapter: {found}")
    if reckoned == found:
        return good(_ADAPTER, f"{words}, as the sums have it ({found})")
    slower = adapter_delay_s(found) > adapter_delay_s(reckoned)
    return Finding(
        _ADAPTER,
        "bad" if slower else "poor",
        f"{words}; but the config's sums are made with {reckoned}, which is {'quicker' if slower else 'no quicker'}",
        f"daq.adapter: {found}, then `rig check`",
    )


def serial_port(device: Path) -> Finding:
    """Whether this user may open one port."""
    if not device.exists():
        return bad("serial port", f"{device} is not there", "`ls /dev/serial/by-id/` lists the ports")
    if os.access(device, os.R_OK | os.W_OK):
        return good("serial port", f"{device} may be opened")
    try:
        import grp  # not everywhere

        group = grp.getgrgid(device.stat().st_gid).gr_name
    except (ImportError, KeyError):
        group = "dialout"
    if group == "root":  # who joins it may do more than open ports
        rule = f'SUBSYSTEM=="tty", KERNEL=="{device.name}", GROUP="dialout", MODE="0660"'
        return bad(
            "serial port",
            f"{device} belongs to root",
            f"name another port; or a udev rule gives this one to dialout: `echo {quote(rule)} | sudo tee "
            "/etc/udev/rules.d/99-rig-port.rules; sudo udevadm trigger`",
        )
    return bad(
        "serial port",
        f"{device} belongs to group {group}, and you are not in it",
        f"`sudo adduser $USER {group}`, then log in again",
    )


def latency_timers(root: Path = ROOT) -> Iterator[Finding]:
    """How long each USB chip collects bytes before it sends them on; an FTDI does for 16 ms by default."""
    for file in sorted((root / "sys/bus/usb-serial/devices").glob("*/latency_timer")):
        text = _text(file)
        if text is None or not text.isdigit():
            continue
        waits_ms, port = int(text), file.parent.name
        if waits_ms <= LATENCY_MS:
            yield good("USB latency", f"{port} waits {waits_ms} ms for more bytes")
        else:
            yield bad(
                "USB latency",
                f"{port} waits {waits_ms} ms for more bytes before it passes a short reply on",
                f"`echo {LATENCY_MS} | sudo tee {file}`; {_UDEV_RULE}",
            )


def modem_manager(root: Path = ROOT) -> Finding:
    """Whether ModemManager runs: it writes to every new serial port, to find out if that is a modem."""
    for comm in (root / "proc").glob("[0-9]*/comm"):
        if _text(comm) == "ModemManager":
            return poor(
                "ModemManager",
                "runs: it opens every new serial port and writes to it, for up to half a minute",
                "`sudo systemctl disable --now ModemManager`, unless you need a modem",
            )
    return good("ModemManager", "does not run")


def disk(run_folder: Path) -> Finding:
    """Whether the folder for runs can be written, and has room."""
    folder = run_folder.absolute()
    while not folder.exists():
        folder = folder.parent
    if not os.access(folder, os.W_OK):
        return bad("disk", f"you may not write to {folder}", "choose another folder with --out")
    free = shutil.disk_usage(folder).free
    if free < _LEAST_FREE_BYTES:
        state: State = "bad" if free < _NO_RUN_BYTES else "poor"
        words = f"{free / 1e6:.0f} MB free at {folder}; an hour at 10 ms takes about 45 MB"
        return Finding("disk", state, words, "make room, or choose another folder with --out")
    return good("disk", f"{free / 1e9:.1f} GB free at {folder}")
