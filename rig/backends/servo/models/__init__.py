"""The servos that rig knows, one table of registers a family."""

from __future__ import annotations

from collections.abc import Mapping

from rig.backends.servo.models import mx, sts, x330, xl430, xm_xh, xw
from rig.backends.servo.models.model import Protocol as Protocol
from rig.backends.servo.models.model import ServoModel as ServoModel
from rig.backends.servo.models.register import Register as Register

MODELS: Mapping[str, ServoModel] = {
    model.name: model for room in (x330, xl430, xm_xh, xw, mx, sts) for model in room.MODELS
}


def models_of(number: int, protocol: Protocol) -> list[ServoModel]:
    """The models of that number, which a ping or the register model_number tells; none: rig does not know it."""
    return [model for model in MODELS.values() if model.number == number and model.protocol == protocol]
