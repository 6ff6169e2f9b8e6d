"""Makes the example of docs/compare.md: seven simulated runs, of which one is odd and one of another bench.

``PYTHONPATH=tools python -m comparing.example FOLDER`` runs them into FOLDER, which must be empty or not there, and
prints what `rig compare` says. It takes some minutes.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any, Final

import yaml

ROOT: Final = Path(__file__).resolve().parents[2]
RUNS: Final = 7
MORE_FRICTION, OTHER_SUPPLY = 5, 7  # numbers of the runs
FRICTION: Final = ("fc_plus_V", "fc_minus_V", "fs_plus_V", "fs_minus_V")


def config(number: int) -> dict[str, Any]:
    """The config of a run, 1 to ``RUNS``: config/quick.yaml, a seed of its own, and what is odd about it."""
    made: dict[str, Any] = yaml.safe_load((ROOT / "config" / "quick.yaml").read_text(encoding="utf-8"))
    made["seed"] = number
    motor = made["emulated"]["motor"]
    if number == MORE_FRICTION:
        made["emulated"]["motor"] = motor | {name: round(1.02 * motor[name], 6) for name in FRICTION}
    if number == OTHER_SUPPLY:
        made["drive"]["supply_V"] = 11.9
    return made


def main() -> int:
    """Run them, compare them."""
    if len(sys.argv) != 2:
        sys.exit(f"{Path(__file__).name}: give the folder for the runs")
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        sys.exit(f"{folder}: is not empty; give another folder")
    rig = [sys.executable, "-m", "rig"]
    for number in range(1, RUNS + 1):
        file = folder / f"run-{number}.yaml"
        file.write_text(yaml.safe_dump(config(number), sort_keys=False), encoding="utf-8")
        subprocess.run([*rig, "run", str(file), "--out", str(folder / "runs")], check=True, stdout=subprocess.DEVNULL)
    return subprocess.run([*rig, "compare", *map(str, sorted((folder / "runs").glob("2*")))], check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
