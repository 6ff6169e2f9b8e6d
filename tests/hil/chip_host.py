"""A host for tests of the Uno's emulated chip: as ``virtual_host``, with a wire of 10 bits a byte."""

from __future__ import annotations

from dataclasses import replace
from typing import TypedDict, TypeVar, Unpack

from virtual_host import BENCH, HELD, SETUP, Host, Wired

from emulated_chips.truth import UnoTruth
from emulated_chips.virtual_chip import VirtualChip
from rig.backends.serial.emulated.firmware_build import PLAIN_VARIANT, Variant
from rig.backends.serial.frames import Code, Kind, Setup, pack_drive
from rig.model.bench import BenchParameters

SETUP = SETUP._replace(max_drive=200)  # of 400
QUIET = replace(BENCH, noise_rad=0.0)
SETTLE_S = 0.4e-3  # from a frame's last bit until the program has acted on it, at most
START_S = 2e-3  # from power on until the program listens


Chip = TypeVar("Chip", bound=Wired)


class UnoHost(Host[Chip]):
    """Frames to and from one emulated chip, whichever emulates it."""

    def __init__(self, board: Chip, baud: int = 115200) -> None:
        super().__init__(board)
        self._byte_s = round(10e9 / baud) * 1e-9
        self.wait(START_S)

    def send_raw(self, data: bytes) -> None:
        self.heard_s = max(self.heard_s, self.board.now_s()) + len(data) * self._byte_s
        self.board.write(data)

    def drive(self, units: int) -> None:
        """Send a drive, and wait until the program has acted on it."""
        self.send(Kind.DRIVE, pack_drive(units))
        self.board.sleep_until(self.heard_s + SETTLE_S)


class ChipHost(UnoHost[VirtualChip]):
    """Frames to and from one emulated chip."""

    def truth(self) -> UnoTruth:
        return self.board.truth()


class ChipOptions(TypedDict, total=False):
    """What an emulated chip is made with besides its bench and its firmware."""

    seed: int
    clock_error_ppm: float
    dead_time_s: float
    measure: bool


def armed_chip(
    bench: BenchParameters = BENCH, setup: Setup = SETUP, options: Variant = PLAIN_VARIANT, **board: Unpack[ChipOptions]
) -> ChipHost:
    host = ChipHost(VirtualChip(bench, options=options, **board), options.baud)
    host.acknowledge(Code.RESET)
    host.setup(setup)
    assert host.arm() == Code.NONE
    return host


__all__ = ["BENCH", "HELD", "QUIET", "SETTLE_S", "SETUP", "ChipHost", "UnoHost", "armed_chip"]
