"""Who is on a bus, whatever model, and what a run would refuse; it changes nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from typing import Final

from rig.backends.driver import Transport
from rig.backends.servo.before import BeforeStore, put_back
from rig.backends.servo.bus import ServoLink, servo_link
from rig.backends.servo.models import MODELS, ServoModel, models_of
from rig.backends.servo.opening import (
    check_bus,
    check_free,
    check_others,
    check_started_anew,
    check_startup,
    objections,
    start_anew,
)
from rig.backends.servo.packets import LAST_ID
from rig.backends.servo.presence import who_answers
from rig.core.faults import Fault

USUAL_BAUDS: Final = (1_000_000, 57_600, 115_200)  # rig's own, and as Dynamixel and many boards are shipped
_KINDS: Final = (MODELS["xl330-m288"], MODELS["sts3215"])  # one of each protocol: all share where the number is
_ATTEMPTS: Final = 3

Opened = Callable[[int], AbstractContextManager[Transport]]  # a port at a baud


@dataclass(frozen=True)
class Seen:
    """A servo that answered.

    baud, id      where
    number        its model's
    model         None: rig does not know the number
    firmware      version
    mode          value of its register
    supply_V, temperature_degC   by its registers
    errors        value of its register
    objections    why a run would refuse it
    """

    baud: int
    id: int
    number: int
    model: ServoModel | None = None
    firmware: int = 0
    mode: int = 0
    supply_V: float = 0.0
    temperature_degC: int = 0
    errors: int = 0
    position: int = 0
    objections: tuple[str, ...] = ()


def scan(opened: Opened, bauds: Iterable[int] = USUAL_BAUDS, ids: Iterable[int] = range(LAST_ID + 1)) -> Iterator[Seen]:
    """Each servo at each of these bauds. Raises Fault LINK_OPEN, LINK_LOST."""
    ids = tuple(ids)
    for baud in bauds:
        with opened(baud) as port:
            for kind in _KINDS:
                for id, _ in who_answers(servo_link(port, kind, 0, baud), ids):
                    if (seen := _seen(port, servo_link(port, kind, id, baud), id, baud)) is not None:
                        yield seen


def _seen(port: Transport, link: ServoLink, id: int, baud: int) -> Seen | None:
    """What it tells of itself; None where its answers are none of this protocol."""
    try:
        number = link.value("model_number")
        models = models_of(number, link.model.protocol)
        if not models:
            return Seen(baud, id, number)
        model = models[0]
        own = servo_link(port, model, id, baud)
        roles = model.roles
        return Seen(
            baud,
            id,
            number,
            model,
            own.value(roles["firmware"]),
            own.value(roles["mode"]),
            own.value(roles["voltage"]) * model.role("voltage").scale,
            own.value(roles["temperature"]),
            own.value(roles["errors"]),
            own.value(roles["position"]),
            objections(own),
        )
    except Fault as fault:
        if fault.code == "LINK_LOST":
            raise
        return None


def known_servo(port: Transport, id: int, baud: int) -> ServoLink:
    """The servo of that id by its number. Raises Fault LINK_TIMEOUT for none, CONFIG_MISMATCH for one unknown."""
    for kind in _KINDS * _ATTEMPTS:  # a busy machine may be late once
        link = servo_link(port, kind, id, baud)
        if link.is_there(id) is None:
            continue
        number = link.value("model_number")
        models = models_of(number, kind.protocol)
        if not models:
            raise Fault("CONFIG_MISMATCH", f"servo {id} is of model number {number}, which rig does not know")
        return servo_link(port, models[0], id, baud)
    raise Fault("LINK_TIMEOUT", f"no servo {id} answers at {baud} baud; `rig servo scan` shows who does")


def reboot(link: ServoLink) -> None:
    """Start a servo anew, and wait until it answers.

    Raises Fault LINK_TIMEOUT, SERVO_REFUSED, SECOND_MASTER, LINK_UNIT; SERVO_SETUP for one that would drive then, or
    where another would obey, too; SERVO_IN_USE, SERVO_ERROR for one that has not done it.
    """
    check_bus(link)
    check_others(link)
    check_startup(link)
    start_anew(link)
    check_started_anew(link)


def set_baud(opened: Opened, link: ServoLink, baud: int, store: BeforeStore) -> None:
    """Have a servo speak at another baud from now on, kept without supply; then look for it there.

    store  a lock that had to be opened is in it until it is closed again: the next run, or ``restore``, closes it
    Raises Fault SERVO_IN_USE, SERVO_SETUP, SECOND_MASTER, LINK_UNIT, CONFIG_MISMATCH for a baud that it has not,
    LINK_TIMEOUT, and as ``restore``.
    """
    check_bus(link)
    check_others(link)
    model, id = link.model, link.bus.id
    index = next((index for index, one in model.bauds.items() if one == baud), None)
    if index is None:
        raise Fault("CONFIG_MISMATCH", f"{model.name} has no {baud} baud: {', '.join(map(str, model.bauds.values()))}")
    if link.value(model.roles["torque"]) != 0:
        raise Fault("SERVO_IN_USE", f"servo {id}: its torque is on")
    restore(link, store)  # behind an open lock what a run has left could stay for good
    with _unlocked(link, store):  # else the servo forgets it with its supply
        try:
            link.put(model.roles["baud"], index)
        except Fault as fault:
            if fault.code not in ("LINK_TIMEOUT", "LINK_REPLY"):  # it may answer at its new baud already
                raise
        with opened(baud) as fresh:
            there = servo_link(fresh, model, id, baud)
            if not any(there.is_there(id) is not None for _ in range(_ATTEMPTS)):
                raise Fault("LINK_TIMEOUT", f"servo {id} does not answer at {baud} baud: cut its supply, and scan")
            _lock(there, store)


@contextmanager
def _unlocked(link: ServoLink, store: BeforeStore) -> Iterator[None]:
    """Open a servo's lock, where it has one, for the block, which closes it where all goes well."""
    lock = link.model.roles.get("lock")
    if lock is not None:
        store.save(link.model, link.bus.id, {lock: 1}, {lock: [0]})
        link.put(lock, 0)
    try:
        yield
    except BaseException:  # Ctrl-C, too
        with suppress(Fault):  # without an answer the file keeps it
            _lock(link, store)
        raise


def _lock(link: ServoLink, store: BeforeStore) -> None:
    lock = link.model.roles.get("lock")
    if lock is None:
        return
    if link.value(lock) != 0:
        raise Fault(
            "DEVICE_RESET", f"servo {link.bus.id} has restarted meanwhile, and forgets its new baud: set it anew"
        )
    link.put(lock, 1)
    store.clear()


def restore(link: ServoLink, store: BeforeStore) -> dict[str, int] | None:
    """Put back what a run has left changed; what it was, or None.

    Raises Fault SERVO_CHANGED, SERVO_IN_USE, SECOND_MASTER, LINK_*.
    """
    if store.load(link.model) is None:
        return None
    check_free(link)  # it takes the torque away: not from somebody who drives it
    return put_back(link, store, is_left=True)


def all_registers(link: ServoLink) -> Iterator[tuple[str, int, int, str]]:
    """Name, address, value, and the value with its unit where it has one. Raises Fault LINK_*."""
    for register in link.model.registers.values():
        value = link.value(register.name)
        unit = {"1": "of full"}.get(register.unit, register.unit)
        yield register.name, register.address, value, f"{value * register.scale:.5g} {unit}" if register.unit else ""
