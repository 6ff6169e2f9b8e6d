"""What may happen to host and link, in real time: `rig relay` as a process of its own, each device as another.

And to the whole machine: there the device in virtual time, which is no process, is tried too, at the pace of the clock.

The drive is that of the device's own trace. A shared machine is late now and then: by as much as the loop was late in
that run, and as the longest exchange took more than the others, a bound is longer. Devices catch up with missed ticks,
each at its own time: what they were late shows in the exchanges only.
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import Any

import yaml

from emulated_chips.chip_board import ChipBoard
from faults import hanging_laws
from faults.acts import FREEZE_S
from faults.backends import BOARD, CHIP, MODBUS, ROOT, TCP, Backend
from faults.bounds import Bound, bound
from faults.rows import AT_ONCE, SEEN, SILENCE
from rig.backends.emulated.board_process import BoardProcess
from rig.backends.modbus.emulated.modbus_board import ModbusBoard
from rig.backends.modbus.emulated.rtu_slave import check_sum
from rig.backends.registry import connect
from rig.backends.serial.emulated.serial_board import HostBoard
from rig.backends.serial.frames import FrameReader, Kind
from rig.config.schema import Experiment
from rig.core.faults import Fault
from rig.run_folder.recording.stage import StageKind, kind_of
from rig.running.preflight import check

FIRST_CYCLE = 2
TIMEOUT_S = 0.06  # as in config/demo.yaml
_WAIT_S = 60.0
_STARTS_S = 180.0  # to start, and to get to a limit cycle, on a busy machine
_ATTEMPTS = 3


@dataclass(frozen=True, eq=False)
class RealDevice:
    """A device as a process; its rows' bounds and config are those of a backend.

    start    its process, config, folder: starts it, returns its port
    changes  of the config's section daq
    told     keys of the samples in what its host has received; ``apart``: least distance between two of them
    between  of these, how many fall between the breakaway check and the relay test, and are no rows
    is_bare  it holds its last drive for ever: what only a watchdog stops is not tried on it
    name     in the table; "": that of its backend
    options  of the command
    """

    backend: Backend
    process: Callable[[], Any]
    start: Callable[[Any, Experiment, Path], str]
    changes: Mapping[str, Any]
    told: Callable[[bytes], list[int]]
    apart: int
    between: int
    is_bare: bool = False
    name: str = ""
    options: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Its name in the table."""
        return self.name or self.backend.key

    @property
    def is_virtual(self) -> bool:
        """Whether it is no process: it has no trace but the rows, and no link on which a sample could be lost."""
        return bool(self.options)


@dataclass(frozen=True)
class Case:
    """What an act gets: the host's process, the device's, and the file that says what happens to the link."""

    host: subprocess.Popen[str]
    device: BoardProcess | None
    link_fault: Path


@dataclass(frozen=True)
class RealRow:
    """What happens to the host's process, or to the link; the rest as in ``rows.Row``.

    codes, status  by the key of a device, "" for all others
    only           keys of devices; none: all but the bare one
    law            way in which a law of the user's own hangs (``hanging_laws``); "": a relay test goes on
    loop           of section loop of the config
    counts_from_hang  the bound begins when the law hangs, not when something is done
    """

    name: str
    how: str
    act: Callable[[Case], None]
    bound: Bound
    codes: Mapping[str, tuple[str, ...]]
    status: tuple[int, ...]
    alone: bool = False
    only: tuple[str, ...] = ()
    law: str = ""
    loop: Mapping[str, Any] = field(default_factory=dict)
    counts_from_hang: bool = False

    def is_for(self, device: RealDevice) -> bool:
        """Whether it is tried on that device."""
        return device.key in self.only if self.only else not device.is_bare


@dataclass(frozen=True)
class RealFound:
    """As ``case.Found``; late_s: by how much device and loop together were late; skipped: ticks of the loop."""

    row: str
    device: str
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


def _send(number: signal.Signals) -> Callable[[Case], None]:
    return lambda case: case.host.send_signal(number)


def _reset(case: Case) -> None:
    assert case.device is not None
    case.device.reset()


def _freeze(case: Case) -> None:
    case.host.send_signal(signal.SIGSTOP)
    time.sleep(FREEZE_S)
    case.host.send_signal(signal.SIGCONT)


def _stand_still(for_s: float) -> Callable[[Case], None]:
    """The whole machine: all processes of host and device, together."""

    def act(case: Case) -> None:
        stopped = [case.host.pid, *_children(case.host.pid), *([] if case.device is None else [case.device.pid])]
        with _going_first():
            began_s = time.monotonic()
            try:
                _tell(stopped, signal.SIGSTOP)
                time.sleep(for_s)
            finally:
                _tell(stopped, signal.SIGCONT)
            stood_s = time.monotonic() - began_s
        if case.device is not None and for_s < _LONGEST_GAP_S < stood_s:
            raise EndedBefore(f"this machine let it stand still for {1e3 * stood_s:.0f} ms, not {1e3 * for_s:.0f}")

    return act


def _tell(pids: Sequence[int], number: signal.Signals) -> None:
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):  # it has just ended
            os.kill(pid, number)


def _children(pid: int) -> list[int]:
    """Of all generations; none of a process that has just ended."""
    try:
        text = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii")
    except OSError:
        return []
    return [one for child in map(int, text.split()) for one in (child, *_children(child))]


def say(word: str) -> Callable[[Case], None]:
    """Write what happens to the link, in one piece."""

    def act(case: Case) -> None:
        fresh = case.link_fault.with_suffix(".new")
        fresh.write_text(word, encoding="ascii")
        fresh.rename(case.link_fault)

    return act


def _overload(case: Case) -> None:
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2 * (os.cpu_count() or 1))]
    try:
        case.host.wait(_WAIT_S)
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()


def _beside(changes: Mapping[str, str], *codes: str) -> Callable[[Case], None]:
    """Another process opens the device, with the same config but for these keys of ``daq``: refused with a code."""

    def act(case: Case) -> None:
        folder = case.link_fault.parent
        config = yaml.safe_load((folder / "fault.yaml").read_text(encoding="utf-8"))
        port = config["daq"]["port"].replace("127.0.0.1", "localhost")  # by another name of this machine
        config["daq"] |= {"port": port, **changes}
        (folder / "other.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
        try:
            with connect(check(folder / "other.yaml")[0].device):
                raise RuntimeError("the other process was not refused")
        except Fault as fault:
            if fault.code not in codes:
                raise RuntimeError(f"the other process was refused by {fault}") from fault

    return act


def _serial_start(board: Any, experiment: Experiment, folder: Path) -> str:
    assert experiment.emulated is not None
    board.start(experiment.emulated, 1, folder / "device", folder / "trace.csv")
    return str(folder / "device")


def _modbus_start(tcp_port: int | None) -> Callable[[Any, Experiment, Path], str]:
    def start(board: Any, experiment: Experiment, folder: Path) -> str:
        assert experiment.emulated is not None and experiment.daq.modbus is not None
        return str(
            board.start(experiment.daq.modbus, experiment.emulated, 1, trace=folder / "trace.csv", tcp_port=tcp_port)
        )

    return start


def _states(log: bytes) -> list[int]:
    """Keys of the samples in what a host has received of a serial device."""
    return [packet.seq for packet in FrameReader().feed(log) if packet.kind == Kind.STATE]


def _rtu_replies(log: bytes) -> list[int]:
    """Of an I/O block: its replies to FC23 are counted from 1, as in the recording."""
    length, found, at = 13, 0, 0
    while (at := log.find(bytes((1, 23, 8)), at)) >= 0:
        whole = log[at : at + length]
        is_one = len(whole) == length and check_sum(whole[:-2]) == whole[-2:]
        found, at = found + is_one, at + (length if is_one else 1)
    return list(range(1, found + 1))


def _tcp_replies(log: bytes) -> list[int]:
    return list(range(1, log.count(bytes((0, 0, 0, 11, 1, 23, 8))) + 1))


def _without_watchdog() -> dict[str, Any]:
    """Section daq of a block that knows drive and position only."""
    daq = TCP.config()["daq"]
    kept = {name: daq["modbus"]["registers"][name] for name in ("drive", "sequence", "position")}
    changes = {"accept_no_watchdog": True, "timeout_s": 0.02, "watchdog_s": 0.2}
    return {**daq, **changes, "modbus": {**daq["modbus"], "registers": kept}}


_PATIENT = {"timeout_s": TIMEOUT_S}
NO_WATCHDOG = RealDevice(
    replace(
        TCP,
        key="no-watchdog",
        title="an I/O block on TCP without watchdog, which holds its last drive",
        traits=("modbus", "fc23", "tcp", "no-watchdog"),
        changes={"daq": _without_watchdog(), "period_s": 0.02},
    ),
    ModbusBoard,
    _modbus_start(0),
    {},
    _tcp_replies,
    1,
    2,
    is_bare=True,
)
DEVICES = (
    RealDevice(BOARD, HostBoard, _serial_start, _PATIENT, _states, 2, 1),
    RealDevice(CHIP, ChipBoard, _serial_start, _PATIENT, _states, 2, 1),
    RealDevice(MODBUS, ModbusBoard, _modbus_start(None), {}, _rtu_replies, 1, 2),
    RealDevice(TCP, ModbusBoard, _modbus_start(0), {}, _tcp_replies, 1, 2),
    NO_WATCHDOG,
    RealDevice(
        BOARD, contextlib.nullcontext, lambda *_: "emulated", _PATIENT, lambda log: [], 2, 0,
        name="virtual, paced", options=("--pace", "1"),
    ),
)  # fmt: skip
_PROCESSES = tuple(device.key for device in DEVICES if not device.is_virtual and not device.is_bare)
_FROZEN_S = (0.04, 0.08, 0.15, 1.0)
_SILENT = ("DEVICE_WATCHDOG", "LINK_TIMEOUT")
# a device that stood still for a second may find its shaft outside before it finds that nobody spoke to it
_FROZEN_CODES = (("",), ("",), _SILENT, (*_SILENT, "DEVICE_TRAVEL", "DEVICE_SENSOR"))
_LONGEST_GAP_S = 0.085  # that leaves the next drive the time to come before the watchdog acts
_STALLED = bound("no drive is older than the watchdog allows", watchdog=1, tick=2)
_DROPPED = ("", "LINK_TIMEOUT", "DEVICE_WATCHDOG", "LINK_REPLY")  # a Modbus run ends with the first reply that is late

_LAW_DEVICES = ("board", NO_WATCHDOG.key)
_LEASE = bound(
    "the law's lease, as long as the watchdog; a look before and after; the stop",
    watchdog=1,
    period=2,
    exchange=2,
    frame=1,
    tick=2,
)
_KILLED = bound(
    "the same, and half the lease again until the killed process of the loop is gone",
    watchdog=1.5,
    period=3,
    exchange=2,
    frame=1,
    tick=2,
)
_UNHURRIED = {"law_cpu_s": 0.4}  # so that it is the signal that ends the law


def _law_row(name: str, way: str, code: str, status: int, *signals: signal.Signals) -> RealRow:
    """A law that does not return, and signals that come meanwhile."""

    def act(case: Case) -> None:
        for number in signals:
            case.host.send_signal(number)
            time.sleep(0.002)

    by_signal = code not in ("LAW_TIME", "LAW_FAILED")  # else the law's time, or what it does, is what ends it
    return RealRow(
        name,
        f"a law of the user's own, `{way}`{' and signals' if signals else ''}",
        act,
        SEEN if code == "INTERRUPTED" else _KILLED if way == hanging_laws.THREAD else _LEASE,
        {"": (code,)},
        (status,),
        only=_LAW_DEVICES,
        law=way,
        loop=_UNHURRIED if by_signal else {},
        counts_from_hang=not by_signal,
    )


_LAW_ROWS = (
    _law_row("law hangs", "spins", "LAW_TIME", 1),
    _law_row("law sleeps", "sleeps", "LAW_TIME", 1),
    _law_row("law hangs in C", "in C", "LAW_TIME", -9),
    _law_row("law sleeps in C", "locked", "LAW_TIME", -9),
    _law_row("law swallows every exception", "swallows", "LAW_TIME", -9),
    _law_row("a thread of the law holds Python", hanging_laws.THREAD, "LAW_TIME", -9),
    _law_row("law ends the process by os._exit", "exits", "LAW_FAILED", 1),
    *(
        _law_row(f"law hangs, {number.name}", "spins", "INTERRUPTED", 1, number)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    ),
    _law_row("law hangs, SIGINT twice", "spins", "INTERRUPTED", 1, signal.SIGINT, signal.SIGINT),
    _law_row("law hangs in C, SIGINT twice", "in C", "LAW_TIME", -9, signal.SIGINT, signal.SIGINT),
)

REAL_ROWS = (
    RealRow("cable out", "nothing passes", say("cut"), SILENCE, {"": ("LINK_TIMEOUT",)}, (1,), only=_PROCESSES),
    RealRow(
        "port gone",
        "the port's other end is closed; of TCP the connection is reset",
        say("gone"),
        SILENCE,
        {"": ("LINK_LOST",)},
        (1,),
        only=_PROCESSES,
    ),
    RealRow(
        "device reset",
        "by its reset input",
        _reset,
        AT_ONCE,
        {"": ("DEVICE_RESET", "LINK_TIMEOUT", "DEVICE_NOT_ARMED"), "tcp": ("LINK_LOST",)},
        (1,),
        only=_PROCESSES,
    ),
    RealRow(
        "second master",
        "another process opens the same device, by another name of this machine: it is refused",
        _beside({}, "SECOND_MASTER", "LINK_OPEN"),
        bound("the run goes on", watchdog=1, tick=2),
        {"": ("",)},
        (0,),
        alone=True,
        only=_PROCESSES,
    ),
    RealRow(
        "another board under the same name",
        "another process opens the port for the USB serial number of another board: it is refused before it does",
        _beside({"usb_serial": "of-another-board"}, "OTHER_BOARD"),
        bound("the run goes on", watchdog=1, tick=2),
        {"": ("",)},
        (0,),
        alone=True,
        only=("board", "chip"),
    ),
    RealRow("host SIGINT", "Ctrl-C", _send(signal.SIGINT), SEEN, {"": ("INTERRUPTED",)}, (1,), only=("board",)),
    RealRow("host SIGTERM", "kill", _send(signal.SIGTERM), SEEN, {"": ("INTERRUPTED",)}, (1,), only=("board",)),
    RealRow("host SIGKILL", "kill -9", _send(signal.SIGKILL), SILENCE, {"": ("",)}, (-9,), only=_PROCESSES),
    RealRow("host SIGSTOP, 1 s", "and SIGCONT", _freeze, SILENCE, {"": ("DEVICE_WATCHDOG",)}, (1,), only=_PROCESSES),
    RealRow(
        "host overloaded",
        "two busy processes for each core",
        _overload,
        _STALLED,
        {"": ("",), "chip": ("", "LINK_TIMEOUT", "DEVICE_WATCHDOG"), "modbus": _DROPPED, "tcp": _DROPPED},
        (0, 1),
        alone=True,
        only=_PROCESSES,
    ),
    *(
        RealRow(
            f"whole machine frozen, {1e3 * for_s:.0f} ms",
            "all processes of host and device stop together; on the board the motor goes on meanwhile",
            _stand_still(for_s),
            _STALLED,
            {"virtual, paced": ("",), "": codes},
            (0, 1),
            only=("board", "virtual, paced"),
        )
        for for_s, codes in zip(_FROZEN_S, _FROZEN_CODES, strict=True)
    ),
    *_LAW_ROWS,
)
# no row of the page: the keeper stops the device here, and every other command has none
KILLED_LAW = _law_row("law hangs, kill -9", "spins", "", -9, signal.SIGKILL)


class EndedBefore(Exception):
    """The run ended before anything was done to it."""


def measure(row: RealRow, device: RealDevice, phase: float, restarts: bool = False) -> RealFound:
    """Run it. ``phase`` 0 to 1 of the limit cycle, as far as a process can be hit.

    A busy machine may starve the link until the run ends by itself, before anything was done to it: then it is run
    again. Raises EndedBefore where that happens three times.
    """
    for _ in range(_ATTEMPTS - 1):
        with contextlib.suppress(EndedBefore):
            return _measure(row, device, phase, restarts)
    return _measure(row, device, phase, restarts)


def _measure(row: RealRow, device: RealDevice, phase: float, restarts: bool) -> RealFound:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = device.backend.config()
        config["daq"] |= {"port": str(folder / "device"), **device.changes}
        if "serial" in device.backend.traits:  # its pseudo-terminal could be any board's port
            config["daq"]["adapter"] = "none"
            config["drive"]["bridge"] = "pwm-dir"
        config["loop"] = {"raise_workers": True, **row.loop}  # of the kernel, that carry a pseudo-terminal's bytes
        mark = folder / "mark"
        if row.law:
            config["law"] = hanging_laws.section(row.law, mark)
        path = folder / "fault.yaml"
        path.write_text(yaml.safe_dump(config), encoding="utf-8")
        with hanging_laws.offered(folder), device.process() as board:
            config["daq"]["port"] = device.start(board, check(path)[0], folder)
            path.write_text(yaml.safe_dump(config), encoding="utf-8")
            experiment = check(path)[0]
            with _rig(folder, "run" if row.law else "relay", *device.options) as host:
                if not row.law:
                    time.sleep(phase * _await_cycle(folder, host))
                with contextlib.nullcontext() if row.alone else _going_first():  # what takes long has no moment
                    hung_s = _await_mark(mark, host) if row.law else 0.0
                    happened_s = hung_s if row.counts_from_hang else time.monotonic()
                    row.act(Case(host, board, folder / "link-fault"))
                output = host.communicate(timeout=_STARTS_S)[0]
            time.sleep(experiment.daq.watchdog_s + 0.2)
            trace = _rows_as_trace(folder) if device.is_virtual else _trace(folder)
            (folder / "link-fault").unlink(missing_ok=True)
            restart = _restart(folder) if restarts else ""
        run = _Ended(
            host.returncode,
            output,
            happened_s,
            trace,
            _events_at_end(folder, row, killed=host.returncode == -signal.SIGKILL),
            _rows(folder),
            [] if row.law else device.told((folder / "relay.log").read_bytes()),
            restart,
        )
        return _judged(row, device, phase, experiment, run)


@contextlib.contextmanager
def _rig(folder: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    command, *options = arguments
    logged = [sys.executable, "-m", "faults.logged_rig", str(folder / f"{command}.log"), str(folder / "link-fault")]
    host = subprocess.Popen(
        [*logged, command, str(folder / "fault.yaml"), *options, "--out", str(folder / f"{command}-runs")],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tools"), str(folder)])},
    )
    try:
        yield host
    finally:
        host.kill()
        host.wait()


def _restart(folder: Path) -> str:
    with _rig(folder, "jog", "--u-V", "0.8", "--seconds", "0.2") as host:
        output = host.communicate(timeout=_STARTS_S)[0]
    return "moves" if host.returncode == 0 and " rad" in output else f"refused: {output[-200:]}"


def _of_run(folder: Path, name: str) -> Iterator[Path]:
    """A file of the run that something happens to; not that of the jog after it."""
    return (path for path in folder.glob(f"*-runs/*/{name}") if path.parts[-3] != "jog-runs")


def _events(folder: Path) -> list[dict[str, Any]]:
    files = list(_of_run(folder, "events.jsonl"))
    lines = files[0].read_text(encoding="ascii").split("\n")[:-1] if files else []
    return [json.loads(line) for line in lines]


def _events_at_end(folder: Path, row: RealRow, *, killed: bool) -> list[dict[str, Any]]:
    """The events, once the recorder of a killed host, or the keeper of its law, has written its last.

    Raises RuntimeError.
    """

    def is_last(event: Mapping[str, Any]) -> bool:
        return event.get("by") == "keeper" if row.law else event["kind"] == "loop_died"

    deadline_s = time.monotonic() + _WAIT_S
    while killed and not any(map(is_last, _events(folder))):
        if time.monotonic() > deadline_s:
            raise RuntimeError("nobody says that the loop died")
        time.sleep(0.01)
    return _events(folder)


def _rows(folder: Path) -> list[dict[str, str]]:
    with next(_of_run(folder, "samples.csv")).open(encoding="ascii") as file:
        return list(csv.DictReader(file))


def _await_cycle(folder: Path, host: subprocess.Popen[str]) -> float:
    """Until FIRST_CYCLE is over; its length, s. Raises EndedBefore."""
    deadline_s = time.monotonic() + _STARTS_S
    while True:
        cycles = [event for event in _events(folder) if event["kind"] == "cycle"]
        if len(cycles) >= FIRST_CYCLE:
            return float(cycles[FIRST_CYCLE - 1]["period_s"])
        if host.poll() is not None or time.monotonic() > deadline_s:
            host.kill()
            raise EndedBefore(f"no limit cycle comes: {host.communicate()[0][-1000:]}")
        time.sleep(0.005)


@contextlib.contextmanager
def _going_first() -> Iterator[None]:
    """A priority above the loop's, for the block: a law that spins at that one leaves little to this process."""
    with contextlib.suppress(OSError):  # then the loop has no such priority either
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(70))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _await_mark(mark: Path, host: subprocess.Popen[str]) -> float:
    """When the law began to hang. Raises EndedBefore."""
    deadline_s = time.monotonic() + _STARTS_S
    while not mark.exists():
        if host.poll() is not None or time.monotonic() > deadline_s:
            host.kill()
            raise EndedBefore(f"the law does not hang: {host.communicate()[0][-1000:]}")
        time.sleep(0.001)
    return float(mark.read_text(encoding="ascii"))


def _trace(folder: Path) -> list[tuple[float, float, float]]:
    """Time, drive and position; a last line may be torn."""
    lines = (folder / "trace.csv").read_text(encoding="ascii").split("\n")[:-1]
    return [(float(r["t_s"]), float(r["drive_V"]), float(r["y_rad"])) for r in csv.DictReader(lines)]


def _rows_as_trace(folder: Path) -> list[tuple[float, float, float]]:
    return [(float(row["t_s"]), float(row["u_V"]), float(row["y_rad"])) for row in _rows(folder)]


@dataclass(frozen=True)
class _Ended:
    """What one run has left behind.

    status, output  how the host's process ended, and what it said
    happened_s      when the act began, on the clock of the trace
    trace           of the device: time, drive, position
    events, rows    of the run folder
    told            keys of the samples that the host received
    restart         what became of the next run; "" where there was none
    """

    status: int
    output: str
    happened_s: float
    trace: list[tuple[float, float, float]]
    events: list[dict[str, Any]]
    rows: list[dict[str, str]]
    told: list[int]
    restart: str

    @property
    def killed(self) -> bool:
        return self.status == -signal.SIGKILL

    @property
    def fault(self) -> dict[str, Any] | None:
        return next((event for event in self.events if event["kind"] == "fault"), None)

    @property
    def code(self) -> str:
        return "" if self.fault is None else str(self.fault["code"])


def _judged(row: RealRow, device: RealDevice, phase: float, experiment: Experiment, run: _Ended) -> RealFound:
    times = device.backend.times(experiment, 1.0)
    off_s, late_s = _off_s(row, run), _late_s(run)
    bound_s = row.bound.seconds(times) + late_s
    lost = 0
    if not row.law and not device.is_virtual:  # the reading of a hang is no row, and none before it is lost
        lost = _lost(run.told, device.apart, _keys(device, run.rows), run.fault, killed=run.killed) - device.between
    low, high = experiment.limits.hard_rad
    trouble = []
    if not off_s <= bound_s:
        trouble.append(f"drive on for {1e3 * off_s:.1f} ms, bound {1e3 * bound_s:.1f} ms")
    if run.code not in row.codes.get(device.key, row.codes[""]) or run.status not in row.status:
        trouble.append(f"{run.code or 'no fault'}, exit status {run.status}: {run.output[-300:]}")
    if lost:
        trouble.append(f"{lost} samples lost")
    if run.restart not in ("", "moves"):
        trouble.append(f"the next run: {run.restart}")
    return RealFound(
        row=row.name,
        device=device.key,
        phase=phase,
        off_s=off_s,
        bound_s=bound_s,
        late_s=late_s,
        beyond_rad=max(0.0, *(max(y - high, low - y) for _, _, y in run.trace)),
        code=run.code,
        status=run.status,
        lost=lost,
        skipped=sum(int(b["tick"]) - int(a["tick"]) - 1 for a, b in itertools.pairwise(run.rows)),
        restart=run.restart,
        trouble=tuple(trouble),
    )


def _off_s(row: RealRow, run: _Ended) -> float:
    """For how long the drive stayed on after what happened; of a run that goes on, the longest gap between drives."""
    acted_s = [float(r["t_u_s"]) for r in run.rows if r["t_u_s"]]
    if run.code == "" and run.status >= 0:
        relay = [float(r["t_u_s"]) for r in run.rows if r["t_u_s"] and kind_of(r["stage"]) is StageKind.RELAY]
        return max((b - a for a, b in itertools.pairwise(relay)), default=float("inf"))
    began_s = run.happened_s
    if row.alone:  # the run went on until a fault ended it: since the last drive, which the trace has in its own time
        driven_s = next(float(r["t_u_s"]) for r in run.rows if r["t_u_s"] and float(r["u_V"]) != 0.0)
        began_s = next(t_s for t_s, u_V, _ in run.trace if u_V != 0.0) + acted_s[-1] - driven_s
    last = max((k for k, one in enumerate(run.trace) if one[1] != 0.0), default=0)
    return max(run.trace[last + 1][0] - began_s, 0.0) if last + 1 < len(run.trace) else float("inf")


def _late_s(run: _Ended) -> float:
    """By how much this machine made the run late: the device, and the loop where that does not end with a fault.

    The loop's own lateness is part of what a signal waits for. While the loop is stopped, it is what is measured.
    """
    counted = run.rows if run.code in ("INTERRUPTED", "") else []
    loop_s = max((1e-6 * float(r["late_us"]) for r in counted), default=0.0)
    keeper_s = max((1e-3 * float(event.get("late_ms", 0.0)) for event in run.events), default=0.0)
    exchanges_s = [1e-6 * float(r["io_us"]) for r in run.rows[:-1]]  # what happened may be in the last row
    return max(exchanges_s, default=0.0) - (median(exchanges_s) if exchanges_s else 0.0) + loop_s + keeper_s


def _keys(device: RealDevice, rows: list[dict[str, str]]) -> list[int]:
    """The keys of the rows, as in what the host has received.

    A Modbus driver counts its readings in a pause, too: the longer the pause, the more. Of these there are as many here
    as if the pause had been too short for any.
    """
    keys = [int(row["seq"]) for row in rows]
    first = next((k for k, row in enumerate(rows) if kind_of(row["stage"]) is StageKind.RELAY), 0)
    if "modbus" not in device.backend.traits or first == 0:
        return keys
    in_pause = keys[first] - keys[first - 1] - 1 - device.between
    return keys[:first] + [key - in_pause for key in keys[first:]]


def _lost(told: list[int], apart: int, keys: list[int], fault: Mapping[str, Any] | None, *, killed: bool) -> int:
    """Samples that the host received and the recording lacks.

    keys   of the rows
    apart  least distance between the keys of two samples; what is nearer was asked for again, and answered twice

    The last one of a killed host may have been received and not yet looked at; of a run without a fault it is no row;
    after a time-out it came too late; and the reading of a fault is no row. A host that stood still asks for the last
    one again, since the first answer is old: then both are that one.
    """
    recorded = set(keys)
    # the first reading may have been asked for again, and be another of its answers
    told = told[next((k for k, seq in enumerate(told) if seq > keys[0] - apart), len(told)) :]
    missing = [seq for seq in told if recorded.isdisjoint(range(seq - apart + 1, seq + apart))]
    too_late = fault is not None and fault["code"] in ("LINK_TIMEOUT", "LINK_REPLY")
    may_miss = killed or fault is None or too_late or "counts" in str(fault["detail"])
    return sum(not may_miss or seq <= told[-1] - apart for seq in missing)
