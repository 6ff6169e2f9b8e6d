"""How the lists of named mutants are written."""

from __future__ import annotations

from mutants.mutant import Mutant

# name, function, old, new, killers
Line = tuple[str, str, str, str, tuple[str, ...]]

_MATRIX = "tests/faults/test_faults_matrix.py::test_every_fault_ends_within_its_bound_with_its_code_and_no_sample_lost"


def of(path: str, *lines: Line) -> tuple[Mutant, ...]:
    """Mutants of one file."""
    return tuple(Mutant(name, path, function, old, new, killers) for name, function, old, new, killers in lines)


def in_file(path: str, *names: str) -> tuple[str, ...]:
    """Tests of one file."""
    return tuple(f"{path}::{name}" for name in names)


def row(name: str, device: str) -> tuple[str, ...]:
    """A row of the fault matrix on one device, as `make test` runs it."""
    return (f"{_MATRIX}[{name}-{device}]",)
