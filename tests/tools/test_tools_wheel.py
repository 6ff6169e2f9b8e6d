"""A wheel, installed into an empty environment, has the ready configs, the firmware, its sources and the license."""

from __future__ import annotations

import itertools
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from rig.backends.serial.emulated.firmware_build import Variant
from rig.model.library_build import NAME
from rig.model.motor import Motor, State

ROOT = Path(__file__).resolve().parents[2]
UV = ROOT / ".venv" / "bin" / "uv"


pytestmark = pytest.mark.long
# between them they have each side of every switch, so that a path in any line of any source would show
EXTREMES = (Variant(), Variant("IN1_IN2", 1000000, True, True, True, True))
# of the 64 of a wheel, for two boards: these two, and one with two switches of its own; `make dist` builds all
BUILT = (*EXTREMES, Variant("IN1_IN2", 1000000))


def word(one: Variant) -> str:
    """A variant as the Makefile lists it."""
    return ".".join(str(int(part)) if isinstance(part, bool) else str(part) for part in one)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a wheel is built from."""
    tree = tmp_path_factory.mktemp("tree") / "rig"
    ignored = shutil.ignore_patterns("__pycache__", "node_modules")
    for name in ("rig", "firmware", "config"):
        shutil.copytree(ROOT / name, tree / name, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree / name)
    return tree


def built(tree: Path, out: Path, **environment: str) -> Path:
    """The wheel of a tree. Hatchling comes from the cache that the set-up of .venv has filled."""
    subprocess.run(
        [UV, "build", "--wheel", "--quiet", "--python", sys.executable, "-o", out],
        cwd=tree, check=True, env=os.environ | environment,
    )  # fmt: skip
    return next(out.glob("*.whl"))


@pytest.fixture(scope="module")
def plain(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel that pip builds."""
    return built(tree, tmp_path_factory.mktemp("plain"), RIG_FIRMWARE="")


@pytest.fixture(scope="module")
def wheel(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of `make wheel`."""
    variants = " ".join(word(one) for one in BUILT)
    return built(tree, tmp_path_factory.mktemp("wheel"), RIG_FIRMWARE="required", RIG_VARIANTS=variants)


def test_what_pip_builds_holds_no_firmware_so_that_nobody_waits_for_it(plain: Path) -> None:
    names = zipfile.ZipFile(plain).namelist()
    assert not any("prebuilt" in name for name in names)
    assert "rig/_firmware/core/rig_core.c" in names  # from which `rig flash` compiles it


def test_a_wheel_is_one_platforms_and_brings_the_physics(plain: Path, tmp_path: Path) -> None:
    """Of any Python: the library is called through ctypes. It moves a motor there as here."""
    assert plain.name.split("-")[2:] == ["py3", "none", f"{sysconfig.get_platform().replace('-', '_')}.whl"]
    unpacked = tmp_path / "unpacked"
    with zipfile.ZipFile(plain) as archive:
        archive.extractall(unpacked)
    assert (unpacked / "rig" / "model" / NAME).is_file()
    program = (
        "import rig; from rig.model.motor import Motor, State; "
        "print(rig.__file__, Motor(0.2, 5.0).advance(State(), 1.0, 0.1))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, check=True, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(unpacked), "PATH": "/nowhere"},
    )  # fmt: skip
    assert done.stdout == f"{unpacked}/rig/__init__.py {Motor(0.2, 5.0).advance(State(), 1.0, 0.1)}\n"


@pytest.mark.evidence
def test_the_wheel_holds_the_listed_variants_of_the_firmware(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        held = {
            name.rpartition("/")[2]: archive.read(name)
            for name in archive.namelist()
            if name.startswith("rig/_firmware/prebuilt/")
        }
    wired = list(itertools.product((False, True), repeat=4))
    every = [Variant(b, r, *w) for b in ("PWM_DIR", "IN1_IN2") for r in (115200, 1000000) for w in wired]
    listed = subprocess.run(
        ["make", "-s", "-C", ROOT / "firmware", "every-variant"], check=True, capture_output=True, text=True,
        env={key: value for key, value in os.environ.items() if "MAKE" not in key},
    ).stdout.split()  # fmt: skip
    assert set(listed) == {word(one) for one in every} and len(listed) == len(every)
    files = {f"{one.name}.hex" for one in BUILT} | {f"{one.name_for('pico')}.uf2" for one in BUILT}
    assert held.keys() == files | {"SHA256SUMS"}


@pytest.mark.evidence
def test_another_folder_gives_the_same_firmware(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        held = {name.rpartition("/")[2]: archive.read(name) for name in archive.namelist() if "/prebuilt/" in name}
    shutil.copytree(ROOT / "firmware", tmp_path / "elsewhere", ignore=shutil.ignore_patterns("node_modules"))
    for one in EXTREMES:
        subprocess.run(
            ["make", "-s", "-j2", "-C", tmp_path / "elsewhere", "uno", "pico", *one.variables(), f"BUILD={tmp_path}"],
            check=True, capture_output=True, env={key: value for key, value in os.environ.items() if "MAKE" not in key},
        )  # fmt: skip
        assert held[f"{one.name}.hex"] == (tmp_path / f"uno/{one.name}.hex").read_bytes()
        assert held[f"{one.name_for('pico')}.uf2"] == (tmp_path / f"pico/{one.name_for('pico')}.uf2").read_bytes()


def test_a_wheel_holds_the_configs_the_sources_of_the_firmware_and_the_license(plain: Path) -> None:
    names = zipfile.ZipFile(plain).namelist()
    for config in sorted((ROOT / "config").glob("*.yaml")):
        assert f"rig/_config/{config.name}" in names
    assert "rig/_firmware/core/rig_core.c" in names
    assert "rig/py.typed" in names  # the types of rig count in programs that use it
    assert {"rig/panel/static/vendor/uPlot.esm.js", "rig/panel/static/vendor/uPlot-LICENSE"} <= set(names)
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert plain.name.startswith("motor_rig-")  # on PyPI, rig is another's name
    subprocess.run([UV.with_name("twine"), "check", "--strict", plain], check=True, capture_output=True)


@pytest.mark.evidence
def test_an_installed_rig_gives_a_config_that_its_check_accepts(wheel: Path, tmp_path: Path) -> None:
    """In a new environment, which sees this one's packages but not this tree's rig."""
    home = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", home], check=True)
    python = home / "bin" / "python"
    # offline: what rig needs comes from the tests' own environment, without what its .pth files add: rig itself
    (packages,) = (home / "lib").glob("python*/site-packages")
    borrowed = next(Path(path) for path in sys.path if path.endswith("site-packages"))
    (packages / "borrowed.pth").write_text(f"{borrowed}\n", encoding="utf-8")
    subprocess.run([UV, "pip", "install", "--quiet", "--offline", "--no-deps", "--python", python, wheel], check=True)
    clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}

    def rig(*words: str) -> str:
        done = subprocess.run(
            [home / "bin" / "rig", *words], cwd=tmp_path, env=clean, check=True, capture_output=True, text=True
        )
        return done.stdout

    where = subprocess.run(
        [python, "-c", "import rig; print(rig.__file__)"], cwd=tmp_path, env=clean, check=True, capture_output=True,
        text=True,
    ).stdout  # fmt: skip
    assert Path(where.strip()).is_relative_to(home)
    assert "simulated" in rig("config", "list")
    rig("config", "copy", "simulated", "--to", "mine.yaml")
    assert (tmp_path / "mine.yaml").read_text(encoding="utf-8") == (ROOT / "config" / "simulated.yaml").read_text(
        encoding="utf-8"
    )
    assert "verdict: ok" in rig("check", "mine.yaml")

    clean["PATH"] = str(home / "bin")  # no compiler, no make, no avrdude
    rig("init", "bench.yaml", "--yes", "--bridge", "l298n", "--no-load-rpm", "590")
    assert "verdict: ok" in rig("check", "bench.yaml")
    flashed = rig("flash", "--dry-run", "--port", "/dev/ttyACM0", "--bridge", "in1-in2", "--baud", "1000000")
    assert "has never run on a real chip" in flashed
    assert "/rig/_firmware/prebuilt/rig_uno-in1_in2-1000000.hex:i" in flashed
