"""To add a law takes a row in the table of the motor's numbers, its term in C with its derivative, and its sentence."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
ROW = """    fan_V_s3_rad3: Annotated[
        float, Number("V s3/rad3", "k: drag k v^3", ("fan",), "k", one_sided=True, steers=True, curves=True)
    ] = 0.0
"""
TERM = {
    "real_motor.c": (
        ("m->drag_V_s2_rad2 * at->v)", "m->drag_V_s2_rad2 * at->v + m->fan_V_s3_rad3 * at->v * speed)"),
        ("|| m->drag_V_s2_rad2 != 0.0", "|| m->drag_V_s2_rad2 != 0.0 || m->fan_V_s3_rad3 != 0.0"),
    ),
    "real_readings.c": (
        (
            "2.0 * m->drag_V_s2_rad2 * speed);",
            "2.0 * m->drag_V_s2_rad2 * speed + 3.0 * m->fan_V_s3_rad3 * v * v);\n"
            "    a[AT_fan_V_s3_rad3] = -gain * v * v * v;",
        ),
    ),
}
SENTENCE = """    Departure(
        "fan", "drag with the cube of the speed", "a propeller?",
        lambda bench: 0.1 / (bench.K_rad_s_V * bench.top_rad_s**2), "fast motion, both ways",
    ),
"""
ASKED = """
import json
from test_identify_real_benches import answered, recorded
from rig.config.schema import EmulatedParts
from rig.model.real_motor import RealMotor
from rig.output.export.motor import KnownNumber
truth = RealMotor(0.08, 1.2, 0.6, fan_V_s3_rad3=0.005)
(law,) = answered(recorded(truth, (3.0, 6.0, 9.0), rows=800)).law
said = KnownNumber("fan_V_s3_rad3", law.numbers["fan_V_s3_rad3"]).line()
emulated = EmulatedParts(fan_V_s3_rad3=0.005).fan_V_s3_rad3
print(json.dumps([law.name, law.value, law.ci95, law.unit, said, emulated]))
"""


def put(file: Path, before: str, after: str) -> None:
    text = file.read_text(encoding="utf-8")
    assert text.count(before) == 1, (file, before)
    file.write_text(text.replace(before, after), encoding="utf-8")


def test_a_new_law_is_a_row_a_term_and_a_sentence(tmp_path: Path) -> None:
    # with its bytecode, which holds for a file of the same time and size
    shutil.copytree(ROOT / "rig", tmp_path / "rig")
    shutil.copytree(ROOT / "firmware" / "motor", tmp_path / "firmware" / "motor")
    (tmp_path / "tools").mkdir()
    shutil.copy(ROOT / "tools" / "motor_numbers.py", tmp_path / "tools")
    table = tmp_path / "rig/core/motor_numbers.py"
    put(table, "    bristle_V_rad: Annotated[", ROW + "    bristle_V_rad: Annotated[")
    for name, changes in TERM.items():
        for change in changes:
            put(tmp_path / "firmware" / "motor" / name, *change)
    rows = tmp_path / "rig/identification/departures/laws.py"
    put(rows, '    Departure(\n        "bristle",', SENTENCE + '    Departure(\n        "bristle",')
    paths = (tmp_path, tmp_path / "tools", ROOT / "tests", ROOT / "tests" / "identify", ROOT / "tools")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, paths))}

    def python(*words: str) -> str:
        command = [sys.executable, *words]
        return subprocess.run(
            command, cwd=tmp_path, env=environment, check=True, text=True, stdout=subprocess.PIPE
        ).stdout

    python("tools/motor_numbers.py")
    told = python("-c", ASKED)
    name, value, (low, high), unit, said, emulated = json.loads(told)
    assert (name, unit, emulated) == ("fan", "V s3/rad3", 0.005)
    assert low < 0.005 < high and value == pytest.approx(0.005, rel=0.05)
    assert said.endswith("V s3/rad3, k: drag k v^3")
