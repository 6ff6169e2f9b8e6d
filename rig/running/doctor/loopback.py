"""`rig doctor --loopback`: a bare board with three wires, judged by what it sees of its own outputs; and the report."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from statistics import median
from typing import NamedTuple

from rig.backends.driver import Transport
from rig.backends.serial import frames
from rig.backends.serial.frames import BOARDS, BRIDGES, Code, Hello, code_name
from rig.backends.serial.loopback import REPEATS, WATCHDOG_MS, Measured, Share, Trip, measure
from rig.core.package import VERSION
from rig.core.signals import percent
from rig.core.strict_json import JsonObject
from rig.run_folder.live.stop_flag import StopFlag
from rig.running.doctor.finding import Finding, bad, good, note, poor

EMULATED_PORTS = ("emulated-chip", "emulated-pico")
DRAWING = """loop-back: a bare board on its USB cable and three wires. No bridge, no motor, nothing else.

                     Uno, Nano           Raspberry Pi Pico (pin of the board)
  PWM or IN1         D9  o-----o A3      GP16 (21) o-----o GP18 (24)
  direction or IN2   D8* o-----o A4      GP17 (22) o-----o GP19 (25)
  e-stop             D4  o-----o A5      GP14 (19) o-----o GP15 (20)

  * D10 instead of D8 if the firmware was flashed with --bridge in1-in2"""

_SHARE_TOLERANCE = 0.02  # of the time; the board looks some thousand times
_PULSES_HZ = 20_000.0
_PULSES_TOLERANCE = 0.01
_CLOCK_PPM = {"uno": 6000.0, "pico": 200.0}  # a ceramic resonator, a crystal
_BAD_CLOCK_PPM = 20_000.0
_WATCHDOG_SLACK_S = 2e-3  # a tick late, and the phase of the request in its tick
_ESTOP_S = 0.2e-3  # its interrupt, and the clock's steps
_RESET_S = 0.5  # of a hung main loop, without a boot loader
_BOOT_S = 3.0


class Wire(NamedTuple):
    """From an output of the bridge to the input that looks at it."""

    output: str
    end: str

    def __str__(self) -> str:
        return f"{self.output} - {self.end}"


class Wires(NamedTuple):
    """The three wires of a board."""

    first: Wire
    second: Wire
    estop: Wire


def wires_of(hello: Hello) -> Wires:
    """Of the board that answered."""
    if BOARDS.get(hello.board) == "pico":
        return Wires(Wire("GP16", "GP18"), Wire("GP17", "GP19"), Wire("GP14", "GP15"))
    second = "D10" if BRIDGES.get(hello.bridge) == "in1-in2" else "D8"
    return Wires(Wire("D9", "A3"), Wire(second, "A4"), Wire("D4", "A5"))


def expected(bridge: str, drive: float) -> tuple[float, float]:
    """For what share of the time both outputs are high at a drive, a share of full duty with its sign."""
    if bridge == "in1-in2":  # both high: a short of the motor; one goes low for its share
        return (1.0 - max(-drive, 0.0), 1.0 - max(drive, 0.0))
    return abs(drive), 1.0 if drive < 0.0 else 0.0


# ---------------------------------------------------------------------- judging


def judge(found: Measured) -> Iterator[Finding]:
    """Each promise of the board as it was measured. Where something is wrong: what, where, and what to do."""
    hello = found.hello
    wires = wires_of(hello)
    yield _who(hello)
    yield _opening(found)
    if found.round_trip_s:
        yield _round_trips(found.round_trip_s)
    if found.clock_ppm is not None:
        yield _clock(found.clock_ppm, BOARDS.get(hello.board, ""))
    if not found.wired:
        yield bad(
            "wires",
            f"the e-stop's input does not follow the board's own pin: the wire {wires.estop} is missing, or a contact "
            "is wired there. So the board refuses, and nothing has been driven",
            "take the board off its bench, and put in the three wires that are drawn above",
        )
        return
    yield good("wires", f"{wires.estop}: the e-stop's input follows the board's own pin")
    yield from _pulses(found, wires)
    if found.other_session is not None:
        yield _session(found.other_session)
    yield from _stops(found)


def _who(hello: Hello) -> Finding:
    board = BOARDS.get(hello.board, f"number {hello.board}")
    bridge = BRIDGES.get(hello.bridge, "none")
    words = f"{board}, build {hello.build_text}, bridge {bridge}, last reset: {hello.reset_words}"
    if hello.build_text != f"{board} {VERSION}":
        return note("board", f"{words}; this rig is {VERSION}", "flash it with this rig before you send a report")
    return good("board", words)


def _opening(found: Measured) -> Finding:
    if found.opening_reset:
        return note("opening", "the board had just started: opening its port restarts it, as an Uno's does")
    return note("opening", "opening the port did not restart the board")


def _round_trips(took_s: Sequence[float]) -> Finding:
    longest_s = max(took_s)
    words = f"{1e3 * median(took_s):.2f} / {1e3 * longest_s:.2f} ms (median / largest of {len(took_s)})"
    if longest_s > 0.5e-3 * WATCHDOG_MS:
        return poor("round trip", words, "close other programs; `rig doctor CONFIG` looks for the cause")
    return good("round trip", words)


def _clock(ppm: float, board: str) -> Finding:
    words = f"{ppm:+.0f} ppm against this machine's"
    if abs(ppm) > _BAD_CLOCK_PPM:
        return bad("clock", words, "this is no 16 MHz (Uno) or 12 MHz (Pico) board: no time of it is true")
    if abs(ppm) > _CLOCK_PPM.get(board, _BAD_CLOCK_PPM):
        return poor(
            "clock", f"{words}: more than such boards have", "rig measures it at each start and makes up for it"
        )
    return good("clock", words)


# ---------------------------------------------------------------------- drive


def _pulses(found: Measured, wires: Wires) -> Iterator[Finding]:
    bridge = BRIDGES.get(found.hello.bridge, "pwm-dir")
    for end, wire in enumerate((wires.first, wires.second)):
        yield _output(found.shares, bridge, end, wire)
    if found.pulses_Hz is not None and any(_is_pulsing(share, end) for share in found.shares for end in (0, 1)):
        words = f"{found.pulses_Hz:.0f} pulses a second, by the board's clock"
        off = abs(found.pulses_Hz / _PULSES_HZ - 1.0) > _PULSES_TOLERANCE
        yield Finding("period", "bad" if off else "good", words, f"it should be {_PULSES_HZ:.0f}" if off else "")
    if found.ticks is not None:
        counted, due = found.ticks
        words = f"{counted} control ticks in {due} ms"
        if abs(counted - due) > 1:
            yield bad("ticks", f"{words}: some were left out", "the firmware does not keep up: send the report")
        else:
            yield good("ticks", words)


def _is_pulsing(share: Share, end: int) -> bool:
    return 0.05 < share.ends[end] < 0.95


def _fits(seen: float, wanted: float) -> bool:
    return abs(seen - wanted) <= _SHARE_TOLERANCE


def _output(shares: Sequence[Share], bridge: str, end: int, wire: Wire) -> Finding:
    """One output of the bridge at each drive. A wrong output is told from a missing wire."""
    wanted = [expected(bridge, share.drive) for share in shares]
    topic = f"drive {wire.output}"
    rows = list(zip(shares, wanted, strict=True))
    told = ", ".join(f"{100.0 * share.ends[end]:.1f} % at {100.0 * share.drive:+.0f} %" for share in shares)
    if all(_fits(share.ends[end], want[end]) for share, want in rows):
        return good(topic, f"high for {told} of full duty")
    if all(_fits(share.outputs[end], want[end]) for share, want in rows):
        if all(_fits(share.ends[end], want[1 - end]) for share, want in rows):
            words = f"{wire.end} sees the other output: the wires are swapped"
        elif all(share.ends[end] > 1.0 - _SHARE_TOLERANCE for share in shares):
            words = f"{wire.output} itself is right, but {wire.end} is high all the time: the wire {wire} is missing"
        else:
            words = f"{wire.output} itself is right, but {wire.end} sees something else: {told}"
        return bad(topic, words, f"put a wire from {wire.output} to {wire.end}")
    seen = [share.outputs[end] for share in shares]
    pairs = zip(seen, shares, strict=True)
    told = ", ".join(f"{100.0 * high:.1f} % at {100.0 * share.drive:+.0f} %" for high, share in pairs)
    right = ", ".join(percent(want[end]) for want in wanted)
    driven = [(high, want[end]) for high, want in zip(seen, wanted, strict=True) if 0.0 < want[end] < 1.0]
    if driven and all(_fits(high, 1.0 - want) for high, want in driven):
        words = f"the PWM is inverted: high for {told}; right is {right}"
    elif driven and all(_fits(high, seen[0]) for high, _ in driven):
        words = f"there are no pulses: high for {told}; right is {right}"
    else:
        words = f"the PWM is wrong: high for {told}; right is {right}"
    return bad(topic, words, "never connect this board to a bridge; flash it anew, and send the report")


# ---------------------------------------------------------------------- sessions, silence, e-stop, reset


def _session(code: int) -> Finding:
    if code == Code.SESSION:
        return good("session", "it arms for its own session alone")
    said = "armed" if code == Code.NONE else f"said {code_name(code)}"
    return bad("session", f"asked to arm for another session, it {said}", "flash it anew, and send the report")


def _stops(found: Measured) -> Iterator[Finding]:
    if not found.watchdog:
        yield bad(
            "watchdog",
            "not measured, nor e-stop and reset: no pulses come through a wire, so nobody would see them end",
            "first put right what is said of the drive above",
        )
        return
    wanted_s = 1e-3 * WATCHDOG_MS
    least_s = wanted_s - _WATCHDOG_SLACK_S
    yield _ended(
        "watchdog",
        found.watchdog,
        (least_s, wanted_s + _WATCHDOG_SLACK_S),
        Code.WATCHDOG,
        f"after the host fell silent; asked for {WATCHDOG_MS} ms",
    )
    estop = _ended("e-stop", found.estop, (-math.inf, _ESTOP_S), Code.E_STOP, "after its contact opened")
    if estop.state == "good" and found.estop_refused != Code.E_STOP:
        estop = bad("e-stop", "with the e-stop open it arms", "flash it anew, and send the report")
    yield estop
    if found.restart is not None:
        yield _restarted(found)


def _ended(topic: str, trips: Sequence[Trip], within_s: tuple[float, float], code: Code, words: str) -> Finding:
    """Whether each drive ended in time, by what came through the wire, and the board says why."""
    cure = "never connect this board to a motor; flash it anew, and send the report"
    if any(trip.after_s is None for trip in trips):
        number = sum(trip.after_s is None for trip in trips)
        return bad(topic, f"does not trip: in {number} of {len(trips)} tries the drive went on {words}", cure)
    times_s = [max(trip.after_s or 0.0, 0.0) for trip in trips]
    told = f"the last pulse came {1e3 * min(times_s):.2f} to {1e3 * max(times_s):.2f} ms {words}"
    if not within_s[0] <= min(times_s) or max(times_s) > within_s[1]:
        return bad(topic, told, cure)
    wrong = {trip.fault for trip in trips} - {int(code)}
    if wrong:
        return bad(topic, f"{told}; but the board says {', '.join(map(code_name, sorted(wrong)))}", cure)
    return good(topic, f"{told}, {len(trips)} times")


def _restarted(found: Measured) -> Finding:
    restart = found.restart
    assert restart is not None
    after_s = restart.after_s
    if after_s is None:
        return bad(
            "reset",
            "its main loop hung, as asked, and the board never came back: the hardware watchdog does not reset it",
            "press its reset. An old Nano's boot loader can do this: burn a newer one",
        )
    words = f"its main loop hung, as asked, and it was back after {after_s:.2f} s"
    if restart.causes:
        words += f" (reset: {restart.causes})"
    if not restart.forgot or restart.refused == Code.NONE:
        return bad("reset", f"{words}, but it still knows the session from before", "send the report")
    words += ", not armed, its session forgotten"
    slow = after_s > (_BOOT_S if found.opening_reset else _RESET_S)
    return Finding("reset", "poor" if slow else "good", words, "a quicker boot loader helps" if slow else "")


# ---------------------------------------------------------------------- the board and the report


@contextmanager
def bare_board(port: str, baud: int) -> Iterator[Transport]:
    """The board at a port of this machine; or an emulated one with all three wires, in virtual time.

    Raises Fault LINK_OPEN; EmulationError where it cannot be built.
    """
    if port in EMULATED_PORTS:
        from rig.backends.serial.emulated.firmware_build import Variant, require_emulator

        require_emulator(port)
        from emulated_chips.opening import bare_chip

        board: Transport = bare_chip(port, Variant(baud=baud))
    else:
        from rig.backends.links.serial_port import SerialPort

        board = SerialPort(port, baud)
    try:
        yield board
    finally:
        board.close()


class Visit(NamedTuple):
    """What was found on a bare board, and what was measured for it."""

    measured: Measured
    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing is bad."""
        return all(finding.state != "bad" for finding in self.findings)


def visit_board(transport: Transport, repeats: int = REPEATS, flag: StopFlag | None = None) -> Visit:
    """Measure and judge the board behind a transport. ``repeats``, and what it raises, as of ``measure``.

    flag  of who drives the board's pins; None: nobody else can stop it
    Raises Fault INTERRUPTED, too.
    """
    if flag is None:
        found = measure(transport, repeats)
    else:
        flag.tell_drive(is_on=True)
        found = measure(_Stoppable(transport, flag), repeats)
        flag.tell_drive(is_on=False)
    return Visit(found, tuple(judge(found)))


class _Stoppable:
    """A transport on which a Stop ends what is measured, with the next request; what ends the drive goes through."""

    def __init__(self, transport: Transport, flag: StopFlag) -> None:
        self._transport, self._flag = transport, flag
        self._is_told = False
        self.read, self.now_s, self.close = transport.read, transport.now_s, transport.close

    def write(self, data: bytes) -> None:
        """Send it. Raises Fault INTERRUPTED once, if a Stop was asked for."""
        if not self._is_told and self._flag.asked_by():
            self._is_told = True
            self._flag.check()
        self._transport.write(data)


def write_report(visit: Visit, port: str, folder: Path, now: datetime) -> Path:
    """Write ``report.json`` and ``report.txt`` into a new folder of ``folder``; its path.

    They can be sent in as they are: they name the board, the machine's kind and the numbers, and nobody.
    """
    hello = visit.measured.hello
    board = BOARDS.get(hello.board, f"board-{hello.board}")
    made = folder / f"{now:%Y%m%d-%H%M%S}-loopback-{board}"
    made.mkdir(parents=True)
    (made / "report.json").write_text(json.dumps(as_dict(visit, port, now), indent=1) + "\n", encoding="utf-8")
    lines = [DRAWING, "", f"rig {VERSION}, {now:%Y-%m-%d %H:%M}, {_machine()}, {_behind(port)}", ""]
    lines += [line for finding in visit.findings for line in finding.lines()]
    (made / "report.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return made


def as_dict(visit: Visit, port: str, now: datetime) -> JsonObject:
    """The report as JSON; times in s. ``emulated``: no chip was there."""
    measured = visit.measured
    hello = measured.hello
    numbers = asdict(measured)
    del numbers["hello"]
    round_trip_s = numbers.pop("round_trip_s")
    numbers["shares"] = [share._asdict() for share in measured.shares]
    numbers["watchdog"] = [trip._asdict() for trip in measured.watchdog]
    numbers["estop"] = [trip._asdict() for trip in measured.estop]
    numbers["restart"] = None if measured.restart is None else measured.restart._asdict()
    if round_trip_s:
        numbers["round_trip_s"] = {"median": median(round_trip_s), "largest": max(round_trip_s)}
    return {
        "rig": VERSION,
        "made": now.isoformat(timespec="seconds"),
        "machine": _machine(),
        "port": _behind(port),
        "emulated": port in EMULATED_PORTS,
        "board": {
            "name": BOARDS.get(hello.board, str(hello.board)),
            "build": hello.build_text,
            "bridge": BRIDGES.get(hello.bridge, "none"),
            "encoder": bool(hello.features & frames.FEATURE_ENCODER),
            "reset": hello.reset_words,
        },
        "ok": visit.ok,
        "findings": [{**finding.as_dict()} for finding in visit.findings],
        "measured": numbers,
    }


def _machine() -> str:
    return f"{platform.system()} {platform.release()}, {platform.machine()}"


def _behind(port: str) -> str:
    """The port and what is behind it on USB."""
    if port in EMULATED_PORTS:
        return f"{port}, in virtual time: no chip was there"
    from rig.backends.links.usb_port import usb_port

    return usb_port(port).words
