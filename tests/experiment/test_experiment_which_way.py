"""Swapped wires and a bench that moves late, with an encoder: the breakaway check says which of both it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from evidence import evidence

from rig.run_folder.recording.series import TimeSeries
from rig.running.experiment import script
from rig.running.experiment.which_way import moves_against
from rig.running.preflight import check
from rig.running.replay import replay
from rig.running.session import Outcome

ROOT = Path(__file__).resolve().parents[2]
LATE_S = 0.14
# of a quick motor with swapped wires: its strokes passed for those of one that moves 0.15 s late
QUICK = {
    "tau_s": 0.043, "K_rad_s_V": 6.944, "start_rad": 0.465,
    "fc_plus_V": 0.3211, "fc_minus_V": 0.3523, "fs_plus_V": 0.3468, "fs_minus_V": 0.3805,
}  # fmt: skip
SLOWER = {
    "tau_s": 0.2603, "K_rad_s_V": 7.055, "start_rad": -0.366,
    "fc_plus_V": 0.3648, "fc_minus_V": 0.3644, "fs_plus_V": 0.3940, "fs_minus_V": 0.3936,
}  # fmt: skip


def checked(
    folder: Path, motor: dict[str, float], max_V: float, no_load_rad_s: float, seed: int, **emulated: Any
) -> Outcome:
    """The breakaway check of config/encoder.yaml on the simulated bench: how it ended, and its run folder."""
    told: dict[str, Any] = yaml.safe_load((ROOT / "config/encoder.yaml").read_text(encoding="utf-8"))
    told["daq"], told["seed"] = {"driver": "simulated"}, seed
    told["breakaway"]["max_V"], told["motor"]["no_load_speed_rad_s"] = max_V, no_load_rad_s
    told["emulated"] |= emulated
    told["emulated"]["motor"] |= motor
    (folder / "bench.yaml").write_text(yaml.safe_dump(told), encoding="utf-8")
    return script.run_breakaway(check(folder / "bench.yaml")[0], folder / "runs")


@pytest.mark.parametrize(
    ("motor", "max_V", "no_load_rad_s", "seed", "reversed_", "code"),
    [
        (QUICK, 0.71, 76.4, 15, True, "POLARITY"),
        (SLOWER | {"delay_s": LATE_S}, 0.8, 77.6, 1, False, "DELAY"),  # the check itself says LOAD_TURNS
        *evidence((SLOWER | {"delay_s": 0.1}, 0.8, 77.6, 1, True, "POLARITY")),  # late as well
    ],
)
def test_swapped_wires_are_not_taken_for_a_delay_nor_a_delay_for_swapped_wires(
    tmp_path: Path, motor: dict[str, float], max_V: float, no_load_rad_s: float, seed: int, reversed_: bool, code: str
) -> None:
    wiring = {"wiring": {"drive": "reversed"}} if reversed_ else {}
    outcome = checked(tmp_path, motor, max_V, no_load_rad_s, seed, **wiring)
    assert outcome.fault is not None and outcome.fault.code == code
    if code == "POLARITY":
        for words in ("two motor wires", "channels of the encoder", "D2 and D3", "GP2 and GP3"):
            assert words in outcome.fault.cure
    else:
        assert "the check said LOAD_TURNS" in outcome.fault.detail
    assert replay(outcome.folder).is_same


def test_a_shaft_that_does_not_move_goes_no_way() -> None:
    t_s = np.linspace(0.0, 0.59, 60)
    u_V = np.where((np.arange(60) % 20) < 4, 0.5, 0.0)
    assert not moves_against(TimeSeries(t_s, np.zeros(60), t_s + 0.001, u_V), 0.001)
