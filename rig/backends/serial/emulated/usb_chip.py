"""A USB adapter between a serial line and USB: it collects bytes and passes them on with the frames of USB.

Pure: the caller gives the time.
"""

from __future__ import annotations

import math

from rig.backends.emulated.under_way import UnderWay
from rig.backends.links.usb_adapters import CHIPS, FRAME_S, Adapter

_ROUNDING = 1e-6  # of a frame


class UsbChip:
    """One adapter, plugged in at time 0, at which its timer and the frames of USB begin.

    adapter  of ``rig.backends.links.usb_adapters.CHIPS``; KeyError for "none"
    """

    def __init__(self, adapter: Adapter) -> None:
        self._chip = CHIPS[adapter]
        self._kept = bytearray()  # from the device, not handed on yet
        self._kept_until_s = math.inf
        self._packet_s = 0.0  # when the last packet went
        self._to_host, self._to_device = UnderWay[bytes](), UnderWay[bytes]()

    def from_host(self, data: bytes, t_s: float) -> None:
        """The host has written ``data``."""
        self._to_device.send(data, _next_frame_s(t_s))

    def from_device(self, data: bytes, t_s: float) -> None:
        """The last bit of ``data`` has come over the line."""
        self._pass(t_s)
        self._kept += data
        if len(self._kept) >= self._chip.packet_bytes or self._chip.counted == "none":
            self._hand_on(t_s)
        elif self._chip.counted == "pause":
            self._kept_until_s = t_s + self._chip.wait_s
        elif not math.isfinite(self._kept_until_s):
            began_s = self._packet_s if self._chip.counted == "last packet" else 0.0
            ticks = math.floor((t_s - began_s) / self._chip.wait_s) + 1  # an empty packet begins the wait anew, too
            self._kept_until_s = began_s + ticks * self._chip.wait_s

    def next_s(self) -> float:
        """When something is due next; inf: nothing is on its way."""
        return min(self._kept_until_s, self._to_host.next_s(), self._to_device.next_s())

    def for_host(self, t_s: float) -> bytes:
        """What has reached the host by ``t_s``, and was not taken yet."""
        self._pass(t_s)
        return b"".join(self._to_host.arrived(t_s))

    def for_device(self, t_s: float) -> bytes:
        """What goes out on the line at ``t_s``."""
        return b"".join(self._to_device.arrived(t_s))

    def _pass(self, t_s: float) -> None:
        """Let the timer run."""
        if self._kept_until_s <= t_s:
            self._hand_on(self._kept_until_s)

    def _hand_on(self, t_s: float) -> None:
        self._to_host.send(bytes(self._kept), _next_frame_s(t_s))
        self._kept.clear()
        self._kept_until_s = math.inf
        self._packet_s = t_s


def _next_frame_s(t_s: float) -> float:
    return math.ceil(t_s / FRAME_S - _ROUNDING) * FRAME_S
