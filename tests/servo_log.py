"""A log that a servo's own position loop made: an emulated XL330 holds goals that jump, logged each 10 ms."""

from __future__ import annotations

import numpy as np

from rig.backends.servo.emulated.dynamixel_servo import DynamixelServo
from rig.backends.servo.emulated.servo import ServoOptions

PERIOD_S, P, SLEW_V_S = 0.01, 400, 140 * 1.977
COUNT_RAD = 2.0 * np.pi / 4096


def rows(divisor: float, seconds: float = 6.0, seed: int = 3) -> list[tuple[float, int, int, float]]:
    """Time, s, position and goal, counts, voltage, V; each goal is written after its row's position was read."""
    servo = DynamixelServo(ServoOptions(p_divisor=divisor, registers={"position_p_gain": P}), lambda _: None)
    for name, value in {"operating_mode": 3, "goal_pwm": 885, "position_p_gain": P}.items():
        servo.put(name, value)
    servo._switch(1)
    random, goal, found = np.random.default_rng(seed), 2048, []
    for k in range(round(seconds / PERIOD_S)):
        servo.advance_to(k * PERIOD_S)
        position = int.from_bytes(servo.peek(132, 4), "little")
        if k % 25 == 0:
            goal = 2048 + int(random.integers(-220, 221))
        found.append((k * PERIOD_S, position, goal, 5.0))
        servo.put("goal_position", goal)
    return found
