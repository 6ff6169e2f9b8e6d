"""A campaign whose experiments are short, and rows as they could be."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rig.campaign.trial import COLUMNS
from rig.config import Campaign
from rig.identification.estimate import PARAMETERS

# What two runs of one experiment may differ in.
UNREPEATABLE = ("seconds",)


def small(experiments: int = 24, **sections: Any) -> Campaign:
    """Fast motors and few cycles: about 10 ms an experiment."""
    relay = {"settling_cycles": 3, "cycles": 6} | sections.pop("relay", {})
    motor = {"tau_s": (0.08, 0.15)} | sections.pop("motor", {})
    return Campaign(name="small", experiments=experiments, **{"motor": motor, "relay": relay, **sections})


def table(rows: int, **columns: Any) -> dict[str, np.ndarray]:
    """Rows in which every estimate is the truth, 1, with a bound and a standard error of 0.01; ``columns`` replace."""
    found: dict[str, np.ndarray] = {}
    for name, kind in COLUMNS.items():
        default = {int: 0, float: math.nan, str: "ok" if name == "verdict" else ""}[kind]
        if name in PARAMETERS or name.startswith("true_"):
            default = 1.0
        elif name.startswith(("bound_", "se_")):
            default = 0.01
        elif name.startswith("low_"):
            default = 0.98
        elif name.startswith("high_"):
            default = 1.02
        elif name == "seconds":
            default = 0.02
        value = columns.pop(name, default)
        found[name] = np.array(np.broadcast_to(value, (rows,)), dtype=kind)
    assert not columns, f"no such columns: {list(columns)}"
    found["number"] = np.arange(rows)
    return found
