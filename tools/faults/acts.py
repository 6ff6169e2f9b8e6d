"""How each fault is done: to a device, to its link, to the host, to the disk."""

from __future__ import annotations

import math
import os
import random
import signal
from collections.abc import Callable, Mapping
from pathlib import Path

from emulated_chips.virtual_chip import VirtualChip
from emulated_chips.virtual_pico import VirtualPico
from faults import damage, host, strangers
from faults.injector import FaultInjector
from faults.language import is_block, is_drive, is_keep
from faults.servo import talk

Act = Callable[[FaultInjector], None]

FREEZE_S = 1.0
SUSPEND_S = 5.0
FOR_TICKS = 50  # that a disturbance lasts which the run survives
STALL_S = 0.03  # of an overloaded host, at most
SMALL_DISK = 2 << 20
_SHORTEST_ROW = 60  # bytes, in samples.csv
_TICK_S = 0.005  # less than any period
THROWN_RAD_S = 5.0
PUSH_RAD_S = 1.0
HAND_RAD = 1.2  # that a hand turns the shaft before the run
HAND_RAD_S = 5.0
OFF_RAD = 0.03  # that the sensor may be off
MOMENT_S = 0.1  # what is shorter may pass unseen on a device that has to be looked at (``rig.running.session``)

# as the texts of rows.yaml call them
NUMBERS: Mapping[str, float] = {
    "ticks": FOR_TICKS,
    "stall_ms": 1e3 * STALL_S,
    "moment_ms": 1e3 * MOMENT_S,
    "thrown_rad_s": THROWN_RAD_S,
    "push_rad_s": PUSH_RAD_S,
    "hand_rad": HAND_RAD,
}


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


def _too_late(injector: FaultInjector) -> None:
    injector.down = damage.late(injector.too_late_s)


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
    if injector.hangs:
        injector.device.hang(injector.rng.choice(injector.hangs))
    else:
        injector.device.hang()


def _brown_out(injector: FaultInjector) -> None:
    if isinstance(injector.device, VirtualChip | VirtualPico):
        injector.device.reset(4, 0.05)
    else:
        injector.device.reset(4)


def _thrown(injector: FaultInjector) -> None:
    """A hand, or a load, throws the shaft over the limit at more than the largest speed."""
    side = injector.rng.choice((-1, 1))
    low, high = injector.hard_rad
    injector.device.place((high if side > 0 else low) - side * 0.005, side * THROWN_RAD_S)


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


def _turned_while(wiring: str) -> Act:
    """Before the run a hand turns the shaft while the encoder is wired so; then it makes contact again."""

    def act(injector: FaultInjector) -> None:
        device = injector.device
        from_rad = device.truth().y_rad
        device.rewire(sensor=wiring)
        side = -1.0 if from_rad > 0.0 else 1.0
        device.place(from_rad, side * HAND_RAD_S)
        injector.watch(HAND_RAD / HAND_RAD_S)
        device.place(from_rad + side * HAND_RAD, 0.0)
        injector.watch(0.1)
        device.rewire()
        injector.watch(0.1)

    return act


def _too_fast(injector: FaultInjector) -> None:
    """What no shaft does, but a wire that picks up the motor's noise: more edges than the chip counts."""
    injector.device.place(injector.device.truth().y_rad, injector.rng.choice((-1, 1)) * injector.too_fast_rad_s)


def _end_switch(injector: FaultInjector) -> None:
    """That of the side which is driven to; without a drive, of the side on which the shaft stands."""
    truth = injector.device.truth()
    is_high = truth.y_rad > 0.0 if truth.pin_V == 0.0 else truth.pin_V > 0.0
    injector.device.contact("end_high" if is_high else "end_low", is_open=True)


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


def _cut_flag(injector: FaultInjector) -> None:
    os.truncate(next((injector.folder / "runs").glob("*/stop.flag")), 0)


def _read_only(folder: Path) -> None:
    (folder / "runs").mkdir()
    (folder / "runs").chmod(0o555)
    host.obey_permissions()


def _small(folder: Path) -> None:
    (folder / "runs").mkdir()
    host.small_disk(folder / "runs", SMALL_DISK)


def _change_config(injector: FaultInjector) -> None:
    (injector.folder / "fault.yaml").write_text("name: another\nlimits: [none\n", encoding="utf-8")


# by the name of the row
ACTS: Mapping[str, Act] = {
    "nothing": _nothing,
    "cable out": _both(damage.lost),
    "port gone": _port_gone,
    "connection reset": lambda injector: injector.device.reset_connection(),
    "device hangs up": lambda injector: injector.device.hang_up(),
    "half open": _network(to_device=math.inf),
    "packet lost, to the host": lambda injector: injector.device.lose_packet("host"),
    "packet lost, to the device": lambda injector: injector.device.lose_packet("device"),
    "network stalls": _network(to_host=0.3, to_device=0.3),
    "garbage": _both(damage.garbage),
    "bit flips, to the host": _down(lambda: damage.flipped),
    "bit flips, to the device": _up(lambda: damage.flipped),
    "one bit flip": _down(lambda: damage.first(1, damage.flipped)),
    "truncated replies": _down(lambda: damage.truncated),
    "truncated requests": _up(lambda: damage.truncated),
    "duplicated replies": _down(lambda: damage.duplicated),
    "duplicated requests": _up(lambda: damage.duplicated),
    "replies late": _late(0.5, FOR_TICKS),
    "replies too late": _too_late,
    "one reply lost": _down(lambda: damage.first(1, damage.lost)),
    "replies lost": _down(lambda: damage.lost),
    "blocks lost": _down(lambda: damage.only(is_block, damage.lost)),
    "KEEPs lost": _up(lambda: damage.only(is_keep, damage.lost)),
    "some KEEPs lost": _up(lambda: damage.first(5, damage.only(is_keep, damage.lost))),
    "drives lost": _up(lambda: damage.only(is_drive, damage.lost)),
    "replies reordered": _down(damage.reordered),
    "replies stale": _down(damage.stale),
    "another master": talk,
    "device reset": lambda injector: injector.device.reset(2),
    "firmware hang": _hang,
    "brown-out": _brown_out,
    "sensor at a rail": _rewire(sensor="broken_high"),
    "sensor at a rail, for a moment": _moment(_rewire(sensor="broken_high"), _rewire()),
    "sensor wire broken": _rewire(sensor="broken_low"),
    "sensor stuck": _rewire(sensor="stuck"),
    "sensor jumps": _rewire(sensor="jumped"),
    "sensor noisy": _rewire(sensor="noisy"),
    "encoder: both channels at once": _rewire(sensor="jumped"),
    "encoder: one channel stands still": _rewire(sensor="still"),
    "encoder: edges too fast": _too_fast,
    "encoder: one channel loose before the run": _turned_while("still"),
    "encoder: plug out before the run": _turned_while("stuck"),
    "encoder: a homing that failed": lambda injector: injector.home_in_vain(),
    "drive stuck on": _rewire(drive="stuck_on"),
    "drive reversed": _rewire(drive="reversed"),
    "drive dead": _rewire(drive="dead"),
    "hard limit hit at speed": _thrown,
    "pushed over a limit": _pushed,
    "end switch": _end_switch,
    "e-stop": _contact("e_stop"),
    "e-stop, for a moment": _contact("e_stop", for_s=MOMENT_S),
    "both end switches, for a moment": _contact("end_low", "end_high", for_s=MOMENT_S),
    "host SIGINT": lambda injector: injector.tell_host(signal.SIGINT),
    "host SIGTERM": lambda injector: injector.tell_host(signal.SIGTERM),
    "host SIGKILL": lambda injector: injector.kill_host(),
    "host SIGSTOP, 1 s": lambda injector: injector.freeze_host(FREEZE_S),
    "host suspended, 5 s": lambda injector: injector.suspend_host(SUSPEND_S),
    "host overloaded": _overload,
    "clock stepped": host.step_clock,
    "disk full": _fill_disk,
    "folder unwritable, in the run": _close_folder,
    "recorder killed": host.kill_recorder,
    "stop flag cut short": _cut_flag,
    "config changed in the run": _change_config,
    **strangers.ACTS,
    "network dead": _network(to_host=math.inf, to_device=math.inf),
}

# done before the run, in its folder
PREPARATIONS: Mapping[str, Callable[[Path], None]] = {
    "a small disk": _small,
    "a folder that is read only": _read_only,
    "obey permissions": lambda folder: host.obey_permissions(),
}
