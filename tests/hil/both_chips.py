"""The two emulated chips, for what holds of both: each with its bench, its numbers, and how finely it is tried."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any

import chip_host
import pico_host
from chip_host import ChipHost
from pico_host import PicoHost

from emulated_chips.virtual_chip import VirtualChip
from rig.backends.serial.emulated.firmware_build import PLAIN_VARIANT, Variant
from rig.backends.serial.frames import Code, Setup
from rig.model.bench import BenchParameters

Powered = Callable[..., AbstractContextManager[ChipHost | PicoHost]]


@dataclass(frozen=True)
class Chip:
    """One of them.

    powered   on, with a bench, a variant, and what else its emulator takes
    id        of the board, in HELLO
    full      units of full duty
    scale     counts for one of the Uno's
    stamp_s   how exact it says when the drive at its pins changed
    drive     units of 1.8 V
    phases    how many random phases are tried, resets by its watchdog aside
    resets    how many of these
    hang_s    from when it hangs until the pins are at 0, at most
    e_stop_s  from when the contact opens until the pins are at 0, at most
    damaged   how many damaged frames it is sent
    """

    name: str
    powered: Powered
    setup: Setup
    id: int
    full: int
    scale: int
    stamp_s: float
    drive: int
    phases: int
    resets: int
    hang_s: float
    e_stop_s: float
    damaged: int

    @contextmanager
    def armed(
        self, bench: BenchParameters, options: Variant = PLAIN_VARIANT, watchdog_ms: int = 100
    ) -> Iterator[ChipHost | PicoHost]:
        """As it drives; ``bench`` with the converter of the board that is compiled for the host."""
        with self.powered(bench, options) as host:
            host.acknowledge(Code.RESET)
            host.setup(self.setup._replace(watchdog_ms=watchdog_ms))
            assert host.arm() == Code.NONE
            yield host

    def arm_anew(self, host: ChipHost | PicoHost, watchdog_ms: int = 100) -> None:
        """After a fault, or a reset, which it must have named."""
        host.board.place(0.0)
        host.setup(self.setup._replace(watchdog_ms=watchdog_ms))
        assert host.arm_anew() == Code.NONE


@contextmanager
def _uno(bench: BenchParameters, options: Variant = PLAIN_VARIANT, **emulator: Any) -> Iterator[ChipHost]:
    yield ChipHost(VirtualChip(bench, options=options, **emulator), options.baud)


def _pico(
    bench: BenchParameters, options: Variant = PLAIN_VARIANT, **emulator: Any
) -> AbstractContextManager[PicoHost]:
    return pico_host.pico(bench if bench.encoder else pico_host.twelve_bits(bench), options, **emulator)


UNO = Chip("uno", _uno, chip_host.SETUP, 2, 400, 1, 30e-6, 60, 20, 20, 0.150, 30e-6, 150)
# its watchdog's 120 ms, and a tick; emulated more slowly, so that it is tried less often
PICO = Chip("pico", _pico, pico_host.SETUP, 3, pico_host.PICO_FULL, pico_host.SCALE, 10e-6, 940, 8, 2, 0.130, 3e-6, 90)


def name_of(value: object) -> str | None:
    """What a test's case is called by."""
    if isinstance(value, Variant):
        return f"{value.bridge}-{value.baud}"
    return value.name if isinstance(value, Chip) else None
