"""The keys of section ``daq`` that only a serial device has."""

from __future__ import annotations

from pydantic import Field

from rig.backends.links.usb_adapters import Adapter
from rig.core.section import Section


class SerialKeys(Section):
    """What the line of a serial device goes through."""

    adapter: Adapter | None = Field(
        None,
        description="driver serial: what sits between USB and the line, and delays every reply (docs/timing.md); "
        "`rig doctor` finds it. Default: what the port's name gives away, else `ftdi`, the slowest; an emulated port "
        "has none, unless it is given here: then it delays like that one",
    )
