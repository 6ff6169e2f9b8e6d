"""A host that says what a test wants said, to emulated servos in virtual time."""

from __future__ import annotations

from typing import Any

from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.emulated.dynamixel_servo import DynamixelServo
from rig.backends.servo.emulated.feetech_servo import FeetechServo
from rig.backends.servo.emulated.servo import ServoOptions
from rig.backends.servo.emulated.virtual_bus import VirtualServoBus
from rig.backends.servo.models import MODELS, ServoModel

PATIENCE_S = 0.005  # of virtual time


class Host:
    """One that waits for each answer; ``options`` of the servo that it mostly speaks to, ``others`` beside it."""

    codec: Any
    default: str

    def __init__(self, *others: ServoOptions, bus: dict[str, Any] | None = None, **options: Any) -> None:
        options = {"model": self.default} | options
        self.options = ServoOptions(**options)
        self.bus = VirtualServoBus([self.options, *others], **(bus or {}))
        self.model: ServoModel = MODELS[self.options.model]
        self.id = self.options.id
        self._stream = self.codec.Stream()

    def ask(self, data: bytes) -> list[Any]:
        """All that comes back: packets, and bytes that are none."""
        self.bus.write(data)
        out: list[Any] = []
        while arrived := self.bus.read(PATIENCE_S):
            out += self._stream.feed(arrived)
        out += self._stream.flush()
        return out

    def status(self, data: bytes) -> Any:
        """The one answer."""
        (frame,) = self.ask(data)
        return self.codec.status_of(frame)

    def write(self, name: str, value: int, id: int | None = None) -> Any:
        register = self.model[name]
        return self.status(self.codec.write(self.id if id is None else id, register.address, register.pack(value)))

    def read(self, name: str, id: int | None = None) -> int:
        register = self.model[name]
        return register.unpack(
            self.status(self.codec.read(self.id if id is None else id, register.address, register.size)).data
        )

    def sleep(self, s: float) -> None:
        self.bus.sleep_until(self.bus.now_s() + s)

    @property
    def truth(self) -> Any:
        return self.bus.truth(self.id)

    @property
    def violations(self) -> list[str]:
        return [violation.what for violation in self.bus.bus.violations]


class DynamixelHost(Host):
    codec = dynamixel
    default = "xl330-m288"

    @property
    def servo(self) -> DynamixelServo:
        servo = self.bus.bus.servo(self.id)
        assert isinstance(servo, DynamixelServo)
        return servo

    def ready(self, duty: int = 0) -> None:
        """In PWM mode, torque on, with this duty."""
        self.write("operating_mode", 16)
        self.write("goal_pwm", 0)
        self.write("torque_enable", 1)
        self.write("goal_pwm", duty)


class FeetechHost(Host):
    codec = feetech
    default = "sts3215"

    @property
    def servo(self) -> FeetechServo:
        servo = self.bus.bus.servo(self.id)
        assert isinstance(servo, FeetechServo)
        return servo

    def ready(self, duty: int = 0) -> None:
        """In PWM mode, torque on, with this duty."""
        self.write("mode", 2)
        self.write("goal_duty", 0)
        self.write("torque_enable", 1)
        self.write("goal_duty", duty)
