"""Write the list of a motor's numbers into firmware/motor/real_motor.h, of rig/core/motor_numbers.py.

``python tools/motor_numbers.py``
"""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path

from rig.core.motor_numbers import NUMBERS, of_every_bench

HEADER = Path(__file__).resolve().parent.parent / "firmware" / "motor" / "real_motor.h"
LIST = re.compile(r"(?<=#define REAL_MOTOR_NUMBERS\(NUMBER\) \\\n)(?:    NUMBER\(.*\n)+")


def c_list() -> str:
    """A line for each number: name, whether it is of a part, whether the motion stays linear; its least, its bound."""
    rows = [
        f"    NUMBER({name}, {'MOTOR' if of_every_bench(name) else 'PART'}, {int(number.linear)}, "
        f"{_in_c(number.of_benches)}, {_in_c(number.below)})"
        for name, number in NUMBERS.items()
    ]
    return " \\\n".join(rows) + "\n"


def _in_c(bound: float) -> str:
    return repr(bound) if math.isfinite(bound) else "-INFINITY" if bound < 0.0 else "INFINITY"


def main() -> int:
    """Write the list."""
    text = HEADER.read_text(encoding="utf-8")
    HEADER.write_text(LIST.sub(lambda _: c_list(), text), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
