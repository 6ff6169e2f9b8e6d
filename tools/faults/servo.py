"""A servo on its emulated bus, as fault injection looks at it: its wire, and what is done to it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple
from unittest.mock import patch

from faults.language import Reading
from rig.backends.registers.bus import Damaged
from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.before import BeforeStore
from rig.backends.servo.bus import Bus, bus_of
from rig.backends.servo.driver import ServoDriver
from rig.backends.servo.emulated.virtual_bus import VirtualServoBus
from rig.backends.servo.models import ServoModel
from rig.backends.servo.packets import Instruction, Skipped
from rig.backends.servo.registers import servo_map
from rig.core.signals import Sample

if TYPE_CHECKING:
    from faults.injector import FaultInjector

_JUMP_RAD = 0.5 * math.pi  # of a sensor that jumps
_STRANGER = 9  # whom another master asks
_TALKS_S = 0.0073  # apart, so that it meets every part of a tick


class ServoTruth(NamedTuple):
    """As ``Truth`` of the injector; the pin is the motor's voltage."""

    t_s: float
    pin_V: float
    y_rad: float
    v_rad_per_s: float
    pin_changed_s: float


class InjectableServo:
    """A virtual bus with one servo, as the injector looks at a device.

    store  what keeps the registers of before from run to run, as the file of a real servo does
    """

    def __init__(self, bus: VirtualServoBus) -> None:
        self._bus = bus
        self._servo = bus.bus.servos[0]
        self._offset_rad = self._servo.bench.parameters.offset_rad
        self.store = BeforeStore()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bus, name)

    def truth(self) -> ServoTruth:
        """What is really the case."""
        truth = self._servo.truth()
        return ServoTruth(self._bus.now_s(), truth.motor_V, truth.y_rad, truth.v_rad_per_s, self._bus.outputs[0][-1][0])

    def reset(self, cause: int) -> None:
        """Its supply fails for a moment: it has no reset input."""
        self._servo.power_cycle()

    def place(self, y_rad: float, v_rad_per_s: float = 0.0) -> None:
        """Put the shaft somewhere, as a hand would."""
        self._servo.place(y_rad, v_rad_per_s)

    def rewire(self, *, drive: str = "ok", sensor: str = "ok") -> None:
        """Change the wiring, from now on; a sensor that jumps reads a quarter of a turn more."""
        jumped = sensor == "jumped"
        offset_rad = self._offset_rad + (_JUMP_RAD if jumped else 0.0)
        self._servo.rewire(drive=drive, sensor="ok" if jumped else sensor, offset_rad=offset_rad, fault_after_s=0.0)

    def another_master(self) -> None:
        """Somebody else on the bus asks for a servo that is not there."""
        model = self._servo.model
        position, stranger = model.role("position"), bus_of(model, _STRANGER, self._servo.options.baud)
        asks = stranger.reading(position.address, position.size, "").data
        self._bus.bus.another_master(asks, self._bus.now_s())

    def forget(self) -> None:
        """Drop the log of packets and all but the last of the output's changes, which the bus keeps."""
        self._bus.bus.log.clear()
        del self._bus.outputs[0][:-1]


def talk(injector: FaultInjector) -> None:
    """Another master talks on the bus from now on."""
    last_s = [-math.inf]

    def again() -> None:
        if injector.now_s() - last_s[0] >= _TALKS_S:
            last_s[0] = injector.now_s()
            injector.device.another_master()

    injector.push = again


class ServoLanguage:
    """Both protocols. Which reading is a sample, and which duty of 0 a stop, the frames do not say: the driver tells.

    bus         to the servo
    unit_V      what a step of the duty is
    zero_counts register of the position at 0 counts of the recording
    key         of the sample that the driver is about to ask for; None: what it reads is none
    is_stopping a duty of 0 is a stop
    """

    def __init__(self, model: ServoModel, bus: Bus, unit_V: float, zero_counts: int) -> None:
        self.key: int | None = None
        self.is_stopping = False
        self._unit_V = unit_V
        self._zero_counts = zero_counts
        self._drive, self._torque = model.role("drive"), model.role("torque")
        read = servo_map(model).read
        self._bus, self._read = bus, bus.reading(read.address, read.words, "")
        self._is_dynamixel = model.protocol == "dynamixel"
        self._position = model.role("position")
        self._at = self._position.address - read.address
        self._asked = 0

    def replies(self, data: bytes) -> list[bytes]:
        """What arrives is whole."""
        return [data] if data else []

    def to_come_s(self) -> float:
        """None: what arrives is whole."""
        return 0.0

    def asked(self, request: bytes) -> int | None:
        """The read of all that a tick needs, where the driver asks for a sample."""
        if self.key is None or request != self._read.data:
            return None
        self._asked = self.key
        return self.key

    def drive_V(self, request: bytes) -> float | None:
        """The duty; torque off is 0 V."""
        written = self._written(request)
        if written is None:
            return None
        address, data = written
        if address == self._drive.address:
            return self._drive.unpack(data) * self._unit_V
        return 0.0 if address == self._torque.address and data == b"\0" else None

    def is_stop(self, request: bytes) -> bool:
        """Torque off; a duty of 0 where the driver stops."""
        written = self._written(request)
        if written is None or any(written[1]):
            return False
        return written[0] == self._torque.address or (self.is_stopping and written[0] == self._drive.address)

    def is_arm(self, request: bytes) -> bool:
        """Torque on."""
        return self._written(request) == (self._torque.address, b"\1")

    def hands_over(self, request: bytes) -> bool:
        """Never."""
        return False

    def readings(self, reply: bytes) -> list[Reading]:
        """A status with as many bytes as a sample's."""
        try:
            answer = self._bus.answer(reply)
        except Damaged:
            return []
        if answer is None or len(answer.pdu) != 1 + (self._read.replies or 0):
            return []
        at = 1 + self._at
        counts = self._position.unpack(answer.pdu[at : at + self._position.size]) - self._zero_counts
        return [Reading(self._asked, counts, reply)]

    def _written(self, request: bytes) -> tuple[int, bytes] | None:
        """Address and data of a write; None of anything else."""
        found = (dynamixel.Stream() if self._is_dynamixel else feetech.Stream()).feed(request)
        if not found or isinstance(found[0], Skipped):
            return None
        _, instruction, parameters = found[0]
        address_bytes = 2 if self._is_dynamixel else 1
        if instruction != Instruction.WRITE:
            return None
        return int.from_bytes(parameters[:address_bytes], "little"), parameters[address_bytes:]


@contextmanager
def told_by_driver(injector: FaultInjector) -> Iterator[None]:
    """The driver tells the language what it asks for, and keeps the values of before as with a real servo."""
    language, store = injector.language, injector.device.store
    assert isinstance(language, ServoLanguage)
    read: Callable[[ServoDriver], Sample] = ServoDriver.read
    safe_stop: Callable[[ServoDriver], bool] = ServoDriver.safe_stop

    def reading(driver: ServoDriver) -> Sample:
        language.key = driver._seq + 1
        try:
            return read(driver)
        finally:
            language.key = None

    def stopping(driver: ServoDriver) -> bool:
        language.is_stopping = True
        try:
            return safe_stop(driver)
        finally:
            language.is_stopping = False

    with (
        patch.object(ServoDriver, "read", reading),
        patch.object(ServoDriver, "safe_stop", stopping),
        patch("rig.backends.servo.line.BeforeStore", lambda: store),
    ):
        yield
