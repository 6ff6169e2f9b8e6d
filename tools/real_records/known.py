"""What is known of the records: the table of a README beside them, and what others published of their motors."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

NUMBERS = ("tau_s", "K_rad_s_V", "fc_V")
LESS_BIAS = "fc_less_bias_V"
ROW = re.compile(r"\|\s*([\w.]+)\s*\|\s*(yes|no): ([\d.]+), ([\d.]+)\s*\|([^|]+)\|([^|]+)\|([^|]+)\|")
CELL = re.compile(r"\s*(-?[\d.]+) ± ([\d.]+) %\s*(\([^)]*\))?")


@dataclass(frozen=True)
class Known:
    """What is known of one record.

    predicts   whether the README says that the record can be predicted
    share      held-out error of the motor that the numbers are of, over that of a linear model in the same blocks
    numbers    by name: value, and half width of its interval
    """

    predicts: bool
    share: float
    numbers: dict[str, tuple[float, float]] = field(default_factory=dict)


PUBLISHED: dict[str, dict[str, tuple[float, float]]] = {
    # by motor: value and half width; 0: none was published (README.md of ``real`` and ``emps``, last column)
    "bam": {"tau_s": (0.164, 0.0), "K_rad_s_V": (2.355, 0.0), "fc_V": (0.133, 0.0)},
    "nb": {"tau_s": (0.465, 0.025), "K_rad_s_V": (30.15, 0.35)},
    "tu": {"tau_s": (0.0265, 0.0), "K_rad_s_V": (11.8, 0.0)},
    "emps": {"tau_s": (0.4674, 0.0), "K_rad_s_V": (0.1727, 0.0), "fc_V": (0.580, 0.0)},
}
OTHER_NAMES = {"emps": "DATA_EMPS", "emps_pulses": "DATA_EMPS_PULSES"}


def known_of(readme: Path) -> dict[str, Known]:
    """By record, from the table of a README: a number is known unless its cell says ``(not known)``."""
    found: dict[str, Known] = {}
    for row in ROW.finditer(readme.read_text(encoding="utf-8")):
        numbers: dict[str, tuple[float, float]] = {}
        for name, cell in zip(NUMBERS, row.groups()[4:], strict=True):
            told = CELL.match(cell)
            if told is None or told[3] == "(not known)":
                continue
            value = float(told[1])
            numbers[LESS_BIAS if told[3] == "(f_c - a)" else name] = value, abs(value) * float(told[2]) / 100.0
        found[OTHER_NAMES.get(row[1], row[1])] = Known(row[2] == "yes", float(row[3]) / float(row[4]), numbers)
    return found
