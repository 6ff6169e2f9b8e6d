"""The one table of what sits between USB and a serial line, and how long it keeps what a device has sent.

A chip hands a short reply on only when its timer says so; USB at full speed passes data once a millisecond, either way.
Where the figures come from: docs/timing.md, "USB adapters".
"""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import Literal, NamedTuple

Adapter = Literal["16u2", "ftdi", "ftdi-1ms", "ch340", "cp210x", "native-usb", "none"]

FRAME_S = 0.001  # of USB at full speed


class Chip(NamedTuple):
    """One kind of adapter.

    words         what it is, for people
    wait_s        longest that a byte waits in it for others
    counted       from when its timer runs: "freely", whatever comes; from the "last packet" that it sent; from the last
                  byte, a "pause" on the line; "none": it hands on at once
    packet_bytes  with so many it waits no longer
    assumed       nobody says how long it waits: ``wait_s`` is a guess on the safe side
    """

    words: str
    wait_s: float
    counted: Literal["freely", "last packet", "pause", "none"]
    packet_bytes: int
    assumed: bool = False


CHIPS: dict[Adapter, Chip] = {
    "16u2": Chip("the ATmega16U2 of an Arduino Uno or Mega", 256 * 256 / 16e6, "freely", 97),
    "ftdi": Chip("an FTDI chip as it comes", 0.016, "last packet", 62),
    "ftdi-1ms": Chip("an FTDI chip with its latency timer at 1 ms", 0.001, "last packet", 62),
    "ch340": Chip("a CH340 or CH341", 0.001, "pause", 32, assumed=True),
    "cp210x": Chip("a CP2102 or another CP210x", 0.001, "pause", 64, assumed=True),
    "native-usb": Chip("a controller with USB of its own", 0.0, "none", 64),
}  # "none" is not among them: a port without USB, and the emulated ones unless they are told

_SLOWEST: Adapter = "ftdi"

_VENDORS: dict[int, Adapter] = {0x0403: "ftdi", 0x10C4: "cp210x"}
_PRODUCTS: dict[tuple[int, int], Adapter] = {
    **{(0x1A86, product): "ch340" for product in (0x5523, 0x7522, 0x7523)},
    # Uno and Mega 2560, first and third revision, of both vendors of that name
    **{(vendor, product): "16u2" for vendor in (0x2341, 0x2A03) for product in (0x0001, 0x0010, 0x0042, 0x0043)},
    # Leonardo and Micro, of both
    **{(vendor, product): "native-usb" for vendor in (0x2341, 0x2A03) for product in (0x8036, 0x8037)},
    (0x16C0, 0x0483): "native-usb",  # Teensy
    (0x2E8A, 0x000A): "native-usb",  # Pico
}

# Names that the kernel gives, whole: any other may be a link to anything
_KERNEL_NAMES: tuple[tuple[str, Adapter], ...] = (
    (r"ttyACM[0-9]+", "16u2"),  # or native USB, which is quicker
    (r"ttyAMA[0-9]+", "none"),
    (r"ttyS[0-9]+", "none"),
)
# Names that udev makes of what a USB device says of itself: vendor, product, number
_BY_ID = "/dev/serial/by-id"
_ID_NAMES: tuple[tuple[str, Adapter], ...] = (
    (r"usb-FTDI_.+", "ftdi"),
    (r"usb-1a86_.+", "ch340"),
    (r"usb-Silicon_Labs_.+", "cp210x"),
    (r"usb-Arduino_.+", "16u2"),
)


def adapter_by_id(vendor: int | None, product: int | None) -> Adapter | None:
    """The adapter of these USB ids; None where they say nothing. An FTDI's timer has to be asked for besides."""
    if vendor is None or product is None:
        return None
    return _PRODUCTS.get((vendor, product)) or _VENDORS.get(vendor)


def adapter_by_name(port: str) -> Adapter:
    """The adapter that rig assumes behind a port of that name: the one that the name tells, else the slowest."""
    path = PurePosixPath(port)
    names = _ID_NAMES if str(path.parent) == _BY_ID else _KERNEL_NAMES
    return next((adapter for name, adapter in names if re.fullmatch(name, path.name)), _SLOWEST)


def adapter_delay_s(adapter: Adapter) -> float:
    """By how much an adapter makes an exchange longer, at most: the frames of both ways, and its wait, s."""
    chip = CHIPS.get(adapter)
    return 0.0 if chip is None else 2.0 * FRAME_S + chip.wait_s
