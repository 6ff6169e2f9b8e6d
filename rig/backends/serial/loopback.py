"""A bare board that looks at its own outputs through three wires: what it does about drive, silence, e-stop and reset.

All times of the board are of its own clock, and what is compared is what came through the wires. Nothing here judges.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from rig.backends.driver import Transport
from rig.backends.serial import frames
from rig.backends.serial.device_clock import TimedExchange, fit_device_clock
from rig.backends.serial.exchange import ATTEMPTS, Exchange
from rig.backends.serial.frames import Code, DeviceState, Hello, Kind, Loopback, LoopbackAct, Setup
from rig.core.faults import Fault

PART = 2  # of full duty, that a board gives at most in loop-back
WATCHDOG_MS = 100
REPEATS = 5
_SHARES = (0.25, -0.25, 0.5, -0.5)  # of full duty
_LOOKS = 25  # at each share
_CLOCK_EXCHANGES = 120
_COUNT_S = 0.2  # over which edges and ticks are counted
_AFTER_S = 0.1  # beyond the watchdog time, until the wires are looked at
_RESTART_S = 8.0  # with a boot loader
_PAUSE_S = 0.02
_TIMEOUT_S, _OPEN_S = 0.1, 5.0
_HALF = 1 << 31
_RESET_BEFORE_S = 0.25


class Share(NamedTuple):
    """For what share of the time both ends, and both outputs, are high at a drive.

    drive   share of full duty, with its sign; 0: at rest
    ends, outputs  of PWM or IN1, and of direction or IN2; 0 to 1
    """

    drive: float
    ends: tuple[float, float]
    outputs: tuple[float, float]


class Trip(NamedTuple):
    """How a drive ended.

    after_s  from what ended it to the last edge at the wire's end; None: the edges went on, or there were none
    fault    code that the board tells
    """

    after_s: float | None
    fault: int


class Restart(NamedTuple):
    """What the board's main loop hanging up led to.

    after_s      from the request to the restart; None: the board never answered again
    causes       of the reset, in words
    forgot       neither armed nor driving, and the session is gone
    refused      code with which it refuses to arm for the old session, once its reset is acknowledged
    """

    after_s: float | None
    causes: str = ""
    forgot: bool = False
    refused: int = 0


@dataclass
class Measured:
    """What a loop-back has measured; parts that were not reached are empty.

    opening_reset  opening the port restarted the board
    round_trip_s   of each HELLO, s
    clock_ppm      how much faster the board's clock runs than this machine's
    wired          the e-stop's input follows the board's own pin: without it there is nothing else
    shares         at rest, and at each drive
    pulses_Hz      by the board's clock; nan where no edge came
    ticks          (counted, due) in a stretch of the board's time
    other_session  code with which it refuses to arm for a session that is not its own
    watchdog       how each drive ended after the host fell silent
    estop          how each drive ended after the e-stop opened; estop_refused: code with which it refused to arm then
    restart        after the main loop hung up; None: not tried
    """

    hello: Hello
    opening_reset: bool
    round_trip_s: list[float] = field(default_factory=list)
    clock_ppm: float | None = None
    wired: bool = False
    shares: list[Share] = field(default_factory=list)
    pulses_Hz: float | None = None
    ticks: tuple[int, int] | None = None
    other_session: int | None = None
    watchdog: list[Trip] = field(default_factory=list)
    estop: list[Trip] = field(default_factory=list)
    estop_refused: int | None = None
    restart: Restart | None = None


def measure(transport: Transport, repeats: int = REPEATS) -> Measured:
    """Ask a board who it is, and let it look at its own outputs. The transport is left open, the board disarmed.

    repeats  of each silence and each opening of the e-stop, at least 1
    Raises Fault LINK_HELLO, LINK_LOST, LINK_TIMEOUT or LINK_VERSION; LINK_REJECTED where its firmware has no loop-back.
    """
    return _Board(transport, repeats).measure()


class _Board:
    """A board, and the exchanges with it."""

    def __init__(self, transport: Transport, repeats: int) -> None:
        self._transport = transport
        self._exchange = Exchange(transport, _TIMEOUT_S)
        self._repeats = repeats
        self._session = 1 + int(1e3 * time.time()) % 0x7FFFFFFE
        self._opened_s = transport.now_s()
        self._full = 0
        self._setup: Setup | None = None

    def measure(self) -> Measured:
        """As the function."""
        hello = self._exchange.meet(_OPEN_S)
        since_s = self._transport.now_s() - self._opened_s + _RESET_BEFORE_S
        found = Measured(hello, 1e-6 * hello.now_us < since_s)
        if not hello.features & frames.FEATURE_LOOPBACK:
            raise Fault("LINK_REJECTED", f"build {hello.build_text} has no loop-back: flash the board with this rig")
        self._full = hello.drive_full
        self._time(found)
        if self._loopback(LoopbackAct.BEGIN) is None:
            return found
        found.wired = True
        try:
            self._prepare(hello)
            found.other_session = self._exchange.arm(self._session ^ 1)
            self._drive_all(found)
            moving = _moving(found.shares)
            if moving is not None:
                sign, end = moving
                found.watchdog = [self._fall_silent(sign, end) for _ in range(self._repeats)]
                self._stop(found, sign, end)
                if all(trip.after_s is not None for trip in (*found.watchdog, *found.estop)):
                    found.restart = self._hang(sign)
        finally:
            with contextlib.suppress(Fault):
                self._end()
        return found

    # ------------------------------------------------------------------ who it is, and how fast

    def _time(self, found: Measured) -> None:
        exchanges: list[TimedExchange] = []
        for number in range(_CLOCK_EXCHANGES):
            sent_s = self._transport.now_s()
            reply = self._exchange.hello()
            exchanges.append(TimedExchange(sent_s, self._transport.now_s(), reply.now_us))
            self._wait(1e-3 * (1 + number % 7))  # else each meets a USB adapter's timer at the same phase
        found.round_trip_s = [e.received_s - e.sent_s for e in exchanges]
        found.clock_ppm = 1e6 * (fit_device_clock(exchanges).ratio - 1.0)

    # ------------------------------------------------------------------ requests

    def _wait(self, for_s: float) -> None:
        """Silent. What comes meanwhile is of no use."""
        until_s = self._transport.now_s() + for_s
        while (left_s := until_s - self._transport.now_s()) > 0.0:
            self._exchange.ignore(left_s)

    def _loopback(self, act: LoopbackAct) -> Loopback | None:
        """What the board sees; None where it refuses for want of wires."""
        only_looks = act in (LoopbackAct.LOOK, LoopbackAct.SHARE)
        packet = None
        for _ in range(ATTEMPTS if only_looks else 1):  # a second opening would tell another time
            packet = self._exchange.answer(self._exchange.send(Kind.LOOPBACK, bytes((act,))), Kind.LOOPBACK_REPLY)
            if packet is not None:
                break
        if packet is None:
            raise self._exchange.silence(Kind.LOOPBACK)
        if packet.kind == Kind.NACK:
            if frames.Nack.unpack(packet.body).code == Code.LOOPBACK:
                return None
            raise Fault("LINK_REJECTED", f"loop-back refused, {frames.code_name(packet.body[0])}")
        return Loopback.unpack(packet.body)

    def _look(self, act: LoopbackAct = LoopbackAct.LOOK) -> Loopback:
        seen = self._loopback(act)
        if seen is None:
            raise Fault("DEVICE_RESET", "the board is no longer in loop-back")
        return seen

    def _clear(self) -> None:
        """Acknowledge whatever is latched, as far as it lets itself be."""
        for _ in range(16):
            state = self._exchange.state()
            if not state.status & frames.STATUS_FAULT or not self._exchange.is_cleared(state.fault):
                return

    def _prepare(self, hello: Hello) -> None:
        """Set it up for half of full duty; its position is the centre, whatever its sensor says."""
        self._clear()
        is_encoder = bool(hello.features & frames.FEATURE_ENCODER)
        if is_encoder:
            self._exchange.request(Kind.ZERO, frames.pack_zero(0), Kind.ZERO_REPLY)
        rails = (0, 0) if is_encoder else (0, hello.counts_max)
        centre = 0 if is_encoder else hello.counts_max // 2
        self._setup = Setup(
            session=self._session,
            hard_lo=centre - 100,
            hard_hi=centre + 100,
            rail_lo=rails[0],
            rail_hi=rails[1],
            centre=centre,
            max_drive=hello.drive_full // PART,
            watchdog_ms=WATCHDOG_MS,
            polarity=1,
        )
        self._exchange.request(Kind.SETUP, self._setup.pack(), Kind.SETUP_REPLY)

    def _start(self, drive: float) -> DeviceState:
        """Arm and drive; the state that tells when the drive began."""
        self._clear()
        code = self._exchange.arm(self._session)
        if code != Code.NONE:
            raise Fault("LINK_REJECTED", f"arming refused, {frames.code_name(code)}")
        self._drive(drive)
        return self._exchange.state()

    def _drive(self, drive: float) -> None:
        self._exchange.send(Kind.DRIVE, frames.pack_drive(round(drive * self._full)))

    def _end(self) -> None:
        self._exchange.request(Kind.STOP, b"", Kind.STOP_REPLY)
        self._loopback(LoopbackAct.CLOSE)
        self._loopback(LoopbackAct.END)

    # ------------------------------------------------------------------ measurements

    def _drive_all(self, found: Measured) -> None:
        found.shares.append(_share(0.0, [self._look(LoopbackAct.SHARE)]))
        for drive in _SHARES:
            self._start(drive)
            found.shares.append(_share(drive, [self._driven_look(drive, number) for number in range(_LOOKS)]))
            if drive == max(_SHARES) or drive == min(_SHARES):
                self._count(found, drive)
            self._exchange.request(Kind.STOP, b"", Kind.STOP_REPLY)

    def _driven_look(self, drive: float, number: int) -> Loopback:
        self._drive(drive)
        self._wait(1e-5 * (number % 7))  # at all phases of a pulse
        return self._look(LoopbackAct.SHARE)

    def _count(self, found: Measured, drive: float) -> None:
        """Edges and ticks, over a stretch of the board's time."""
        first = last = self._look()
        until_s = self._transport.now_s() + _COUNT_S
        while self._transport.now_s() < until_s:
            self._drive(drive)
            self._wait(_PAUSE_S)
            last = self._look()
        span_us = (last.now_us - first.now_us) % 2**32
        rises = max((b.rises - a.rises) % 2**16 for a, b in zip(first.ends, last.ends, strict=True))
        found.pulses_Hz = max(1e6 * rises / span_us, found.pulses_Hz or 0.0)
        found.ticks = (last.ticks - first.ticks, round(span_us / 1000))

    def _after(self, began_us: int, end: int) -> float | None:
        """From then until the last edge at that wire's end, s; None while edges go on."""
        seen = self._look()
        self._wait(_PAUSE_S)
        again = self._look()
        if again.ends[end] != seen.ends[end]:
            return None
        return 1e-6 * ((seen.ends[end].last_us - began_us + _HALF) % 2**32 - _HALF)

    def _fall_silent(self, sign: int, end: int) -> Trip:
        began = self._start(sign * 0.5)
        self._wait(1e-3 * WATCHDOG_MS + _AFTER_S)
        after_s = self._after(began.t_drive_us, end) if began.drive else None
        return self._tell(after_s)

    def _tell(self, after_s: float | None) -> Trip:
        state = self._exchange.state(Kind.STOP, Kind.STOP_REPLY)
        return Trip(after_s, state.fault if state.status & frames.STATUS_FAULT else 0)

    def _stop(self, found: Measured, sign: int, end: int) -> None:
        for _ in range(self._repeats):
            self._start(sign * 0.5)
            opened = self._look(LoopbackAct.OPEN)
            trip = self._tell(self._after(opened.estop_us, end))
            self._clear()  # refused: the e-stop is open
            found.estop.append(trip)
            found.estop_refused = self._exchange.arm(self._session)
            self._look(LoopbackAct.CLOSE)

    def _hang(self, sign: int) -> Restart:
        self._start(sign * 0.5)
        asked_s = self._transport.now_s()
        self._look(LoopbackAct.HANG)
        self._wait(0.3)
        try:
            self._exchange.meet(_RESTART_S)
            hello = self._exchange.hello()
        except Fault as fault:
            if fault.code != "LINK_HELLO":
                raise
            return Restart(None)
        restarted_s = self._transport.now_s() - 1e-6 * hello.now_us
        state = self._exchange.state()
        forgot = state.session == 0 and state.drive == 0 and not state.status & frames.STATUS_ARMED
        self._clear()
        causes = hello.reset_words if hello.reset_cause else ""
        return Restart(restarted_s - asked_s, causes, forgot, self._exchange.arm(self._session))


def _share(drive: float, seen: list[Loopback]) -> Share:
    def mean(of: Callable[[frames.LoopbackEnd], int], end: int) -> float:
        return sum(of(one.ends[end]) / max(one.looks, 1) for one in seen) / len(seen)

    wires = (mean(lambda e: e.wire_highs, 0), mean(lambda e: e.wire_highs, 1))
    return Share(drive, wires, (mean(lambda e: e.pin_highs, 0), mean(lambda e: e.pin_highs, 1)))


def _moving(shares: list[Share]) -> tuple[int, int] | None:
    """Sign of a drive whose pulses come through a wire, and which wire; None: none comes."""
    for share in shares:
        for end, high in enumerate(share.ends):
            if share.drive and 0.05 < high < 0.95:
                return (1 if share.drive > 0 else -1), end
    return None
