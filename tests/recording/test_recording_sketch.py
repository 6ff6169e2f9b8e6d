"""The sketch of docs/examples: an AVR compiler takes it, and what it logs of a known motor gives that motor.

The Arduino core is not here. ``tests/sketch/Arduino.h`` declares the calls that the sketch uses; on this machine
``bench.cpp`` has an encoder and the emulated bench's motor behind them, in virtual time.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from rig.identification import identify
from rig.run_folder.recording.log_format import LogColumn, LogFormat
from rig.run_folder.recording.reader import read

ROOT = Path(__file__).resolve().parents[2]
SKETCH = ROOT / "docs/examples/log_motor/log_motor.ino"
CORE = ROOT / "tests/sketch"
HOST = ROOT / "firmware/boards/host"
MOTOR_C = ROOT / "firmware/motor"
STRICT = ["-fno-exceptions", "-Wall", "-Wextra", "-Werror", f"-I{CORE}"]
MOTOR = {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_V": 0.5, "supply_V": 12.0}


def run(*words: str | Path) -> str:
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sketch")
    for file in (HOST / "bench.c", MOTOR_C / "plain_motor.c", MOTOR_C / "real_motor.c"):
        folders = f"-I{HOST}", f"-I{MOTOR_C}"
        run("clang", "-O1", "-std=c99", *folders, "-c", file, "-o", out / f"{file.stem}.o")
    compiler = ["clang", "-x", "c++", "-std=c++11", "-fno-rtti", "-O1", *STRICT, f"-I{HOST}", f"-I{MOTOR_C}"]
    run(*compiler, "-include", "Arduino.h", "-c", SKETCH, "-o", out / "sketch.o")
    run(*compiler, "-c", CORE / "bench.cpp", "-o", out / "run.o")
    run("clang", *sorted(out.glob("*.o")), "-lm", "-o", out / "run")
    return out / "run"


def test_an_avr_compiler_takes_it(tmp_path: Path) -> None:
    compiler = ["avr-g++", "-mmcu=atmega328p", "-Os", "-std=gnu++11", "-x", "c++", *STRICT]
    run(*compiler, "-include", "Arduino.h", "-c", SKETCH, "-o", tmp_path / "sketch.o")


def test_its_log_gives_the_motor(bench: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text(run(bench, *map(str, MOTOR.values()), "0"))
    assert log.read_text().endswith("# done\n")
    columns = LogFormat(
        LogColumn("us"), LogColumn("pwm"), LogColumn("counts"), counts_per_turn=1440, full=255, supply_V=12
    )
    found = identify([read(log, columns)], ["sampled-data"]).estimates["sampled-data"]
    assert found.verdict == "ok", found.reasons
    for name in ("tau_s", "K_rad_s_V", "fc_V"):
        assert getattr(found, name) == pytest.approx(MOTOR[name], rel=0.01), name


def test_with_a_swapped_encoder_it_stops_and_says_what_to_swap(bench: Path) -> None:
    *rows, last = run(bench, *map(str, MOTOR.values()), "1").splitlines()
    assert last == "# stopped: counts fall. Swap PIN_A and PIN_B"
    assert int(rows[-1].split(",")[2]) > -450


def test_a_motor_that_stands_still_is_not_driven_for_long(bench: Path) -> None:
    *rows, last = run(bench, "0.17", "6.5", "9.0", "12.0", "0").splitlines()
    assert last.startswith("# stopped: no swing in 2 s")
    assert len(rows) < 250
