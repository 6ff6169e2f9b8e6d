"""What may go wrong: how it is done, within what bound the drive must be at 0, what the run says to it."""

from __future__ import annotations

import math
import os
import random
import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from faults import damage, host
from faults.bounds import Bound, bound
from faults.injector import FaultInjector
from faults.language import is_block, is_drive, is_keep
from faults.stages import STAGES, START
from rig.backends.serial.emulated.virtual_chip import VirtualChip

Act = Callable[[FaultInjector], None]
Changes = dict[str, dict[str, Any]]  # of a row's fields, by a trait of the device

RUNS_ON = ""  # no fault
AT_ZERO = {stage.key for stage in STAGES if stage.at_zero and stage is not START}  # the drive is 0 there
FREEZE_S = 1.0
FOR_TICKS = 50  # that a disturbance lasts which the run survives
STALL_S = 0.03  # of an overloaded host, at most
SMALL_DISK = 2 << 20
_SHORTEST_ROW = 60  # bytes, in samples.csv
_TICK_S = 0.005  # less than any period


@dataclass(frozen=True)
class Row:
    """One row of the matrix.

    name     what goes wrong; ``how`` it is done
    act      does it
    bound    for the drive at the device; at rest, in the pause and at re-arming STAYS unless ``other`` says otherwise
    codes    that the run may end with, one, or two where ``either`` says when which; RUNS_ON: it goes on
    either   why there are two codes
    lasting  it stays until somebody mends it
    refused  codes that the next run may end with meanwhile, before any relay runs
    early    it is so from before the run: the breakaway check has to find it, no relay may run
    emulated changes of the config's section, in force from the beginning
    prepare  done before the run, in a process of its own; gets the folder that holds the config and `runs`
    alone    runs in a process of its own
    status   exit status where it is not that of the code: one of these
    same     the recording must equal that of a run in which nothing happens, to the last bit
    only     it is of devices with one of these traits (``backends.Backend``); empty: of all
    absent   traits of devices, or of stages (``stages.Stage.traits``), to which it does not apply, and why
    only_seen  the motor is driven on, whatever the device puts out
    other    what is otherwise on a device: fields by a trait; of several, in the order of the device's traits
    may_lose samples that are lost by chance; the remark says why
    leaves_result   there is a result.json, whatever ended the run
    remark   what else is to be said
    """

    name: str
    how: str
    act: Act
    bound: Bound
    codes: tuple[str, ...]
    lasting: bool = False
    refused: tuple[str, ...] = ()
    early: bool = False
    emulated: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    prepare: Callable[[Path], None] | None = None
    alone: bool = False
    status: tuple[int, ...] = ()
    same: bool = False
    only: tuple[str, ...] = ()
    absent: Mapping[str, str] = field(default_factory=dict)
    only_seen: bool = False
    other: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    may_lose: int = 0
    leaves_result: bool = True
    either: str = ""
    remark: str = ""

    def on(self, traits: Sequence[str]) -> Row:
        """The row as it is for one device, or for one in a stage (``stages.Stage.traits``)."""
        changes: dict[str, Any] = {}
        for trait in traits:
            runs_on = changes.get("codes", self.codes) == (RUNS_ON,) and -signal.SIGKILL not in self.status
            if trait in AT_ZERO and not runs_on:
                changes["bound"] = STAYS
            changes |= self.other.get(trait, {})
        return replace(self, **changes)

    def why_absent(self, traits: Sequence[str]) -> str:
        """Why it does not apply to a device; empty where it does, or is of others only."""
        return next((self.absent[trait] for trait in traits if trait in self.absent), "")

    def is_for(self, traits: Sequence[str]) -> bool:
        """Whether it is run on a device."""
        return not self.why_absent(traits) and (not self.only or any(trait in self.only for trait in traits))


# ---------------------------------------------------------------------- bounds

STAYS = bound("the drive is 0, and stays so")
SILENCE = bound(
    "the device's watchdog counts from the last drive, which may still be on its way", watchdog=1, frame=1, tick=2
)
HEARD = bound("the loop waits a time-out for its next reply, then says stop", period=1, timeout=1, frame=1, tick=2)
SEEN = bound("the loop sees it in its next reading, and says stop", period=1, exchange=1, frame=1, tick=2)
DEVICE = bound("the device checks each tick", tick=3)
AT_ONCE = bound("by itself", tick=1)
AGAIN = bound("the reading is asked for again within the time-out", timeout=1, period=1, exchange=1)
AGAIN_AND_AGAIN = bound("three readings in a row within a time-out each", timeout=3, period=3, frame=1, tick=2)
RUNNING = bound("no drive is older", period=2, exchange=1)
RAMP = bound(
    "the strokes come to their largest drive, and the loop says stop", ramp=1, period=1, exchange=1, frame=1, tick=2
)
LOOKED = bound("the loop looks at the recorder every 25 ticks", check=1, period=1, exchange=1, frame=1, tick=2)
STANDS = "no cycle that goes on stands for 0.6 of its longest period, whatever drives; periods jitter by some ticks"
COASTS = "the shaft comes to rest within 0.4 of a period; no cycle that goes on stands for the other 0.6"
FLUNG = bound(
    "until it is faster than any shaft may be, and the loop sees it",
    fling=1,
    window=1,
    period=1,
    exchange=1,
    frame=1,
    tick=2,
)
RUN_AWAY = bound(
    "until it is faster than any shaft may be, or at the limit, and the loop sees it",
    reversal=1,
    window=1,
    period=1,
    exchange=1,
    frame=1,
    tick=2,
)
SEARCHED = bound(
    "the search gives up a cycle that has stuck after 3.5 of its periods; from then on both relays drive the same way, "
    "and the guard waits for 0.3 s, or twice the longest stand so far, four times 0.3 s at most",
    cycle=3.5,
    stuck=4,
    period=1,
    exchange=1,
    frame=1,
    tick=2,
)
UNMOVED = bound(
    "the law asks for a drive well above friction, which moves the reading not, or not as it must",
    unmoved=1,
    period=1,
    exchange=1,
    frame=1,
    tick=2,
)
# of a relay in the device, whose rows come in blocks
GAP = bound(
    "the block after the one that is missing tells of it, and the loop says stop",
    block=2,
    exchange=1,
    period=1,
    frame=1,
    tick=2,
)
SILENT = bound(
    "a block and a time-out after the last one the loop, in its next tick, asks why, for a time-out, then says stop",
    block=1,
    exchange=1,
    timeout=2,
    period=2,
    frame=1,
    tick=2,
)
FLUNG_IN_BLOCK = bound(
    "until it is faster than any shaft may be, and the loop sees it when its block has come",
    fling=1,
    window=1,
    block=1,
    exchange=1,
    period=1,
    frame=1,
    tick=2,
)
AWAY_IN_BLOCK = bound(
    "until it is faster than any shaft may be, or at the limit, and the loop sees it when its block has come",
    reversal=1,
    window=1,
    block=1,
    exchange=1,
    period=1,
    frame=1,
    tick=2,
)
IN_BLOCK = bound(
    "the loop sees it when its block has come, and says stop", block=1, exchange=1, period=1, frame=1, tick=2
)

NO_CONTACTS = "the contacts are the Uno's; the firmware's core alone has none"
NO_STATUS = "the block has no register that would tell: wire it into the motor's supply"
NO_INPUTS = "the block has no such input: wire it into the motor's supply"


# ---------------------------------------------------------------------- acts


def _nothing(injector: FaultInjector) -> None:
    pass


def _down(what: Callable[[], damage.Damage]) -> Act:
    def act(injector: FaultInjector) -> None:
        injector.down = what()

    return act


def _up(what: Callable[[], damage.Damage]) -> Act:
    def act(injector: FaultInjector) -> None:
        injector.up = what()

    return act


def _late(share: float, number: int) -> Act:
    def act(injector: FaultInjector) -> None:
        injector.down = damage.first(number, damage.late(share * injector.spare_s))

    return act


def _both(what: damage.Damage) -> Act:
    def act(injector: FaultInjector) -> None:
        injector.up = injector.down = what

    return act


def _network(*, to_host: float = 0.0, to_device: float = 0.0) -> Act:
    """Nothing arrives for so long, s; then everything does."""

    def act(injector: FaultInjector) -> None:
        injector.device.block_way("host", to_host)
        injector.device.block_way("device", to_device)
        injector.to_undo.append(injector.device.free_ways)

    return act


def _port_gone(injector: FaultInjector) -> None:
    injector.is_gone = True


def _rewire(**wiring: str) -> Act:
    return lambda injector: injector.device.rewire(**wiring)


def _hang(injector: FaultInjector) -> None:
    if isinstance(injector.device, VirtualChip):
        injector.device.hang(injector.rng.choice(("main loop", "everything", "clock", "converter")))
    else:
        injector.device.hang()


def _brown_out(injector: FaultInjector) -> None:
    if isinstance(injector.device, VirtualChip):
        injector.device.reset(4, 0.05)
    else:
        injector.device.reset(4)


def _thrown(injector: FaultInjector) -> None:
    """A hand, or a load, throws the shaft over the limit at more than the largest speed."""
    side = injector.rng.choice((-1, 1))
    low, high = injector.hard_rad
    injector.device.place((high if side > 0 else low) - side * 0.005, side * THROWN_RAD_S)


THROWN_RAD_S = 5.0


PUSH_RAD_S = 1.0
OFF_RAD = 0.03  # that the sensor may be off


def _pushed(injector: FaultInjector) -> None:
    """A hand, or a load, pushes the shaft over the nearer limit, slower than a drive would.

    It comes where no drive is the other way: that would stop a shaft that is sped up, which is SENSOR_STUCK long before
    the limit. The fault begins where the sensor must see it.
    """
    low, high = injector.hard_rad
    began: list[tuple[float, float]] = []
    injector.fault_s = math.inf

    def push() -> None:
        truth = injector.device.truth()
        if not began:
            if truth.pin_V * truth.y_rad < 0.0:
                return
            began.append((truth.y_rad, injector.now_s()))
        ((from_rad, from_s),) = began
        side = 1.0 if from_rad >= 0.0 else -1.0
        over_rad = abs((high if side > 0.0 else low) - from_rad) + OFF_RAD
        went_rad = PUSH_RAD_S * (injector.now_s() - from_s)
        if injector.fault_s == math.inf and went_rad >= over_rad:
            injector.happens_now()
        injector.device.place(from_rad + side * min(went_rad, over_rad + OFF_RAD), 0.0)

    injector.push = push


def _contact(*which: str, for_s: float = math.inf) -> Act:
    """Contacts open, for a while."""

    def act(injector: FaultInjector) -> None:
        for one in which:
            injector.device.contact(one, is_open=True)
        if for_s < math.inf:
            injector.later(for_s, lambda: [injector.device.contact(one, is_open=False) for one in which])

    return act


def _moment(act: Act, undo: Act) -> Act:
    """Something happens, and is undone ``MOMENT_S`` later."""

    def both(injector: FaultInjector) -> None:
        act(injector)
        injector.later(MOMENT_S, lambda: undo(injector))

    return both


MOMENT_S = 0.1  # what is shorter may pass unseen on a device that has to be looked at (``rig.session``)


def _end_switch(injector: FaultInjector) -> None:
    injector.device.contact("end_high" if injector.device.truth().pin_V > 0.0 else "end_low", is_open=True)


def _overload(injector: FaultInjector) -> None:
    left = [FOR_TICKS]

    def stall_s(rng: random.Random) -> float:
        left[0] -= 1
        return rng.uniform(0.0, STALL_S) if left[0] >= 0 and rng.random() < 0.5 else 0.0

    injector.stall_s = stall_s


def _fill_disk(injector: FaultInjector) -> None:
    """Nothing more fits, not even into the last page of samples.csv: it happens when no row fits into that page."""
    injector.written()
    samples = next((injector.folder / "runs").glob("*/samples.csv"))
    if -samples.stat().st_size % os.sysconf("SC_PAGE_SIZE") >= _SHORTEST_ROW:
        injector.schedule(injector.now_s() + _TICK_S, _fill_disk)
    else:
        host.fill_disk(injector.folder / "runs")


def _close_folder(injector: FaultInjector) -> None:
    next((injector.folder / "runs").iterdir()).chmod(0o555)


def _read_only(folder: Path) -> None:
    (folder / "runs").mkdir()
    (folder / "runs").chmod(0o555)
    host.obey_permissions()


def _small(folder: Path) -> None:
    (folder / "runs").mkdir()
    host.small_disk(folder / "runs", SMALL_DISK)


def _change_config(injector: FaultInjector) -> None:
    (injector.folder / "fault.yaml").write_text("name: another\nlimits: [none\n", encoding="utf-8")


# ---------------------------------------------------------------------- rows

NO_SPACE = "cannot be written: No space left on device"
NO_PERMISSION = "cannot be written: Permission denied"
NO_LINK = ("LINK_HELLO", "LINK_TIMEOUT", "LINK_REPLY", "LINK_OPEN")
FITS_OR_NOT = "what comes may begin as the reply does, and never end (LINK_TIMEOUT), or be none (LINK_REPLY)"
MISFIT: Changes = {"modbus": {"codes": ("LINK_REPLY", "LINK_TIMEOUT"), "either": FITS_OR_NOT}}


def _unhurried(**changes: Any) -> Changes:
    """Of a Modbus device outside of the tick."""
    return {"modbus, pause": changes, "modbus, arming": changes}


# nothing is asked again in a tick, whatever is needed up to three times outside of one
PATIENT = _unhurried(codes=(RUNS_ON,), bound=RUNNING)
# a block that has lost its watchdog's time takes no drive
RESET_BARE: Changes = {
    "bare": {"codes": ("MODBUS_EXCEPTION",), "bound": SEEN},
    "bare, rest": {"codes": ("DEVICE_RESET",), "bound": STAYS},
}
# outside of a tick it is waited for
SENT_AGAIN: Changes = _unhurried(codes=(RUNS_ON,), bound=RUNNING)
NO_SECOND: Changes = {"modbus": {"codes": ("LINK_TIMEOUT",), "bound": HEARD}}
NO_SECOND_LOOK: Changes = {"modbus": {"codes": ("LINK_REPLY",), "bound": HEARD}}
MISSED: Changes = {"relay": {"bound": GAP, "codes": ("LINK_GAP",)}}
UNHEARD: Changes = {"relay": {"bound": SILENT}}
DEAF: Changes = {"relay": {"codes": ("DEVICE_WATCHDOG",)}}
TCP_IS_WHOLE = (
    "TCP hands over each byte once, whole and in order, or late: see the rows of lost packets; what comes damaged has "
    "passed its check sum"
)
ELSEWHERE: dict[str, Any] = {"codes": (RUNS_ON,), "bound": RUNNING, "status": (0, 1)}
IN_A_PAUSE = (
    "A Modbus device tells no time: that it was reset while it is disarmed shows in its settings, which are read back "
    "before it is armed again"
)
ARMED_ANEW: Changes = {
    "modbus, pause": {"codes": ("DEVICE_RESET",), "bound": STAYS, "either": ""},
    "modbus, arming": {
        "codes": ("DEVICE_RESET", "MODBUS_EXCEPTION"),
        "bound": STAYS,
        "either": "a block that has lost its settings after they were read back refuses to be armed",
    },
    "tcp, pause": {"codes": ("LINK_LOST",), "bound": STAYS},
    "tcp, arming": {"codes": ("LINK_LOST",), "bound": STAYS, "either": "", "status": ()},
}
# a block without rails of its own leaves it to the loop, and any block does so while it is disarmed
RAIL: Changes = {
    "bare": {"bound": SEEN, "codes": ("SENSOR_RAIL",), "refused": ("SENSOR_RAIL",)},
    "modbus, pause": {"codes": ("SENSOR_RAIL",)},
}
DRIVEN: Changes = {
    name: {"bound": UNMOVED} for name in ("rest", "pause", "arming", "tracking")
}  # seen once it has to move
RESET: Changes = {
    "fc23": {"codes": ("DEVICE_NOT_ARMED",)},
    "separate": {
        "codes": ("DEVICE_NOT_ARMED", "MODBUS_EXCEPTION"),
        "either": "MODBUS_EXCEPTION where it is a drive that comes first: a block that is not armed takes none",
    },
    "tcp": {"codes": ("LINK_LOST",)},
}
RESTARTS: Changes = {
    "chip": {"codes": ("LINK_TIMEOUT",)},
    "relay": {
        "codes": ("DEVICE_RESET", "LINK_TIMEOUT"),
        "either": "DEVICE_RESET where the chip runs again before the loop misses a block",
    },
    "fc23": {"codes": ("DEVICE_NOT_ARMED",)},
    "tcp": {
        "codes": ("LINK_LOST", "LINK_TIMEOUT"),
        "either": "LINK_TIMEOUT where the request is on its way just then: its reply goes with the supply",
    },
    "pause": {"codes": ("DEVICE_RESET",)},
}
BREAKAWAY = "it ends in the breakaway check, before any relay runs: as where the host's relay drives"


ROWS = (
    # the link
    Row(
        "cable out",
        "nothing arrives, either way",
        _both(damage.lost),
        SILENCE,
        ("LINK_TIMEOUT",),
        True,
        NO_LINK,
        other={"tcp": {"act": _network(to_host=math.inf, to_device=math.inf)}},
    ),
    Row("port gone", "reading and writing fail", _port_gone, SILENCE, ("LINK_LOST",), True, ("LINK_LOST", "LINK_OPEN")),
    Row(
        "connection reset",
        "by something on the way",
        lambda injector: injector.device.reset_connection(),
        SILENCE,
        ("LINK_LOST",),
        only=("tcp",),
        remark="the device is not told, and waits for its watchdog",
    ),
    Row(
        "device hangs up",
        "it closes the connection in order",
        lambda injector: injector.device.hang_up(),
        SILENCE,
        ("LINK_LOST",),
        only=("tcp",),
    ),
    Row(
        "half open",
        "what goes to the device never arrives, what it sends does",
        _network(to_device=math.inf),
        SILENCE,
        ("LINK_TIMEOUT",),
        True,
        NO_LINK,
        only=("tcp",),
    ),
    Row(
        "packet lost, to the host",
        "it is sent again after 0.2 s, and all that follows waits",
        lambda injector: injector.device.lose_packet("host"),
        HEARD,
        ("LINK_TIMEOUT",),
        only=("tcp",),
        other=SENT_AGAIN,
        remark="of a period of 10 ms no network may lose one",
    ),
    Row(
        "packet lost, to the device",
        "it is sent again after 0.2 s, and all that follows waits",
        lambda injector: injector.device.lose_packet("device"),
        SILENCE,
        ("LINK_TIMEOUT",),
        only=("tcp",),
        other=SENT_AGAIN
        | {
            "modbus, arming": {
                "codes": (RUNS_ON, "DEVICE_WATCHDOG"),
                "bound": RUNNING,
                "either": "DEVICE_WATCHDOG where it is armed by then, and hears nothing for so long",
            }
        },
        remark="drives and stop arrive together, after the watchdog: they drive nothing",
    ),
    Row(
        "network stalls",
        "for 0.3 s nothing arrives, either way; then everything does",
        _network(to_host=0.3, to_device=0.3),
        SILENCE,
        ("LINK_TIMEOUT",),
        only=("tcp",),
        other={"tcp, pause": {"codes": (RUNS_ON,), "bound": RUNNING}},
    ),
    Row(
        "garbage",
        "random bytes instead of frames",
        _both(damage.garbage),
        SILENCE,
        ("LINK_TIMEOUT",),
        True,
        NO_LINK,
        other=MISFIT,
        absent={"tcp": TCP_IS_WHOLE},
    ),
    Row(
        "bit flips, to the host",
        "one wrong bit in each reply",
        _down(lambda: damage.flipped),
        HEARD,
        ("LINK_TIMEOUT",),
        True,
        NO_LINK,
        other=MISFIT | UNHEARD,
        absent={"tcp": TCP_IS_WHOLE},
    ),
    Row(
        "bit flips, to the device",
        "one wrong bit in each request",
        _up(lambda: damage.flipped),
        SILENCE,
        ("LINK_TIMEOUT",),
        True,
        NO_LINK,
        other=DEAF,
        absent={"tcp": TCP_IS_WHOLE},
    ),
    Row(
        "one bit flip",
        "in one reply",
        _down(lambda: damage.first(1, damage.flipped)),
        AGAIN,
        (RUNS_ON,),
        other=NO_SECOND_LOOK
        | MISSED
        | PATIENT
        | {
            "board, cycle": {
                "codes": (RUNS_ON, "LINK_TIMEOUT"),
                "either": "LINK_TIMEOUT where it is the reply's last byte: the next reply is taken for its end, and "
                "both are lost",
                "may_lose": 1,
            },
            "relay, cycle": {"codes": ("LINK_GAP",), "either": "", "may_lose": 0},
        },
        absent={"tcp": TCP_IS_WHOLE},
    ),
    Row(
        "truncated replies",
        "the end of each is missing",
        _down(lambda: damage.truncated),
        HEARD,
        ("LINK_TIMEOUT",),
        True,
        NO_LINK,
        other=MISFIT | UNHEARD,
        absent={"tcp": TCP_IS_WHOLE},
    ),
    Row(
        "truncated requests",
        "the end of each is missing",
        _up(lambda: damage.truncated),
        SILENCE,
        ("LINK_TIMEOUT",),
        True,
        NO_LINK,
        other=DEAF,
        absent={"tcp": TCP_IS_WHOLE},
    ),
    Row(
        "duplicated replies",
        "each comes twice",
        _down(lambda: damage.duplicated),
        RUNNING,
        (RUNS_ON,),
        other={"modbus": {"codes": ("LINK_REPLY",)}},
    ),
    Row(
        "duplicated requests",
        "each goes twice, at once",
        _up(lambda: damage.duplicated),
        RUNNING,
        (RUNS_ON,),
        absent={"tcp": TCP_IS_WHOLE},
        other={"modbus": {"codes": ("LINK_TIMEOUT",), "bound": SILENCE, "lasting": True, "refused": NO_LINK}},
    ),
    Row(
        "replies late",
        f"{FOR_TICKS} of them, by half of what the time-out leaves",
        _late(0.5, FOR_TICKS),
        bound("no drive is older", period=3, exchange=1),
        (RUNS_ON,),
        status=(0, 1),
        remark="the loop skips the ticks that it cannot hold, and goes on; such a recording may be refused",
    ),
    Row(
        "replies too late",
        "by twice what the time-out leaves",
        _late(2.0, 1 << 30),
        HEARD,
        ("LINK_TIMEOUT",),
        True,
        NO_LINK,
        other=UNHEARD,
    ),
    Row(
        "one reply lost",
        "never comes",
        _down(lambda: damage.first(1, damage.lost)),
        AGAIN,
        (RUNS_ON,),
        other=NO_SECOND | MISSED | PATIENT,
    ),
    Row(
        "replies lost",
        "none comes",
        _down(lambda: damage.lost),
        HEARD,
        ("LINK_TIMEOUT",),
        True,
        NO_LINK,
        other=UNHEARD,
    ),
    Row(
        "blocks lost",
        "none comes, and what is asked is answered",
        _down(lambda: damage.only(is_block, damage.lost)),
        SILENT,
        ("LINK_TIMEOUT",),
        only=("relay",),
    ),
    Row(
        "KEEPs lost",
        "the device does not hear that the host lives",
        _up(lambda: damage.only(is_keep, damage.lost)),
        SILENCE,
        ("DEVICE_WATCHDOG",),
        only=("relay",),
    ),
    Row(
        "some KEEPs lost",
        "five in a row",
        _up(lambda: damage.first(5, damage.only(is_keep, damage.lost))),
        bound("the device waits for the next one as long as its watchdog", watchdog=1),
        (RUNS_ON,),
        only=("relay",),
    ),
    Row(
        "drives lost",
        "readings are answered, drives do not arrive",
        _up(lambda: damage.only(is_drive, damage.lost)),
        bound("three drives in a row", period=4, exchange=1, frame=1, tick=2),
        ("LINK_TIMEOUT",),
        absent={"fc23": "drive and reading are one request", "relay": "the device drives: see KEEPs lost"},
        other={"separate": {"bound": HEARD}},
    ),
    Row(
        "replies reordered",
        "each second one first",
        _down(damage.reordered),
        AGAIN_AND_AGAIN,
        ("LINK_TIMEOUT",),
        True,
        (*NO_LINK, "DEVICE_WATCHDOG"),
        other=NO_SECOND | MISSED | _unhurried(codes=("DEVICE_WATCHDOG",)),
    ),
    Row(
        "replies stale",
        "each is the one before",
        _down(damage.stale),
        AGAIN_AND_AGAIN,
        ("LINK_TIMEOUT",),
        True,
        (*NO_LINK, "DEVICE_WATCHDOG"),
        other=NO_SECOND
        | _unhurried(
            codes=("LINK_REPLY", "DEVICE_RESET"),
            either="DEVICE_RESET where a setting is read back: RTU has no numbers, and the reply is another setting's",
        ),
        absent={"relay": "nothing is asked: a block that comes in another's place is out of order"},
    ),
    # the device
    Row(
        "device reset",
        "by its reset input",
        lambda injector: injector.device.reset(2),
        AT_ONCE,
        ("DEVICE_RESET",),
        other=RESET | ARMED_ANEW | RESET_BARE,
        remark=IN_A_PAUSE,
    ),
    Row(
        "firmware hang",
        "main loop, interrupts, clock or converter stop for good",
        _hang,
        bound("the chip's own watchdog", hardware=1),
        ("LINK_TIMEOUT",),
        other={
            "chip": {
                "codes": ("LINK_TIMEOUT", "SAMPLE_STALE"),
                "either": "the main loop answers on, of the same sample, where only clock or converter stand",
            },
            "pause": {"codes": ("DEVICE_RESET",), "either": ""},
        },
        absent={"modbus": "the block is emulated by its registers, it has no program; a real one's is its maker's"},
    ),
    Row(
        "brown-out",
        "of the chip's supply",
        _brown_out,
        AT_ONCE,
        ("DEVICE_RESET",),
        other=RESTARTS | ARMED_ANEW | RESET_BARE,
        remark="while the chip starts it does not answer: LINK_TIMEOUT; the next run's meta.json names the cause. "
        + IN_A_PAUSE,
    ),
    # the sensor
    Row(
        "sensor at a rail",
        "it reads full scale",
        _rewire(sensor="broken_high"),
        DEVICE,
        ("DEVICE_SENSOR",),
        True,
        ("DEVICE_SENSOR",),
        other=RAIL,
    ),
    Row(
        "sensor at a rail, for a moment",
        f"it reads full scale for {1e3 * MOMENT_S:.0f} ms",
        _moment(_rewire(sensor="broken_high"), _rewire()),
        DEVICE,
        ("DEVICE_SENSOR",),
        other=RAIL,
    ),
    Row(
        "sensor wire broken",
        "the pull-down has it read 0",
        _rewire(sensor="broken_low"),
        DEVICE,
        ("DEVICE_SENSOR",),
        True,
        ("DEVICE_SENSOR",),
        other=RAIL,
    ),
    Row(
        "sensor stuck",
        "it holds its reading",
        _rewire(sensor="stuck"),
        bound(STANDS, cycle=0.6, exchange=1, period=3, frame=1, tick=2),
        ("SENSOR_STUCK",),
        True,
        ("NO_MOTION",),
        other={
            "relay": {"bound": bound(STANDS, cycle=0.6, block=1, exchange=1, period=3, frame=1, tick=2)},
            "search": {"bound": SEARCHED},
        }
        | DRIVEN,
        remark="under the relay's whole drive it is found in some 40 ms (a window of the velocity), or in 0.3 s "
        "where the shaft was just turning; else the inner level drives. In the first two periods of a test, and "
        "in the search for gains, only a drive well above friction finds it: where the inner level lasts, not before "
        "the time-out. Wire end switches",
    ),
    Row(
        "sensor jumps",
        "across its dead zone: a quarter of its range farther",
        _rewire(sensor="jumped"),
        SEEN,
        ("SENSOR_JUMP",),
        True,
        ("", "START_OUTSIDE", "DEVICE_TRAVEL"),
        other={"relay": {"bound": IN_BLOCK}, "pause": ELSEWHERE, "arming": ELSEWHERE},
        remark="a reading that is wrong by a constant is another position: look at the centre before the next run. In "
        "the pause nobody reads it, and it may be a hand that has turned the shaft: the run goes on from there",
    ),
    Row(
        "sensor noisy",
        "25 counts more",
        _rewire(sensor="noisy"),
        bound(
            "a reading that no motion explains: by chance one in two or three", period=12, exchange=1, frame=1, tick=2
        ),
        ("SENSOR_JUMP", "SENSOR_STUCK", "OVERSPEED"),
        True,
        ("SENSOR_NOISY", "SENSOR_JUMP", "OVERSPEED"),
        either="by chance of the noise: a step that is too long, a shaft that seems to slow down under a full drive, "
        "or to turn too fast",
        other={name: {"codes": ("SENSOR_JUMP",), "either": ""} for name in ("rest", "pause", "arming")},
    ),
    # the drive
    Row(
        "drive stuck on",
        "a quarter of the supply, whatever is commanded",
        _rewire(drive="stuck_on"),
        FLUNG,
        ("OVERSPEED", "SENSOR_STUCK"),
        True,
        ("START_OUTSIDE", "DEVICE_SENSOR", "DEVICE_TRAVEL", "TRAVEL_HARD", "OVERSPEED", "SENSOR_RAIL"),
        only_seen=True,
        either="OVERSPEED where the motor goes on as it was driven; SENSOR_STUCK where it turns back under a drive "
        "that had sped it up, which is seen first",
        other={
            "relay": {"bound": FLUNG_IN_BLOCK, "codes": ("OVERSPEED",), "either": ""},
            "rest": {"bound": FLUNG, "codes": ("OVERSPEED",), "either": ""},
            "pause": {"codes": ("DEVICE_SENSOR",), "either": ""},
            "modbus, pause": {"codes": ("SENSOR_RAIL",)},
            "arming": {"bound": FLUNG, "codes": ("OVERSPEED",), "either": ""},
        },
        remark="can only be detected: the device's output is 0, the motor's is not, and the shaft runs to its stop. "
        "Wire the e-stop, and end switches, into the motor's supply",
    ),
    Row(
        "drive reversed",
        "the motor's wires are swapped",
        _rewire(drive="reversed"),
        RUN_AWAY,
        ("OVERSPEED", "SENSOR_STUCK"),
        True,
        ("POLARITY", "START_OUTSIDE", "TRAVEL_HARD", "DEVICE_TRAVEL", "DEVICE_SENSOR"),
        either="OVERSPEED where the guard's brake speeds it up; SENSOR_STUCK where it slows down before under a drive "
        "that had sped it up",
        other={"relay": {"bound": AWAY_IN_BLOCK, "codes": ("RELAY_STOPPED",), "either": ""}} | DRIVEN,
        remark="a shaft that slows down under a drive that should speed it up is SENSOR_STUCK, too",
    ),
    Row(
        "drive dead",
        "nothing reaches the motor",
        _rewire(drive="dead"),
        bound(COASTS, cycle=1, exchange=1, period=3, frame=1, tick=2),
        ("SENSOR_STUCK",),
        True,
        ("NO_MOTION",),
        other={
            "relay": {"bound": bound(COASTS, cycle=1, block=1, exchange=1, period=3, frame=1, tick=2)},
            "search": {"bound": SEARCHED},
        }
        | DRIVEN,
        remark="as in sensor stuck; the shaft only coasts",
    ),
    Row(
        "drive stuck on, from the start",
        "as soon as it is armed",
        _nothing,
        bound("before the first stroke", tick=0),
        ("OVERSPEED", "DEVICE_SENSOR"),
        True,
        ("START_OUTSIDE", "DEVICE_SENSOR", "DEVICE_TRAVEL", "TRAVEL_HARD", "OVERSPEED", "SENSOR_RAIL"),
        either="DEVICE_SENSOR where the shaft is at the sensor's rail before the device is armed",
        early=True,
        emulated={"wiring": {"drive": "stuck_on", "fault_after_s": 0.05}},
        only_seen=True,
        remark="can only be detected",
        absent={"relay": BREAKAWAY},
    ),
    Row(
        "drive reversed, from the start",
        "the motor's wires are swapped",
        _nothing,
        RAMP,
        ("POLARITY",),
        True,
        ("POLARITY",),
        early=True,
        emulated={"wiring": {"drive": "reversed"}},
        absent={"relay": BREAKAWAY},
    ),
    Row(
        "drive dead, from the start",
        "nothing reaches the motor",
        _nothing,
        RAMP,
        ("NO_MOTION",),
        True,
        ("NO_MOTION",),
        early=True,
        emulated={"wiring": {"drive": "dead"}},
        absent={"relay": BREAKAWAY},
    ),
    Row(
        "friction too high to start",
        "a static level above breakaway.max_V",
        _nothing,
        RAMP,
        ("NO_MOTION",),
        True,
        ("NO_MOTION",),
        early=True,
        emulated={"motor": {"fs_plus_V": 1.6, "fs_minus_V": 1.6}},
        absent={"relay": BREAKAWAY},
    ),
    Row(
        "sensor stuck, from the start",
        "it holds its reading",
        _nothing,
        RAMP,
        ("NO_MOTION",),
        True,
        ("NO_MOTION",),
        early=True,
        emulated={"wiring": {"sensor": "stuck"}},
        absent={"relay": BREAKAWAY},
    ),
    Row(
        "sensor noisy, from the start",
        "25 counts more",
        _nothing,
        bound("before the first stroke", tick=0),
        ("SENSOR_JUMP", "OVERSPEED"),
        True,
        ("SENSOR_NOISY", "SENSOR_JUMP", "OVERSPEED"),
        early=True,
        emulated={"wiring": {"sensor": "noisy"}},
        either="by chance of the noise, which is seen before it is measured",
        absent={"relay": BREAKAWAY},
    ),
    # the way
    Row(
        "hard limit hit at speed",
        f"a hand throws the shaft over it at {THROWN_RAD_S:g} rad/s",
        _thrown,
        bound("5 mrad to go, 30 that the sensor is off, then the device checks each tick", tick=10),
        ("DEVICE_TRAVEL", "SENSOR_JUMP"),
        True,
        ("START_OUTSIDE", "DEVICE_SENSOR"),
        either="SENSOR_JUMP where the reading of before is old enough for the step to be too long",
        other={
            "bare": {
                "bound": SEEN,
                "codes": ("SENSOR_JUMP", "TRAVEL_HARD"),
                "refused": ("START_OUTSIDE", "SENSOR_RAIL"),
            },
            "pause": {"codes": ("DEVICE_SENSOR",), "either": ""},
            "modbus, pause": {"codes": ("SENSOR_RAIL",)},
            "arming": {
                "codes": ("TRAVEL_HARD", "DEVICE_TRAVEL"),
                "either": "TRAVEL_HARD where it was out before the device was armed, which waits for it to come in",
            },
            "modbus, arming": {
                "codes": ("DEVICE_SENSOR", "DEVICE_TRAVEL"),
                "either": "DEVICE_SENSOR where it was at the sensor's rail before the device was armed",
            },
            "bare, arming": {"codes": ("TRAVEL_HARD",), "either": ""},
        },
    ),
    Row(
        "pushed over a limit",
        f"a hand pushes the shaft over the nearer one at {PUSH_RAD_S:g} rad/s, slower than any drive would",
        _pushed,
        DEVICE,
        ("DEVICE_TRAVEL", "POLARITY"),
        True,
        ("TRAVEL_HARD",),
        either="POLARITY where the loop has braked before: the hand moves the shaft against its drive",
        other={
            "relay": {"codes": ("RELAY_STOPPED",), "either": ""},
            "bare": {"bound": SEEN, "codes": ("TRAVEL_HARD", "POLARITY")},
            "bare, rest": {"codes": ("TRAVEL_HARD",), "either": ""},
        },
        remark="where the drive is 0 it is over the limit once the device is disarmed: seen at re-arming",
    ),
    Row(
        "end switch",
        "opens on the side that is driven to",
        _end_switch,
        DEVICE,
        ("DEVICE_END_SWITCH",),
        True,
        ("DEVICE_END_SWITCH", "DEVICE_TRAVEL"),
        either="DEVICE_TRAVEL where it opened while the device was disarmed: armed there, it takes no drive outward",
        other={name: {"codes": ("DEVICE_END_SWITCH", "DEVICE_TRAVEL")} for name in ("pause", "arming")},
        absent={"board": NO_CONTACTS, "modbus": NO_INPUTS},
    ),
    Row(
        "e-stop",
        "opens",
        _contact("e_stop"),
        AT_ONCE,
        ("DEVICE_ESTOP",),
        True,
        ("DEVICE_ESTOP",),
        other={"modbus": {"bound": DEVICE}},
        absent={"board": NO_CONTACTS, "bare": NO_STATUS},
    ),
    Row(
        "e-stop, for a moment",
        f"opens for {1e3 * MOMENT_S:.0f} ms",
        _contact("e_stop", for_s=MOMENT_S),
        AT_ONCE,
        ("DEVICE_ESTOP",),
        other={"modbus": {"bound": DEVICE}},
        absent={"board": NO_CONTACTS, "bare": NO_STATUS},
    ),
    Row(
        "both end switches, for a moment",
        f"their common wire opens for {1e3 * MOMENT_S:.0f} ms",
        _contact("end_low", "end_high", for_s=MOMENT_S),
        DEVICE,
        ("DEVICE_END_SWITCH",),
        absent={"board": NO_CONTACTS, "modbus": NO_INPUTS},
    ),
    # the host
    Row(
        "host SIGINT",
        "Ctrl-C",
        lambda injector: injector.tell_host(signal.SIGINT),
        SEEN,
        ("INTERRUPTED",),
    ),
    Row("host SIGTERM", "kill", lambda injector: injector.tell_host(signal.SIGTERM), SEEN, ("INTERRUPTED",)),
    Row(
        "host SIGKILL",
        "kill -9",
        lambda injector: injector.kill_host(),
        SILENCE,
        ("",),
        alone=True,
        status=(-signal.SIGKILL,),
        other={"separate": {"may_lose": 1}},
        remark="the recording ends with `loop_died`. Where drives are confirmed (FC16) the sample of a tick is "
        "recorded after its drive was confirmed: if the host is killed in between, that sample is lost",
    ),
    Row(
        "host SIGSTOP, 1 s",
        "the process does nothing for a second",
        lambda injector: injector.freeze_host(FREEZE_S),
        SILENCE,
        ("DEVICE_WATCHDOG", "MODBUS_EXCEPTION"),
        either="MODBUS_EXCEPTION by a block without a status, which takes no drive after its time-out",
        other={
            "pause": {"codes": (RUNS_ON,), "bound": RUNNING, "status": (0,)},
            "arming": {
                "codes": ("DEVICE_WATCHDOG", RUNS_ON),
                "bound": RUNNING,
                "status": (0, 1),
                "either": "a device that is disarmed, or not armed yet, may wait",
            },
        },
    ),
    Row(
        "host overloaded",
        f"of {FOR_TICKS} wake-ups every second is up to {1e3 * STALL_S:.0f} ms late",
        _overload,
        bound("no drive is older", period=6, exchange=1),
        (RUNS_ON,),
        status=(0, 1),
        remark="what is later than the watchdog's time ends as SIGSTOP does",
    ),
    Row("clock stepped", "the wall clock jumps an hour back", host.step_clock, RUNNING, (RUNS_ON,), same=True),
    # the recording
    Row(
        "disk full",
        "nothing more fits on the run folder's disk",
        _fill_disk,
        LOOKED,
        ("RECORDER_DEAD",),
        True,
        ("RECORDER_DEAD", NO_SPACE),
        other={name: {"bound": LOOKED} for name in AT_ZERO},
        remark="rows still fit into the last page of samples.csv: the disk is full up to half a second later, and in "
        "another stage",
        prepare=_small,
        alone=True,
    ),
    Row(
        "folder unwritable",
        "no run folder can be made",
        _nothing,
        AT_ONCE,
        ("",),
        True,
        (NO_PERMISSION,),
        early=True,
        absent={"relay": "it is refused before any relay runs: as where the host's relay drives"},
        prepare=_read_only,
        alone=True,
        status=(2,),
        remark="refused before the device is armed",
    ),
    Row(
        "folder unwritable, in the run",
        "nothing new can be made in it",
        _close_folder,
        RUNNING,
        ("",),
        prepare=lambda folder: host.obey_permissions(),
        alone=True,
        status=(1,),
        leaves_result=False,
        remark="what is open is written to the end; no result.json, and it says so",
    ),
    Row("recorder killed", "kill -9 to the recorder's process", host.kill_recorder, LOOKED, ("RECORDER_DEAD",)),
    Row("config changed in the run", "the file becomes another", _change_config, RUNNING, (RUNS_ON,), same=True),
)
