"""The plug of a device in virtual time, pulled out nothing passes any more; and to what such a device runs."""

from __future__ import annotations

from enum import IntEnum

from rig.core.faults import Fault


class Until(IntEnum):
    """To what a device runs: a time, or, before that, the next byte for the host or the end of a frame for it."""

    TIME = 0
    BYTE = 1
    FRAME = 2


class Plug:
    """A device's end of the cable, plugged in at first.

    device  what is unplugged, in the fault's words
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._is_plugged = True

    def close(self) -> None:
        """Close the port. The device lives on, and its clock with it. May be called twice."""
        self._is_plugged = False

    def unplug(self) -> None:
        """Pull the cable: reading and writing fail from now on."""
        self._is_plugged = False

    def _check_plug(self) -> None:
        """Raise Fault LINK_LOST when unplugged."""
        if not self._is_plugged:
            raise Fault("LINK_LOST", f"the {self._device} is unplugged")
