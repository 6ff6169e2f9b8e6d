"""What is true of an emulated chip, besides what it says on the wire."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rig.backends.serial.emulated.virtual_device import Truth

Contact = Literal["e_stop", "end_low", "end_high"]


@dataclass(frozen=True)
class ChipTruth(Truth):
    """The true state of the chip, its pins and the bench.

    awake_share  share of the time in which the program did not sleep
    masked_us    longest time with interrupts masked; of the Uno all of masks, ticks and shares is 0 without ``measure``
    tick_us      longest control tick, without the interrupts that come between
    led          is lit: armed, or blinking
    resets       of any cause, since power on
    overruns     bytes that the chip's receiver had no room for
    """

    awake_share: float
    masked_us: float
    tick_us: float
    led: bool
    resets: int
    overruns: int


@dataclass(frozen=True)
class UnoTruth(ChipTruth):
    """Of the Uno's chip.

    interrupt_share  largest share of a tick spent in interrupts
    timed_share      the same without the serial port's interrupts
    crashed          the program ended, or left its code
    stack_bytes      greatest depth of the stack
    """

    interrupt_share: float
    timed_share: float
    crashed: bool
    stack_bytes: int
