"""How often `rig compare` calls runs of one motor different, where the motor has laws that the answer has, too.

``PYTHONPATH=tools python -m comparing.with_laws FOLDER`` runs each motor several times into FOLDER, or takes the runs
that are there, compares all pairs, and prints shares. It takes some minutes.
"""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from itertools import combinations, product
from pathlib import Path
from typing import Any, Final

import yaml

from comparing.example import FRICTION, ROOT
from rig.output.compare.comparison import CompareError, compare

ALIKE: Final = 6  # runs of each motor; after them one with more friction
MORE: Final = 1.05
MOTORS: Final[dict[str, tuple[dict[str, float], dict[str, float]]]] = {  # numbers, and laws
    "sag": ({"tau_s": 0.21, "K_rad_s_V": 5.6, "friction": 0.33}, {"sag_per_V": 0.04}),
    "drag": ({"tau_s": 0.12, "K_rad_s_V": 7.1, "friction": 0.42}, {"drag_V_s2_rad2": 0.01}),
    "cogging": ({"tau_s": 0.16, "K_rad_s_V": 6.2, "friction": 0.38}, {"cogging_sin_V": 0.07, "cogging_per_rad": 5.0}),
    "force": ({"tau_s": 0.09, "K_rad_s_V": 8.3, "friction": 0.29}, {"force_sin_V": 0.12, "force_cos_V": 0.04}),
}


def config(name: str, number: int) -> dict[str, Any]:
    """The config of a motor's run, 0 to ``ALIKE``: config/quick.yaml with this motor, and a seed of its own."""
    made: dict[str, Any] = yaml.safe_load((ROOT / "config" / "quick.yaml").read_text(encoding="utf-8"))
    numbers, laws = MOTORS[name]
    friction_V = numbers["friction"] * (MORE if number == ALIKE else 1.0)
    plain = {key: value for key, value in numbers.items() if key != "friction"}
    made["name"], made["seed"] = f"{name}-{number}", 100 * list(MOTORS).index(name) + number + 1
    made["emulated"]["motor"] = plain | dict.fromkeys(FRICTION, friction_V) | {"bias_V": 0.01, "parts": laws}
    made["motor"]["no_load_speed_rad_s"] = 12.0 * numbers["K_rad_s_V"]
    return made


def run(folder: Path, name: str, number: int) -> Path:
    """The folder of that run, driven now if it is not there."""
    out = folder / f"{name}-{number}"
    if not (found := sorted(out.glob("2*"))):
        out.mkdir(parents=True, exist_ok=True)
        file = out / "config.yaml"
        file.write_text(yaml.safe_dump(config(name, number), sort_keys=False), encoding="utf-8")
        command = [sys.executable, "-m", "rig", "run", str(file), "--out", str(out)]
        subprocess.run(command, check=False, stdout=subprocess.DEVNULL)
        found = sorted(out.glob("2*"))
    return found[-1]


def counted(pairs: list[tuple[Path, Path]]) -> Counter[str]:
    """Of these pairs, how many were compared, and how many differ measurably."""
    count: Counter[str] = Counter()
    for pair in pairs:
        try:
            count["differ"] += compare(pair).result.measurably.differs
        except CompareError:
            count["left out"] += 1
        else:
            count["pairs"] += 1
    return count


def main() -> int:
    """Run them, compare them."""
    if len(sys.argv) != 2:
        sys.exit(f"{Path(__file__).name}: give the folder for the runs")
    same, more = Counter[str](), Counter[str]()
    for name in MOTORS:
        *alike, other = [run(Path(sys.argv[1]), name, number) for number in range(ALIKE + 1)]
        own, beside = counted(list(combinations(alike, 2))), counted(list(product(alike, [other])))
        print(f"{name}: of one motor {dict(own)}, with {100.0 * (MORE - 1.0):.0f} % more friction {dict(beside)}")
        same, more = same + own, more + beside
    print(f"all: of one motor {dict(same)}, with more friction {dict(more)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
