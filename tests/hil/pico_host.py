"""A host for tests of the Pico's emulated chip: as ``chip_host`` of the Uno's, with 12 bits and 6250 units."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import chip_host
import virtual_host
from chip_host import SETTLE_S, START_S, UnoHost
from idle_node import IdleNode

from emulated_chips.pico_parameters import pico_parameters
from emulated_chips.truth import ChipTruth
from emulated_chips.virtual_pico import VirtualPico
from rig.backends.serial.emulated.firmware_build import PLAIN_VARIANT, Variant
from rig.backends.serial.frames import Code, Setup
from rig.model.bench import BenchParameters

PICO_FULL = 6250
UNIT_V = 12.0 / PICO_FULL
SCALE = 4  # counts for one of the Uno's


def twelve_bits(bench: BenchParameters) -> BenchParameters:
    """The same bench behind a converter of 12 bits."""
    tachometer = bench.tachometer_rad_s_per_count
    return replace(
        bench,
        counts_max=4095,
        rad_per_count=bench.rad_per_count / SCALE,
        centre_counts=SCALE * bench.centre_counts,
        tachometer_rad_s_per_count=None if tachometer is None else tachometer / SCALE,
        tachometer_zero_counts=SCALE * bench.tachometer_zero_counts,
    )


BENCH, HELD, QUIET = (twelve_bits(bench) for bench in (virtual_host.BENCH, virtual_host.HELD, chip_host.QUIET))
SETUP = virtual_host.SETUP._replace(
    hard_lo=196, hard_hi=3900, rail_lo=20, rail_hi=4072, centre=2048, max_drive=PICO_FULL // 2
)
LSB_RAD = BENCH.rad_per_count
_IDLE = IdleNode()


class PicoHost(UnoHost[VirtualPico]):
    """Frames to and from one emulated Pico."""

    def truth(self) -> ChipTruth:
        return self.board.truth()


@contextmanager
def pico(bench: BenchParameters = BENCH, options: Variant = PLAIN_VARIANT, **emulator: Any) -> Iterator[PicoHost]:
    """A chip that has just been powered on."""
    parameters = pico_parameters(bench, options=options, **emulator)
    board = VirtualPico(parameters, _IDLE.take())
    try:
        yield PicoHost(board, options.baud)
    finally:
        _IDLE.keep(board.leave())


@contextmanager
def armed_pico(
    bench: BenchParameters = BENCH, setup: Setup = SETUP, options: Variant = PLAIN_VARIANT
) -> Iterator[PicoHost]:
    with pico(bench, options) as host:
        host.acknowledge(Code.RESET)
        host.setup(setup)
        assert host.arm() == Code.NONE
        yield host


def arm_anew(host: PicoHost, setup: Setup = SETUP) -> None:
    """After a fault, or a reset, which it must have named."""
    host.board.place(0.0)
    host.setup(setup)
    assert host.arm_anew() == Code.NONE


__all__ = ["BENCH", "HELD", "LSB_RAD", "QUIET", "SETTLE_S", "SETUP", "START_S", "PicoHost", "armed_pico", "pico"]
