"""The section ``daq.servo``: which servo on the bus, and what rig may do with it."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, field_validator

from rig.backends.links.usb_adapters import Adapter
from rig.backends.servo.models import MODELS, ServoModel
from rig.core.section import Section

EMULATED_PORTS = ("emulated", "emulated-realtime")


def _in_words(switch: str) -> str:
    if not re.search(r"\w\w", switch):
        raise ValueError("say which switch it is, such as: the red one")
    return switch


class Servo(Section):
    """Which servo on the bus, and what rig may do with it."""

    model: str = Field(description="as `rig servo scan` prints it", examples=["xl330-m288", "sts3215"])
    id: Annotated[int, Field(ge=0, le=252)] = Field(1, description="of the servo on its bus")
    pwm_slope: Literal["fastest", "leave"] = Field(
        "leave", description="of a 330 servo, which ramps its duty: `leave`, or `fastest`, put back at the end"
    )
    on_stop: Literal["brake", "coast"] = Field(
        "brake", description="brake: duty 0 until the shaft rests, then torque off; coast: torque off at once"
    )
    hot_degC: Annotated[int, Field(ge=30, le=80)] = Field(60, description="from here on rig drives no more")
    attached: Literal["nothing", "load", "joint"] = Field(
        "nothing", description="to the horn: nothing; a load that reaches no stop and no hand; or a joint with stops"
    )
    supply_switch: Annotated[str, Field(max_length=60), AfterValidator(_in_words)] | None = Field(
        None, description="the switch in the servo's supply, in your words: rig has you try it"
    )
    adapter: Adapter | None = Field(None, description="between USB and the bus; default: by the port's name")

    @field_validator("model")
    @classmethod
    def _known(cls, model: str) -> str:
        if model not in MODELS:
            raise ValueError(f"no servo {model!r} that rig knows: {', '.join(MODELS)}")
        return model

    @property
    def table(self) -> ServoModel:
        """Its registers."""
        return MODELS[self.model]


class ServoKeys(Section):
    """The keys of section ``daq`` that only a servo has."""

    servo: Servo | None = Field(None, description="driver servo: which servo on the bus")
