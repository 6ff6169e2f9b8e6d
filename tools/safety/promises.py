"""Every promise that the firmware takes the drive off, at random phases: how soon, and how far the shaft still goes."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import NamedTuple

from emulated_chips.virtual_chip import Hang, VirtualChip
from emulated_chips.virtual_pico import PicoHang
from rig.backends.serial.frames import Kind, encode
from rig.model.motor import State
from safety.driven_chip import (
    COUNTS_PER_TURN,
    PERIOD_S,
    PICO,
    PICO_ENCODER,
    TICK_S,
    UNO,
    UNO_ENCODER,
    WATCHDOG_S,
    DrivenChip,
    Stand,
    Voice,
    Way,
)

HANG_S = 0.150
_REST_S = 0.6  # from 10 rad/s; the host goes on meanwhile, to no avail
_GIVE_UP_S = 1.0
_BEGIN = 1  # of LOOPBACK
_LOOK_S = 50e-6  # longer than an interrupt may wait
_BEYOND_RAD = 6 * abs(UNO.bench.rad_per_count)  # eight times the noise

Event = Callable[[DrivenChip, random.Random], float]


class Promise(NamedTuple):
    """One row of the table.

    what     happens
    event    makes it happen, now or shortly; returns when
    bound_s  within which the drive must be off
    way      how the chip is driven
    voice    what the host does after it
    run_up_s  the shaft reaches the limit so long after the start; None: it starts far inside
    """

    what: str
    event: Event
    bound_s: float
    way: Way = Way()
    voice: Voice = "drives"
    run_up_s: tuple[float, float] | None = None


class Measured(NamedTuple):
    """Over all phases.

    off_s       longest time from the event until the pins were at 0
    coast_rad   farthest that the shaft went on from there
    travel_rad  farthest from the event until it stood
    late        phases in which the drive was on beyond the bound, or came back
    """

    promise: Promise
    phases: int
    off_s: float
    coast_rad: float
    travel_rad: float
    late: int


# ---------------------------------------------------------------------- what may happen


def _last_frame(driven: DrivenChip, rng: random.Random) -> float:
    """The host's last word that counts."""
    if driven.way.full:
        driven.chip.place(driven.truth().y_rad, driven.speed_rad_s)
    driven.keep_alive()
    return driven.heard_s


def _silence(driven: DrivenChip, rng: random.Random) -> float:
    """The host says no more; sometimes it dies within a frame."""
    heard_s = _last_frame(driven, rng)
    if rng.random() < 0.5:
        frame = encode(Kind.DRIVE, 1, b"\1\1")
        driven.write(frame[: rng.randrange(1, len(frame))])
    return heard_s


def _loopback(driven: DrivenChip, rng: random.Random) -> float:
    """The last word that counts, and then a request that takes a bare board for its subject."""
    heard_s = _last_frame(driven, rng)
    driven.send(Kind.LOOPBACK, bytes((_BEGIN,)))
    return heard_s


def _hang(what: Hang | PicoHang) -> Event:
    def event(driven: DrivenChip, rng: random.Random) -> float:
        if isinstance(driven.chip, VirtualChip):
            assert what != "counter"  # the Uno's is an interrupt
            driven.chip.hang(what)
        else:
            assert what != "clock"  # the Pico's is its tick's
            driven.chip.hang(what)
        return driven.chip.now_s()

    return event


def _beyond(driven: DrivenChip, rng: random.Random) -> float:
    """A hand puts the shaft beyond the limit."""
    beyond_rad = driven.stand.limit_rad(driven.direction) + driven.direction * _BEYOND_RAD
    driven.chip.place(beyond_rad, driven.speed_rad_s)
    return driven.chip.now_s()


def _crossing(driven: DrivenChip, rng: random.Random) -> float:
    """The shaft runs over the limit by itself."""
    truth = driven.truth()
    return truth.t_s + (driven.stand.limit_rad(driven.direction) - truth.y_rad) / driven.speed_rad_s


def _broken_wire(driven: DrivenChip, rng: random.Random) -> float:
    driven.chip.rewire(sensor=rng.choice(("broken_low", "broken_high")))
    return driven.chip.now_s()


def _lost_edge(driven: DrivenChip, rng: random.Random) -> float:
    """Both channels of the encoder change at once, and no third edge: those three look like one the other way."""
    while _to_edge_s(driven) < _LOOK_S:
        driven.go_on(driven.chip.now_s() + _LOOK_S)
    driven.chip.rewire(sensor="jumped")
    return driven.chip.now_s()


def _to_edge_s(driven: DrivenChip) -> float:
    """From the nearest edge of the encoder, s."""
    truth = driven.truth()
    steps = truth.y_rad * COUNTS_PER_TURN / math.tau + 0.5
    away = abs(steps - round(steps)) * math.tau / COUNTS_PER_TURN
    return away / max(abs(truth.v_rad_per_s), 1e-3)


def _still_channel(driven: DrivenChip, rng: random.Random) -> float:
    driven.chip.rewire(sensor="still")
    return driven.chip.now_s()


def _e_stop(driven: DrivenChip, rng: random.Random) -> float:
    driven.chip.contact("e_stop", is_open=True)
    return driven.chip.now_s()


def _end_switch(driven: DrivenChip, rng: random.Random) -> float:
    driven.chip.contact("end_high" if driven.direction > 0 else "end_low", is_open=True)
    return driven.chip.now_s()


def _reset(driven: DrivenChip, rng: random.Random) -> float:
    driven.chip.reset(rng.choice((1, 2, 4)), rng.choice((0.0, 0.05)))
    return driven.chip.now_s()


HOST, DEVICE, STROKES = Way(), Way("device"), Way("strokes")
FAST = Way(baud=1_000_000)
FAST_DEVICE = Way("device", baud=1_000_000)
FLOOD = Way(baud=1_000_000, floods=True)
OTHER_BRIDGE = Way(bridge="IN1_IN2")
IN_TURN = (HOST, DEVICE, STROKES)
_STILL_COUNTS = 66  # of travel: 33 edges of the channel that still changes
STILL_S = _STILL_COUNTS * math.tau / COUNTS_PER_TURN / min(abs(UNO.steady(way)[1]) for way in (1, -1)) + 2 * TICK_S
SILENT_S = WATCHDOG_S + TICK_S
RUN_UP_S = (0.005, 0.025)

OF_POTENTIOMETER = (
    *(
        Promise("host silent", _silence, SILENT_S, way, "none")
        for way in (HOST, DEVICE, STROKES, FAST, FAST_DEVICE, OTHER_BRIDGE)
    ),
    *(Promise("host silent, at full drive", _silence, SILENT_S, way._replace(full=True), "none") for way in IN_TURN),
    *(Promise("host reads on, but drives no more", _last_frame, SILENT_S, way, "reads") for way in IN_TURN),
    *(
        Promise("nothing but garbage from the host", _last_frame, SILENT_S, way, "garbage")
        for way in (FLOOD, FLOOD._replace(where="device"), FLOOD._replace(where="strokes"))
    ),
    *(
        Promise(f"hang: {what}", _hang(what), HANG_S, way)
        for what in ("main loop", "everything", "clock", "tick", "converter")
        for way in IN_TURN
    ),
    *(Promise("put beyond a hard limit", _beyond, 2 * TICK_S, way) for way in (*IN_TURN, FLOOD)),
    *(
        Promise("runs over a hard limit, sensor without noise", _crossing, 2 * TICK_S, way, run_up_s=RUN_UP_S)
        for way in (HOST._replace(noisy=False), DEVICE._replace(noisy=False), FLOOD._replace(noisy=False))
    ),
    Promise("runs over a hard limit, noise may hide a reading", _crossing, 3 * TICK_S, HOST, run_up_s=RUN_UP_S),
    *(Promise("wiper wire broken", _broken_wire, 2 * TICK_S, way) for way in (*IN_TURN, FLOOD)),
    *(Promise("e-stop opens", _e_stop, TICK_S, way) for way in (*IN_TURN, FLOOD, OTHER_BRIDGE)),
    *(Promise("end switch opens", _end_switch, 2 * TICK_S, way._replace(end_switches=True)) for way in IN_TURN),
    *(Promise("reset: power-on, external, brown-out", _reset, TICK_S, way) for way in (*IN_TURN, OTHER_BRIDGE)),
    Promise("asked for a loop-back, then silent", _loopback, SILENT_S, HOST, "none"),
)

# Where what drives makes no difference to the encoder, the host drives.
OF_ENCODER = (
    *(
        Promise("runs over a hard limit, counted by an encoder", _crossing, 2 * TICK_S, way, run_up_s=RUN_UP_S)
        for way in (HOST, DEVICE, FLOOD)
    ),
    *(Promise("encoder: both channels change at once", _lost_edge, 2 * TICK_S, way) for way in (*IN_TURN, FLOOD)),
    *(Promise("encoder: one channel stands still", _still_channel, STILL_S, way) for way in IN_TURN),
    *(Promise("host silent, encoder", _silence, SILENT_S, way, "none") for way in IN_TURN),
    Promise("host reads on, but drives no more, encoder", _last_frame, SILENT_S, HOST, "reads"),
    Promise("nothing but garbage from the host, encoder", _last_frame, SILENT_S, FLOOD, "garbage"),
    *(
        Promise(f"hang: {what}, encoder", _hang(what), HANG_S, HOST)
        for what in ("main loop", "everything", "clock", "tick", "counter")
    ),
    *(Promise("e-stop opens, encoder", _e_stop, TICK_S, way) for way in (HOST, FLOOD)),
    Promise("end switch opens, encoder", _end_switch, 2 * TICK_S, HOST._replace(end_switches=True)),
    Promise("reset: power-on, external, brown-out, encoder", _reset, TICK_S, HOST),
    Promise("asked for a loop-back, then silent, encoder", _loopback, SILENT_S, HOST, "none"),
)


def _on(stand: Stand, promises: tuple[Promise, ...], lacks: str) -> tuple[Promise, ...]:
    """Of a stand: all but the hang of what its chip does not have."""
    return tuple(
        promise._replace(way=promise.way._replace(stand=stand))
        for promise in promises
        if not promise.what.startswith(f"hang: {lacks}")
    )


# An Uno's encoder is counted by an interrupt; a Pico has one interrupt for clock and tick.
PROMISES = OF_POTENTIOMETER + _on(UNO_ENCODER, OF_ENCODER, "counter")
PICO_PROMISES = _on(PICO, OF_POTENTIOMETER, "clock") + _on(PICO_ENCODER, OF_ENCODER, "clock")


# ---------------------------------------------------------------------- measuring


class _Phase(NamedTuple):
    off_s: float
    coast_rad: float
    travel_rad: float
    is_late: bool


def _phase(promise: Promise, driven: DrivenChip, rng: random.Random) -> _Phase:
    direction = rng.choice((1, -1))
    start_rad = None
    if promise.run_up_s is not None:
        start_rad = (
            driven.stand.limit_rad(direction) - rng.uniform(*promise.run_up_s) * driven.stand.steady(direction)[1]
        )
    driven.start(direction, start_rad)
    changed_s = driven.truth().pin_changed_s
    if promise.run_up_s is None:
        driven.go_on(driven.chip.now_s() + rng.uniform(0.0, 2 * PERIOD_S))
    drive_V = driven.truth().pin_V
    if drive_V == 0.0 or driven.truth().pin_changed_s != changed_s:
        raise RuntimeError(f"{promise.what}: the drive changed before it happened")
    event_s = promise.event(driven, rng)
    before = driven.truth()

    def shaft_rad(t_s: float) -> float:
        """At a time before the drive is off, by the exact motor."""
        start = State(before.v_rad_per_s, before.y_rad)
        return driven.stand.bench.motor.advance(start, drive_V, max(t_s - before.t_s, 0.0)).y

    bound_s = event_s + promise.bound_s
    driven.go_on(bound_s, promise.voice)
    is_late = driven.truth().pin_V != 0.0
    while driven.truth().pin_V != 0.0 and driven.chip.now_s() < bound_s + _GIVE_UP_S:
        driven.go_on(driven.chip.now_s() + TICK_S, promise.voice)
    off_s = max(driven.truth().pin_changed_s, event_s)
    driven.go_on(driven.chip.now_s() + _REST_S, promise.voice)
    after = driven.truth()
    if after.pin_V != 0.0 or max(after.pin_changed_s, event_s) != off_s:
        is_late = True  # it came back
    if after.v_rad_per_s != 0.0:
        raise RuntimeError(f"{promise.what}: the shaft still turns")
    driven.stop()
    coast_rad, travel_rad = (abs(after.y_rad - shaft_rad(t_s)) for t_s in (off_s, event_s))
    return _Phase(off_s - event_s, coast_rad, travel_rad, is_late)


def measure(promise: Promise, phases: int, seed: int = 1) -> Measured:
    """One row; the same seed gives the same phases."""
    way = promise.way._replace(stand=UNO)._asdict()  # the same phases on each
    del way["stand"]
    rng = random.Random(f"{seed} {promise.what} {way}")
    driven = DrivenChip(promise.way, rng)
    found = [_phase(promise, driven, rng) for _ in range(phases)]
    if not driven.is_sound():
        raise RuntimeError(
            f"{promise.what}: the program ran into what is no program, or broke a rule of the data sheet"
        )
    return Measured(
        promise,
        phases,
        max(one.off_s for one in found),
        max(one.coast_rad for one in found),
        max(one.travel_rad for one in found),
        sum(one.is_late for one in found),
    )
