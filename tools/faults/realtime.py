"""What may happen to the host, in real time: `rig relay` as a process of its own, the host board behind a pty.

The drive is that of the device's own trace. A shared machine is late now and then: by as much as the device missed its
ticks, and the loop its, in that run, a bound is longer.
"""

from __future__ import annotations

import contextlib
import csv
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from faults.backends import BOARD, ROOT
from faults.bounds import Bound, bound
from faults.rows import FREEZE_S, SEEN, SILENCE
from rig.config import check
from rig.daq.frames import FrameReader, Kind
from rig.emulate.host_board import HostBoard

FIRST_CYCLE = 2
TIMEOUT_S = 0.06  # as in config/demo.yaml
_DEVICE_PERIOD_S = 0.01  # of its trace
_WAIT_S = 60.0
_ATTEMPTS = 3


@dataclass(frozen=True)
class RealRow:
    """What happens to the host's process; the rest as in ``rows.Row``."""

    name: str
    how: str
    act: Callable[[subprocess.Popen[str]], None]
    bound: Bound
    codes: tuple[str, ...]
    status: tuple[int, ...]
    alone: bool = False


@dataclass(frozen=True)
class RealFound:
    """As ``case.Found``; late_s: by how much device and loop together were late; skipped: ticks of the loop."""

    row: str
    phase: float
    off_s: float
    bound_s: float
    late_s: float
    beyond_rad: float
    code: str
    status: int
    lost: int
    skipped: int
    restart: str
    trouble: tuple[str, ...]


def _send(number: signal.Signals) -> Callable[[subprocess.Popen[str]], None]:
    return lambda host: host.send_signal(number)


def _freeze(host: subprocess.Popen[str]) -> None:
    host.send_signal(signal.SIGSTOP)
    time.sleep(FREEZE_S)
    host.send_signal(signal.SIGCONT)


def _overload(host: subprocess.Popen[str]) -> None:
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2 * (os.cpu_count() or 1))]
    try:
        host.wait(_WAIT_S)
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()


REAL_ROWS = (
    RealRow("host SIGINT", "Ctrl-C", _send(signal.SIGINT), SEEN, ("INTERRUPTED",), (1,)),
    RealRow("host SIGTERM", "kill", _send(signal.SIGTERM), SEEN, ("INTERRUPTED",), (1,)),
    RealRow("host SIGKILL", "kill -9", _send(signal.SIGKILL), SILENCE, ("",), (-9,)),
    RealRow("host SIGSTOP, 1 s", "and SIGCONT", _freeze, SILENCE, ("DEVICE_WATCHDOG",), (1,)),
    RealRow(
        "host overloaded",
        "two busy processes for each core",
        _overload,
        bound("no drive is older than the watchdog allows", watchdog=1, tick=2),
        ("",),
        (0, 1),
        alone=True,
    ),
)


class EndedBefore(Exception):
    """The run ended before anything was done to it."""


def measure(row: RealRow, phase: float, restarts: bool = False) -> RealFound:
    """Run it. ``phase`` 0 to 1 of the limit cycle, as far as a process can be hit.

    A busy machine may starve the pseudo-terminal until the run ends by itself, before anything was done to it: then it
    is run again. Raises EndedBefore where that happens three times.
    """
    for _ in range(_ATTEMPTS - 1):
        with contextlib.suppress(EndedBefore):
            return _measure(row, phase, restarts)
    return _measure(row, phase, restarts)


def _measure(row: RealRow, phase: float, restarts: bool) -> RealFound:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = BOARD.config()
        config["daq"] |= {"port": str(folder / "device"), "timeout_s": TIMEOUT_S}
        config["loop"] = {"raise_workers": True}  # of the kernel, that carry a pseudo-terminal's bytes
        path = folder / "fault.yaml"
        path.write_text(yaml.safe_dump(config), encoding="utf-8")
        experiment = check(path)[0]
        assert experiment.emulated is not None
        with HostBoard() as board:
            board.start(experiment.emulated.model_dump(), 1, folder / "device", folder / "trace.csv")
            with _rig(folder, "relay") as host:
                period_s = _await_cycle(folder, host)
                time.sleep(phase * period_s)
                happened_s = time.monotonic()
                row.act(host)
                output = host.communicate(timeout=_WAIT_S)[0]
            time.sleep(experiment.daq.watchdog_s + 0.2)
            trace = _trace(folder)
            restart = _restart(folder) if restarts else ""
        return _judged(row, phase, folder, config, (host.returncode, output), happened_s, trace, restart)


@contextlib.contextmanager
def _rig(folder: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    command, *options = arguments
    logged = [sys.executable, "-m", "faults.logged_rig", str(folder / f"{command}.log")]
    host = subprocess.Popen(
        [*logged, command, str(folder / "fault.yaml"), *options, "--out", str(folder / f"{command}-runs")],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tools")])},
    )
    try:
        yield host
    finally:
        host.kill()
        host.wait()


def _restart(folder: Path) -> str:
    with _rig(folder, "jog", "--u-V", "0.8", "--seconds", "0.2") as host:
        output = host.communicate(timeout=_WAIT_S)[0]
    return "moves" if host.returncode == 0 and " rad" in output else f"refused: {output[-200:]}"


def _events(folder: Path) -> list[dict[str, Any]]:
    files = list((folder / "relay-runs").glob("*/events.jsonl"))
    lines = files[0].read_text(encoding="ascii").split("\n")[:-1] if files else []
    return [json.loads(line) for line in lines]


def _await_cycle(folder: Path, host: subprocess.Popen[str]) -> float:
    """Until FIRST_CYCLE is over; its length, s. Raises EndedBefore."""
    deadline_s = time.monotonic() + _WAIT_S
    while True:
        cycles = [event for event in _events(folder) if event["kind"] == "cycle"]
        if len(cycles) >= FIRST_CYCLE:
            return float(cycles[FIRST_CYCLE - 1]["period_s"])
        if host.poll() is not None or time.monotonic() > deadline_s:
            host.kill()
            raise EndedBefore(f"no limit cycle comes: {host.communicate()[0][-1000:]}")
        time.sleep(0.005)


def _trace(folder: Path) -> list[tuple[float, float, float]]:
    """Time, drive and position; a last line may be torn."""
    lines = (folder / "trace.csv").read_text(encoding="ascii").split("\n")[:-1]
    return [(float(r["t_s"]), float(r["drive_V"]), float(r["y_rad"])) for r in csv.DictReader(lines)]


def _judged(
    row: RealRow,
    phase: float,
    folder: Path,
    config: Mapping[str, Any],
    ended: tuple[int, str],
    happened_s: float,
    trace: list[tuple[float, float, float]],
    restart: str,
) -> RealFound:
    status, output = ended
    deadline_s = time.monotonic() + _WAIT_S
    while status == -signal.SIGKILL and not any(e["kind"] == "loop_died" for e in _events(folder)):
        if time.monotonic() > deadline_s:
            raise RuntimeError("the recorder does not say that the loop died")
        time.sleep(0.01)
    events = _events(folder)
    fault = next((event for event in events if event["kind"] == "fault"), None)
    code = "" if fault is None else str(fault["code"])
    with next((folder / "relay-runs").glob("*/samples.csv")).open(encoding="ascii") as file:
        rows = list(csv.DictReader(file))

    seen = [one for one in trace if one[0] >= happened_s - 0.1]
    device_late_s = max(b[0] - a[0] for a, b in itertools.pairwise(seen)) - _DEVICE_PERIOD_S
    # the loop's own lateness is part of what a signal waits for; while it is stopped it is what is measured
    counted = [r for r in rows if code == "INTERRUPTED" or code == ""]
    loop_late_s = max((1e-6 * float(r["late_us"]) for r in counted), default=0.0)
    late_s = max(device_late_s, 0.0) + loop_late_s
    if code == "" and status >= 0:
        acted_s = [float(r["t_u_s"]) for r in rows if r["t_u_s"] and r["stage"].startswith("relay")]
        off_s = max(b - a for a, b in itertools.pairwise(acted_s))
    else:
        last = max((k for k, one in enumerate(trace) if one[1] != 0.0), default=0)
        off_s = max(trace[last + 1][0] - happened_s, 0.0) if last + 1 < len(trace) else float("inf")
    low, high = config["limits"]["hard_rad"]
    times = BOARD.times(check(folder / "fault.yaml")[0], 1.0)
    bound_s = row.bound.seconds(times) + late_s
    lost = _lost(folder, rows, fault, killed=status == -signal.SIGKILL)
    skipped = sum(int(b["tick"]) - int(a["tick"]) - 1 for a, b in itertools.pairwise(rows))
    trouble = []
    if not off_s <= bound_s:
        trouble.append(f"drive on for {1e3 * off_s:.1f} ms, bound {1e3 * bound_s:.1f} ms")
    if code not in row.codes or status not in row.status:
        trouble.append(f"{code or 'no fault'}, exit status {status}: {output[-300:]}")
    if lost:
        trouble.append(f"{lost} samples lost")
    if restart not in ("", "moves"):
        trouble.append(f"the next run: {restart}")
    beyond_rad = max(0.0, *(max(y - high, low - y) for _, _, y in trace))
    return RealFound(
        row.name, phase, off_s, bound_s, late_s, beyond_rad, code, status, lost, skipped, restart, tuple(trouble)
    )


def _lost(folder: Path, rows: list[dict[str, str]], fault: Mapping[str, Any] | None, *, killed: bool) -> int:
    """Samples that the host received and the record has not.

    The last one of a killed host may have been received and not yet looked at; of a run without a fault it is no row.
    """
    packets = FrameReader().feed((folder / "relay.log").read_bytes())
    told = [packet.seq for packet in packets if packet.kind == Kind.STATE]
    first = int(rows[0]["seq"])
    recorded = {int(row["seq"]) for row in rows}
    told = told[told.index(first) :]
    missing = [seq for seq in told if seq not in recorded]
    may_miss = killed or fault is None or "counts" in str(fault["detail"])
    return len(missing) - (may_miss and missing[-1:] == told[-1:])
