"""Which of the wheels in a folder this machine can try: each of those moves a motor, through its own library.

python tools/try_wheels.py dist

Exit status 1 if one of them does not, or if a wheel has no library.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tempfile
import zipfile
from pathlib import Path

LIBRARIES = ("librig_motor.so", "rig_motor.dll", "librig_motor.dylib")
MOVE = (
    "import rig; from rig.model.motor import Motor, State; end = Motor(0.2, 5.0).advance(State(), 1.0, 0.1); "
    "print(rig.__file__, round(end.v, 12))"
)
MOVED = "1.967346701437"  # 5 (1 - exp(-0.5))


def tried(wheel: Path) -> tuple[bool, str]:
    """Whether a wheel is well as far as this machine can tell, and what was tried."""
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(wheel) as archive:
        held = [name for name in LIBRARIES if f"rig/model/{name}" in archive.namelist()]
        if len(held) != 1:
            return False, f"it has {len(held)} libraries"
        system, _, machine = sysconfig.get_platform().partition("-")
        platform = wheel.stem.split("-")[-1]
        if not (system in platform and platform.endswith(machine.replace("-", "_"))):
            return True, f"{held[0]}: untried, it is another platform's"
        archive.extractall(folder)
        environment = os.environ | {"PYTHONPATH": folder}
        done = subprocess.run(
            [sys.executable, "-c", MOVE], cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        is_well = done.stdout.split() == [str(Path(folder) / "rig" / "__init__.py"), MOVED]
        return is_well, f"{held[0]}: a motor moves" if is_well else f"{held[0]}: {done.stdout}{done.stderr}"


def main(folder: Path) -> int:
    """Try all wheels of a folder."""
    found = {wheel.name: tried(wheel) for wheel in sorted(folder.glob("*.whl"))}
    for name, (_, words) in found.items():
        print(f"{name}: {words}")
    return 0 if found and all(is_well for is_well, _ in found.values()) else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
