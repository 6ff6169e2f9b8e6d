"""What one tick of a serial device needs: the frames of the wire format, and what the USB adapter adds.

Beside it what a reading alone needs: that is what can be measured of a device that is not armed.
"""

from __future__ import annotations

from rig.backends.link_budget import LinkBudget, wire_term, wire_words
from rig.backends.links.usb_adapters import CHIPS, FRAME_S, Adapter, adapter_delay_s
from rig.backends.serial.ports import adapter_of
from rig.config.schema import DeviceSetup

REPLY_SHARE = 2 / 3  # of daq.timeout_s, after which the driver asks for a reading again
STAMPS_S = 1e-4  # a device's own times: a conversion (0.11 ms), a period of the PWM (0.05 ms), an interrupt

# Wire format version 2: bytes of the body of each frame of one tick (host asks, device tells, host drives)
_BODY_BYTES = {"READ": 0, "STATE": 24, "DRIVE": 2}
# around each body: version, type, seq (4), CRC (2), COBS (1), delimiter (1)
_FRAME_BYTES = 4 + 2 + 1 + 1
_BITS_PER_BYTE = 11  # start, 8 data, stop, and the pause that is seen between bytes
_TURNAROUND_S = 0.001  # the device's 1 ms tick

# A relay in the device: every 10 of its 1 ms ticks a BLOCK of 10 (reading, drive) comes unasked
_BLOCK_BYTES = 18 + 10 * 4 + _FRAME_BYTES
_BLOCK_S = 0.010


def tick_budget(d: DeviceSetup, baud: int | None = None, adapter: Adapter | None = None) -> LinkBudget:
    """What one tick needs.

    baud, adapter   instead of the config's, to see which would do
    """
    baud = d.daq.baud if baud is None else baud
    return _sum(tuple(_BODY_BYTES), baud, adapter_of(d) if adapter is None else adapter)


def reading_budget(d: DeviceSetup) -> LinkBudget:
    """What one reading of a device that is not armed needs, until its reply is there."""
    return _sum(("READ", "STATE"), d.daq.baud, adapter_of(d))


def sample_to_drive_s(d: DeviceSetup) -> float:
    """From a sample to the drive that answers it, at most, s, where the exchange fits.

    The reply's way to the host, the drive's way back, and a tick of the device. The host's own part is in none of it.
    """
    asking_s = (_BODY_BYTES["READ"] + _FRAME_BYTES) * _BITS_PER_BYTE / d.daq.baud
    return tick_budget(d).total_s - asking_s


def reply_delay_s(d: DeviceSetup) -> float:
    """By how much the adapter makes an exchange longer, at most, s; 0 without one."""
    return adapter_delay_s(adapter_of(d))


def block_share(baud: int) -> float:
    """Share of the time for which the samples of a relay in the device are on the wire."""
    return _BLOCK_BYTES * _BITS_PER_BYTE / baud / _BLOCK_S


def block_sum(baud: int) -> str:
    """How long a block of these samples is on the wire, for people."""
    wire_ms, every_ms = 1e3 * block_share(baud) * _BLOCK_S, 1e3 * _BLOCK_S
    return (
        f"BLOCK {_BLOCK_BYTES} bytes x {_BITS_PER_BYTE} bits / {baud} baud = {wire_ms:.2f} ms of every {every_ms:g} ms"
    )


def _sum(kinds: tuple[str, ...], baud: int, adapter: Adapter) -> LinkBudget:
    """Of frames of these kinds."""
    frames = {name: _BODY_BYTES[name] + _FRAME_BYTES for name in kinds}
    terms = [wire_term(frames, _BITS_PER_BYTE, baud), ("turnaround", _TURNAROUND_S)]
    chip = CHIPS.get(adapter)
    if chip is not None:
        terms += [("USB frames", 2.0 * FRAME_S), (f"{adapter} adapter", chip.wait_s)]
    return LinkBudget(tuple(terms), wire_words(frames, _BITS_PER_BYTE, baud))
