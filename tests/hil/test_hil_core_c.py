"""The firmware's own tests, in C under the sanitizers."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest
from firmware_copy import copied_firmware

from rig.backends.serial.emulated.firmware_build import source_folder

SENT = "void blocks_sent(blocks *b)\n{\n"


def make(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
    command = ["make", "-s", "-C", str(folder), *words]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_the_firmwares_own_tests_pass(tmp_path: Path) -> None:
    made = make(source_folder(), "test", f"BUILD={tmp_path}")
    assert made.returncode == 0, made.stdout + made.stderr
    counts = dict(re.findall(r"^(\w+): (\d+) checks, 0 failed$", made.stdout, re.MULTILINE))
    assert set(counts) == {"frames", "relay", "strokes", "rig_core", "rig_encoder", "rig_relay", "rig_strokes"}
    assert int(counts["frames"]) > 100_000 and int(counts["rig_core"]) > 500


@pytest.mark.evidence
def test_make_check_would_notice_a_breach_of_misra(tmp_path: Path) -> None:
    folder = copied_firmware(tmp_path / "firmware")
    source = folder / "core" / "blocks.c"
    text = source.read_text()
    assert text.count(SENT) == 1
    # rule 15.7: an else if without an else
    breach = (
        "    if (b->rows == 1u) {\n        b->rows = 2;\n    } else if (b->rows == 3u) {\n        b->rows = 4;\n    }\n"
    )
    source.write_text(text.replace(SENT, SENT + breach))
    with (folder / "misra.txt").open("a") as rules:
        rules.write("misra-c2012-21.3\n")  # memory is not taken from a heap: a rule that is kept
    made = make(folder, "cppcheck")
    assert made.returncode != 0
    assert re.findall(r"\[(misra-\S+)\]", made.stderr) == ["misra-c2012-15.7"], made.stderr
    assert "Unmatched suppression: misra-c2012-21.3" in made.stderr
