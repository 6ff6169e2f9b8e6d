"""The C library of the motor's physics: how it is compiled and loaded, and what it is given."""

from __future__ import annotations

import ctypes
import math
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from real_motors import CASES, FRAME, relay, with_parts

import motor_numbers
from rig.core.errors import LibraryError
from rig.core.motor_numbers import NUMBERS, PARTS
from rig.design import compiled as design
from rig.identification.noise import noise_of
from rig.model import library, library_build
from rig.model.compiled import coloured_noise, motion, real_motion, steady_cycle
from rig.model.library import LIBRARY
from rig.model.motor import Motor
from rig.model.real_motor import Frame, RealMotor, index
from rig.model.sampled_relay import Disturbance, relay_test
from rig.model.step import Plant, State
from shared import physics
from shared.pieces import Pieces, response_and_jacobian

C = library.CLONE
PLANT = (0.2, 5.0, 0.4, 0.4, 0.5, 0.5, 0.0, 0.0)


def fields(header: str, name: str) -> tuple[str, ...]:
    """Names of the fields of a struct of doubles."""
    bodies = re.findall(r"typedef struct \{([^}]*)\} (\w+);", (C / header).read_text(encoding="utf-8"))
    (body,) = [body for body, of in bodies if of == name]
    return tuple(re.findall(r"(\w+)(?=[,;])", body))


def test_the_list_of_a_motors_numbers_in_c_is_that_of_the_table() -> None:
    """If this fails: `python tools/motor_numbers.py`."""
    (found,) = motor_numbers.LIST.findall(motor_numbers.HEADER.read_text(encoding="utf-8"))
    assert found == motor_numbers.c_list()


def test_the_numbers_of_the_parts_in_the_theory_are_those_of_the_table() -> None:
    """A cell is like `e, V; v_s, rad/s`: symbols, then their unit."""
    page = (C.parents[1] / "docs" / "theory.md").read_text(encoding="utf-8")
    (rows,) = re.findall(r"^\| part \| numbers \| law \|\n\|---.*\n((?:\|.*\n)+)", page, re.MULTILINE)
    cells = dict(re.findall(r"^\| (.+?) \| (.+?) \|", rows, re.MULTILINE))
    titles = {
        "viscous friction by direction": "viscous_by_direction",
        "static friction": "static",
        "bristles": "bristle",
    }
    titles |= {"Stribeck effect": "stribeck", "resistance of the supply": "source"}
    listed = {titles.get(title, title.replace(" ", "_")): cell for title, cell in cells.items()}
    assert listed.keys() == PARTS.keys()
    for part, names in PARTS.items():
        by_unit: dict[str, list[str]] = {}
        for name in sorted(names, key=lambda name: NUMBERS[name].is_shape):
            by_unit.setdefault(NUMBERS[name].unit, []).append(NUMBERS[name].symbol)
        said = [[*symbols, unit if unit != "1" else ""] for unit, symbols in by_unit.items()]
        assert listed[part] == "; ".join(", ".join(filter(None, words)) for words in said)


def constant(header: str, name: str) -> int:
    (value,) = re.findall(rf"\b{name} = (\d+)", (C / header).read_text(encoding="utf-8"))
    return int(value)


def test_numbers_stand_in_the_same_order_on_both_sides() -> None:
    assert fields("real_motor.h", "real_motor") == Frame._fields  # behind the list of the numbers
    assert fields("real_motor.h", "real_state") == ("v", "y", "f", "w", "x")
    assert fields("plain_motor.h", "plain_motor") == Plant._fields
    assert fields("plain_motor.h", "plain_state") == State._fields
    assert constant("real_readings.h", "REAL_COLUMN_ROWS") == real_motion._COLUMN_ROWS
    assert constant("real_readings.h", "REAL_STAGE_ROWS") == real_motion._STAGE_ROWS
    assert constant("plain_motor.h", "SERIES_ORDER") == physics.ORDER
    assert constant("records.h", "TEST_WIDTH") == design.WIDTH
    assert constant("steady_cycle.h", "CYCLE_NUMBERS") == steady_cycle.NUMBERS


@pytest.mark.parametrize("source", library_build.SOURCES)
def test_it_allocates_nothing_and_keeps_nothing(source: str, tmp_path: Path) -> None:
    """All that it asks of its surroundings are functions of numbers; nothing that it has can be written to."""
    made = tmp_path / "one.o"
    options = [option for option in library_build.OPTIONS if option != "-shared"]
    # unoptimized: sooner, and nothing that stands in the source is left out
    subprocess.run([*library_build.compiler(), *options, "-O0", "-fPIC", "-c", C / source, "-o", made], check=True)
    listed = subprocess.run(["nm", made], check=True, capture_output=True, text=True).stdout
    symbols = [(words[-2], words[-1]) for words in map(str.split, listed.splitlines())]
    # what the linker fills in once, such as a table's addresses, is not written to by the library
    assert {name for kind, name in symbols if kind in "BbCD" or (kind == "d" and not name.startswith(".L"))} == set()
    ours = re.compile(r"^(plain|series|real|relay|test|noise|cycle)_\w+$")
    mathematics = {"exp", "expm1", "log", "log1p", "sin", "cos", "sincos", "pow", "sqrt", "floor", "fmin", "fmax"}
    mathematics |= {"copysign"}
    others = {name for kind, name in symbols if kind == "U" and not ours.match(name)} - mathematics
    assert others <= {"_GLOBAL_OFFSET_TABLE_", "memset", "memcpy", "__stack_chk_fail"}


def test_the_interpreters_lock_is_released() -> None:
    assert type(LIBRARY) is ctypes.CDLL  # a PyDLL would keep it


def test_fits_side_by_side_give_what_they_give_alone() -> None:
    edges, levels = relay(2.0)
    t_s = np.arange(0.0, 2.4, 0.01)

    def readings(names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
        free = [index(name) for name in ("tau_s", "K_rad_s_V", "fc_V", "delay_s")]
        found = response_and_jacobian(with_parts(*names), FRAME, (edges, levels), t_s, Pieces.one(), free)
        return found.y_rad, found.by_number

    alone = [readings(names) for names in CASES.values()]
    with ThreadPoolExecutor(4) as pool:
        for one, other in zip(alone, pool.map(readings, CASES.values()), strict=True):
            assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.fixture
def clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Another clone, in which nothing is compiled yet; a compiler that does not optimize is done sooner."""
    folder = tmp_path / "clone" / "firmware" / "motor"
    shutil.copytree(C, folder)
    monkeypatch.setattr(library_build, "OPTIONS", (*library_build.OPTIONS, "-O0"))
    monkeypatch.setattr(library, "CLONE", folder)
    monkeypatch.setattr(library, "FOLDER", tmp_path / "clone" / "rig")
    return folder


def test_a_clone_compiles_it_where_a_source_has_changed(clone: Path) -> None:
    built = library.library_file()
    assert built.parent == clone.parents[1] / "build" / "motor"
    first = built.stat()
    assert library.library_file() == built and built.stat().st_mtime_ns == first.st_mtime_ns  # not again
    seen = {built}
    for name in ("plain_motor.h", "real_motor.c"):  # a header, and a source that another one includes
        included = clone / name
        included.write_text(f"{included.read_text()}\n", encoding="utf-8")
        os.utime(included, ns=(0, 0))  # a copy that keeps the times of files: older than the library
        anew = library.library_file()
        assert anew not in seen
        seen.add(anew)
    assert ctypes.CDLL(str(anew)).plain_advance is not None
    assert set(built.parent.iterdir()) == seen


def test_a_source_that_does_not_compile_is_said_and_leaves_nothing(clone: Path) -> None:
    (clone / "records.c").write_text("not C\n", encoding="utf-8")
    with pytest.raises(LibraryError, match=r"compiling the motor's physics failed: .*\n(.*\n)*.*records.c:1"):
        library.library_file()
    assert list((clone.parents[1] / "build" / "motor").iterdir()) == []


def test_without_a_compiler_it_says_what_to_install(clone: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert library_build.compiler() == []
    with pytest.raises(LibraryError, match=r"there is no C compiler: install one .*pip install ziglang"):
        library.library_file()


def test_an_installed_rig_has_it_beside_the_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "CLONE", tmp_path / "nowhere")
    assert library.library_file() == Path(library.__file__).parent / library_build.NAME


def test_a_library_that_cannot_be_loaded_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "library_file", lambda: tmp_path / "nothing")
    with pytest.raises(LibraryError, match=r"cannot be loaded .*: install rig again"):
        library._loaded()


def test_arrays_that_do_not_fit_together_are_refused() -> None:
    """Of the library itself nobody could ask it: it would read beyond their ends."""
    one, two, rows = np.ones(1), np.ones(2), np.zeros(1, dtype=np.int64)
    calls: list[Callable[[], object]] = [
        lambda: motion.states(PLANT, (0.0, 0.0, 0.0), (two, one, 0.0), two),
        lambda: motion.positions(PLANT, (0.0, 0.0, 0.0), (np.empty(0), np.empty(0), 0.0), two),
        lambda: coloured_noise.deviances(one, rows, 1.0, two, two),
        lambda: coloured_noise.deviances(two, rows + 1, 1.0, two, two),
        lambda: relay_test(Motor(0.2, 5.0), 1.0, 1.0, np.arange(2.0), 0.0, disturbance=Disturbance(one)),
        lambda: steady_cycle.curve(np.ones(5), (1.0, 1.0), np.ones(4), (1, 1), two),
        lambda: design.known(np.ones((6, 7)), np.ones((5, 5))),
        lambda: design.drive(PLANT, (False, two, one), (0.01, 0.0), (0.0, 0.0, 0.0), 0, 2),
        lambda: real_motion.Windows([real_motion.Record(one, one, two, rows + 2, tuple(Frame()))]),
        lambda: real_motion.Windows([real_motion.Record(two, one, two, rows, tuple(Frame()))]),
        lambda: real_motion.Windows([real_motion.Record(one, one, two, rows, tuple(Frame()))]).read(
            np.array(RealMotor(0.2, 5.0, 0.4)), np.zeros((2, 4)), None, np.empty(0), plain=False
        ),
    ]  # fmt: skip
    for call in calls:
        with pytest.raises(ValueError):
            call()


def test_what_goes_in_may_be_of_any_order_in_memory() -> None:
    """Read-only, as a recording's columns are, or every second number of another array."""
    t_s, residual = np.arange(0.0, 4.0, 0.01), np.sin(np.arange(400.0) ** 2)
    wide = np.zeros((400, 2))
    wide[:, 0], wide[:, 1] = t_s, residual
    wide.flags.writeable = False
    assert noise_of(wide[:, 1], wide[:, 0], [400]) == noise_of(residual, t_s, [400])
    drive = np.zeros(1), np.ones(1), 0.0
    y, same = (motion.positions(PLANT, (0.0, 0.0, 0.0), drive, one) for one in (t_s, wide[:, 0]))
    assert np.array_equal(y, same) and math.isfinite(y[-1]) and y[-1] > 1.0
