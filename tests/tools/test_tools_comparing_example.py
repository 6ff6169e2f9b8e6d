"""The runs of the example of docs/compare.md: rig takes their configs, and they differ as the page says."""

from __future__ import annotations

import pytest

from comparing.example import MORE_FRICTION, OTHER_SUPPLY, RUNS, config
from rig.config import load


def test_six_motors_are_one_one_has_more_friction_and_one_bench_another_supply() -> None:
    configs = [load(config(number)) for number in range(1, RUNS + 1)]
    assert len({one.seed for one in configs}) == RUNS
    friction = [config(number)["emulated"]["motor"]["fc_plus_V"] for number in range(1, RUNS + 1)]
    supplies = [one.drive.supply_V for one in configs]
    odd, other = MORE_FRICTION - 1, OTHER_SUPPLY - 1
    assert friction[odd] == pytest.approx(1.02 * friction[0])
    assert friction[:odd] + friction[odd + 1 :] == [friction[0]] * (RUNS - 1)
    assert supplies[:other] == [12.0] * other and supplies[other] == 11.9
