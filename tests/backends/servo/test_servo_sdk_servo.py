"""Our codecs as the host of a servo whose packets its maker's package makes."""

from __future__ import annotations

from typing import Any

import further_requests
import pytest
from sdk_servo import K_RAD_S_V, SdkServo

from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.models import MODELS
from rig.backends.servo.packets import Skipped
from rig.backends.servo.registers import servo_map

KINDS = {"dynamixel": (dynamixel, MODELS["xl330-m288"], 16), "feetech": (feetech, MODELS["sts3215"], 2)}


@pytest.mark.parametrize("protocol", KINDS)
def test_a_duty_and_what_comes_of_it(protocol: str) -> None:
    codec: Any
    codec, model, pwm_mode = KINDS[protocol]
    servo, stream = SdkServo(protocol), codec.Stream()

    def ask(data: bytes) -> list[Any]:
        servo.write(data)
        taken = stream.feed(servo.read(0.05))
        assert not any(isinstance(t, Skipped) for t in taken)
        return [codec.status_of(frame) for frame in taken]

    def write(role: str, value: int) -> None:
        register = model.role(role)
        (status,) = ask(codec.write(1, register.address, register.pack(value)))
        assert status.data == b""

    (pong,) = ask(codec.ping(1))
    assert pong.id == 1 and ask(codec.ping(2)) == []
    number = model["model_number"]
    (status,) = ask(codec.read(1, number.address, number.size))
    assert number.unpack(status.data) == model.number
    write("mode", pwm_mode)
    for role, value in (("drive", 0), ("torque", 1)):
        write(role, value)
    duty = round(0.4 * model.full_drive)
    drive, read = model.role("drive"), servo_map(model).read
    for _ in range(100):
        both = further_requests.sync_write(codec, drive.address, {1: drive.pack(-duty)}) + codec.read(
            1, read.address, read.words
        )
        (status,) = ask(both)
        servo.sleep_until(servo.now_s() + 0.01)
    values = model.unpack(status.data, read.address)
    assert values[model.roles["applied"]] == -duty and values[model.roles["voltage"]] == 50
    speed = values[model.roles["velocity"]] * model.role("velocity").scale
    assert speed == pytest.approx(-K_RAD_S_V * (0.4 * servo.supply_V - 0.1), rel=0.02)
    write("torque", 0)
    servo.sleep_until(servo.now_s() + 0.01)
    assert servo.duty == 0.0 and not servo.has_driven_unasked
