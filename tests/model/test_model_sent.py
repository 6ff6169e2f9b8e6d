"""A motor that has moved can be sent to another process."""

from __future__ import annotations

import pickle

from rig.model.friction import Friction
from rig.model.motor import Motor, State


def test_a_motor_that_has_moved_is_sent_as_it_is() -> None:
    motor = Motor(0.17, 6.5, Friction(0.5, 0.46, 0.54, 0.5), 0.01)
    moved = motor.advance(State(), 3.0, 0.1)
    sent = pickle.loads(pickle.dumps(motor))
    assert sent == motor and sent.advance(State(), 3.0, 0.1) == moved
