"""The named mutants, by room."""

from __future__ import annotations

from mutants.mutant import Mutant
from mutants.named import board, control, core, drivers, loop, recording

ROOMS: dict[str, tuple[Mutant, ...]] = {
    "guard, motion check, breakaway, gain search": control.MUTANTS,
    "loop, and between config and bench": loop.MUTANTS,
    "drivers": drivers.MUTANTS,
    "recorder and reader": recording.MUTANTS,
    "the firmware's core": core.MUTANTS,
    "the board layers": board.MUTANTS,
}
NAMED: tuple[Mutant, ...] = tuple(mutant for mutants in ROOMS.values() for mutant in mutants)
