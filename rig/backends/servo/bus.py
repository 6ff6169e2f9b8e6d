"""Both protocols of servos as what goes over a bus, and the registers of one servo by their names."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from types import ModuleType
from typing import NamedTuple, TypeVar

from typing_extensions import override

from rig.backends.driver import Transport
from rig.backends.registers.bus import ATTEMPTS, BusClient, Damaged, Protocol, Reply
from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.link_budget import BITS_PER_BYTE, TURNAROUND_S
from rig.backends.servo.models import ServoModel
from rig.backends.servo.packets import PacketStream, Skipped
from rig.core.faults import Fault

REFUSAL = "SERVO_REFUSED"
PING_S = 0.004  # in which a servo that is there begins to answer a ping
_FEETECH_NUMBER = 3, 3  # address and bytes of a servo's model number, and its id
_PING_BYTES = 10 + 14  # of a ping and its answer
_DYNAMIXEL, _FEETECH = dynamixel.Stream(), feetech.Stream()  # each answer is looked at by itself

F = TypeVar("F")


class Ask(NamedTuple):
    """One instruction.

    data     its bytes
    about    its subject in words, for a fault
    replies  bytes of data that the answer must hold; None: any number
    begins   how the answer begins where it is as it must be, and is not as short as that to a write; empty: not told
    length   of that answer
    """

    data: bytes
    about: str
    replies: int | None = 0
    begins: bytes = b""
    length: int = 0


class Answer(NamedTuple):
    """One status: the error byte and the data behind it; its length on the wire."""

    id: int
    pdu: bytes
    length: int


def _first(stream: PacketStream[F], data: bytes) -> tuple[F, int] | None:
    """The packet that bytes begin with, and its length; None while it is not whole. Raises Damaged."""
    found = stream.first(data)
    if isinstance(found, Skipped):
        raise Damaged(f"{found.why}: {found.data[:24].hex(' ')}")
    return found


class Bus(Protocol[Ask]):
    """One servo on a bus: what it is asked, and what it must answer.

    id, baud  of the servo that is asked, of the line
    echoes    the adapter ties both lines together: the host hears what it sends, and compares it. It is seen at the
              first answer: of a Feetech an echo could be taken for one
    """

    refusal = REFUSAL
    echoes = False
    codec: ModuleType  # dynamixel or feetech
    _plain: bytes  # the answer of a servo that has nothing to tell
    _said = 0  # where in a packet's body the error byte is

    def __init__(self, id: int, baud: int) -> None:
        self.id = id
        self.name = f"servo {id}"
        self.turnaround_s = TURNAROUND_S
        self._baud = baud

    @property
    def id(self) -> int:
        """Of the servo that is asked."""
        return self._id

    @id.setter
    def id(self, id: int) -> None:
        self._id, self._plain = id, self.codec.status(id)

    @override
    def encode(self, request: Ask) -> bytes:
        return request.data

    @override
    def expected(self, data: bytes, request: Ask) -> bytes | None:
        _, _, replies, begins, length = request
        if self.echoes:
            return None
        if data == self._plain and not replies:  # the answer to each drive
            return b"\0"
        if len(data) == length and data.startswith(begins) and isinstance(body := self.codec.body_of(data), bytes):
            pdu = body[self._said :]
            # an echo has its instruction for an error; a shorter answer that is stuffed is as long on the wire
            if not pdu[0] and len(pdu) - 1 == replies:
                return pdu
        return None

    @override
    def take(self, data: bytes, request: Ask) -> Answer | None:
        sent = request.data
        self.echoes = self.echoes or data.startswith(sent)
        if not self.echoes:
            return self.answer(data)
        own = len(sent)
        if data[:own] != sent[: len(data)]:
            raise Damaged(f"the adapter echoed otherwise than was sent: {data[:24].hex(' ')}")
        found = self.answer(data[own:]) if len(data) > own else None
        return None if found is None else found._replace(length=own + found.length)

    def answer(self, data: bytes) -> Answer | None:
        """The answer that bytes begin with; None while it is not whole. Raises Damaged."""
        raise NotImplementedError

    @override
    def wire_s(self, n_bytes: int) -> float:
        return n_bytes * BITS_PER_BYTE / self._baud

    @override
    def check(self, frame: Answer, request: Ask) -> None:
        if frame.id != self._id:
            raise Fault("LINK_UNIT", f"servo {frame.id} answered, servo {self.id} was asked for {request.about}")
        if frame.pdu[0]:
            self.check_error(frame.pdu[0], request)
        if request.replies is not None and len(frame.pdu) != 1 + request.replies:
            raise Fault(
                "LINK_REPLY",
                f"asked for {request.about}: {len(frame.pdu) - 1} bytes came, not {request.replies}",
            )

    def check_error(self, error: int, request: Ask) -> None:
        """Raise Fault SERVO_REFUSED where an error byte says that the servo did not do it."""

    def alerts(self, pdu: bytes) -> bool:
        """Whether an answer says that the servo has an error of its hardware."""
        raise NotImplementedError

    def reading(self, address: int, length: int, about: str) -> Ask:
        """Read bytes."""
        id, codec = self._id, self.codec
        begins = codec.status_head(id, length)
        return Ask(codec.read(id, address, length), about, length, begins, codec.reply_bytes(length))

    def writing(self, address: int, data: bytes, about: str) -> Ask:
        """Write bytes, confirmed by an answer."""
        return Ask(self.codec.write(self._id, address, data), about)

    def ping(self, id: int) -> Ask:
        """Ask whether a servo is there; its answer is never the bytes of the question."""
        raise NotImplementedError

    def reboot(self) -> Ask:
        """Start the servo anew."""
        return Ask(self.codec.reboot(self._id), "reboot")

    def confirmed(self) -> bytes:
        """The answer to a write that was done, without any error."""
        return self._plain


class DynamixelBus(Bus):
    """Protocol 2.0."""

    codec, _said = dynamixel, 1

    @override
    def answer(self, data: bytes) -> Answer | None:
        if (found := _first(_DYNAMIXEL, data)) is None:
            return None
        frame, length = found
        if not frame.is_status or not frame.parameters:
            raise Damaged(f"no answer, but instruction {frame.instruction:#04x}")
        return Answer(frame.id, frame.parameters, length)

    @override
    def check_error(self, error: int, request: Ask) -> None:
        code = error & ~dynamixel.ALERT
        if code:
            words = dynamixel.ERRORS.get(code, f"error {code}")
            raise Fault(REFUSAL, f"{request.about}: {words} (error {code})")

    @override
    def alerts(self, pdu: bytes) -> bool:
        return bool(pdu[0] & dynamixel.ALERT)

    @override
    def ping(self, id: int) -> Ask:
        return Ask(dynamixel.ping(id), f"servo {id}", 3)


class FeetechBus(Bus):
    """Feetech's protocol. Nothing in an answer tells which request it is for, and one damaged packet in 256 passes."""

    codec = feetech

    @override
    def answer(self, data: bytes) -> Answer | None:
        if (found := _first(_FEETECH, data)) is None:
            return None
        frame, length = found
        return Answer(frame.id, bytes((frame.code,)) + frame.parameters, length)

    @override
    def alerts(self, pdu: bytes) -> bool:
        return pdu[0] != 0

    @override
    def ping(self, id: int) -> Ask:
        # not by a ping: one that has an error of its supply answers that with the very same bytes, like an echo
        return Ask(feetech.read(id, *_FEETECH_NUMBER), f"servo {id}", _FEETECH_NUMBER[1])


def bus_of(model: ServoModel, id: int, baud: int) -> Bus:
    """The protocol that a model speaks."""
    return DynamixelBus(id, baud) if model.protocol == "dynamixel" else FeetechBus(id, baud)


class ServoLink:
    """Registers of one servo by their names, outside the tick.

    transport  an open port
    client     asks on its bus
    bus        the servo's protocol
    model      its registers
    timeout_s  longest wait for one reply, s
    now_s      clock of the port, s
    Each method raises Fault LINK_*, SERVO_REFUSED. Questions and writes are repeated where no answer comes.
    """

    def __init__(
        self, transport: Transport, client: BusClient[Ask], bus: Bus, model: ServoModel, timeout_s: float
    ) -> None:
        self.client, self.bus, self.model = client, bus, model
        self.now_s = transport.now_s
        self._timeout_s = timeout_s
        self._asked: Callable[[Ask, float], Reply] = client.patiently
        self._pings = BusClient(transport, bus)  # of its own: that nobody answers a ping is no error of the link

    @property
    def stray_bytes(self) -> int:
        """Bytes so far that were no awaited answer."""
        return self._pings.statistics["stale_bytes"] + self.client.statistics["stale_bytes"]

    def asking(self, asked: Callable[[Ask, float], Reply]) -> ServoLink:
        """The same registers, asked for in another way: one that is not patient."""
        one = copy(self)
        one._asked = asked
        return one

    def in_one_go(self, do: Callable[[ServoLink], None]) -> None:
        """Do this where each answer comes at once; else all of it anew, three times at most.

        A servo that starts anew is silent meanwhile: so what it has told before still holds.
        """
        one = self.asking(self.client.asked)
        for left in reversed(range(ATTEMPTS)):
            try:
                do(one)
            except Fault as fault:
                if left == 0 or fault.code not in ("LINK_TIMEOUT", "LINK_REPLY"):
                    raise
                self.client.wait(self._timeout_s)  # an answer that is late must not be taken for another one
            else:
                return

    def value(self, name: str) -> int:
        """What a register holds."""
        register = self.model[name]
        ask = self.bus.reading(register.address, register.size, str(register))
        data = self._asked(ask, self._timeout_s).pdu[1:]
        try:
            return register.unpack(data)
        except ValueError as error:
            raise self.client.misfit(str(error)) from error

    def sure(self, name: str) -> int:
        """What a register holds, read twice: an answer does not tell its question, and a damaged one may pass.

        Raises Fault LINK_REPLY where the second time brings another value.
        """
        first, again = self.value(name), self.value(name)
        if first != again:
            raise self.client.misfit(f"{self.model[name]} reads {first}, then {again}")
        return first

    def one_answers(self, name: str | None, wait_s: float) -> bool:
        """Whether one answer, and nothing but that, comes to one question for a register, and ``wait_s`` after it.

        name  None: to a ping

        Raises Fault LINK_LOST, SERVO_REFUSED.
        """
        before, ask = self.client.statistics, self.bus.ping(self.bus.id)
        if name is not None:
            register = self.model[name]
            ask = self.bus.reading(register.address, register.size, str(register))
        try:
            self.client.asked(ask, self._timeout_s)
        except Fault as fault:
            if fault.code in ("LINK_LOST", REFUSAL):
                raise
        self.client.wait(wait_s)
        after = self.client.statistics
        return all(after[counted] == before[counted] for counted in ("stale_bytes", "bad_replies"))

    def put(self, name: str, value: int) -> None:
        """Write a register; the reply confirms it."""
        self._asked(self.write_of(name, value), self._timeout_s)

    def write_of(self, name: str, value: int) -> Ask:
        """The instruction that writes a register. Raises ValueError where it cannot hold the value."""
        register = self.model[name]
        return self.bus.writing(register.address, register.pack(value), str(register))

    def hold(self, name: str, value: int) -> bool:
        """Have a register hold a value: written only if it holds another, and read back. Whether it was written.

        EEPROM wears out. Raises Fault ARM_READBACK.
        """
        if self.value(name) == value:
            return False
        self.put(name, value)
        stored = self.value(name)
        if stored != value:
            raise Fault("ARM_READBACK", f"{self.model[name]}: sent {value}, stored {stored}")
        return True

    def is_there(self, id: int, patience_s: float = PING_S) -> tuple[int, ...] | None:
        """What a servo of that id answers when it is asked who it is, as bytes, its model's number first; None: none.

        patience_s   within which it begins to answer, s
        """
        own, self.bus.id = self.bus.id, id  # the answer must be from that one
        try:
            return tuple(self._pings.asked(self.bus.ping(id), patience_s + self.bus.wire_s(_PING_BYTES)).pdu[1:])
        except Fault as fault:
            if fault.code not in ("LINK_TIMEOUT", "LINK_REPLY", REFUSAL):
                raise
            return None
        finally:
            self.bus.id = own

    def value_of(self, id: int, name: str) -> int | None:
        """What a register of another servo of this model's kind holds; None where it does not answer so."""
        own, self.bus.id = self.bus.id, id
        try:
            return self.value(name)
        except Fault as fault:
            if fault.code == "LINK_LOST":
                raise
            return None
        finally:
            self.bus.id = own


def servo_link(transport: Transport, model: ServoModel, id: int, baud: int, timeout_s: float = 0.1) -> ServoLink:
    """The registers of one servo behind an open port, baud in bits per second, for commands."""
    bus = bus_of(model, id, baud)
    return ServoLink(transport, BusClient(transport, bus), bus, model, timeout_s)
