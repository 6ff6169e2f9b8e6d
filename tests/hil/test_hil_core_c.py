"""The firmware's own tests, in C under the sanitizers."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

from rig.emulate.firmware_build import source_folder


def test_the_firmwares_own_tests_pass(tmp_path: Path) -> None:
    environment = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
    made = subprocess.run(
        ["make", "-s", "-C", str(source_folder()), "test", f"BUILD={tmp_path}"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert made.returncode == 0, made.stdout + made.stderr
    counts = dict(re.findall(r"^(\w+): (\d+) checks, 0 failed$", made.stdout, re.MULTILINE))
    assert set(counts) == {"frames", "relay", "rig_core", "rig_relay"}
    assert int(counts["frames"]) > 100_000 and int(counts["rig_core"]) > 500
