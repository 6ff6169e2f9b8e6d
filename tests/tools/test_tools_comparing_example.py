"""The runs of the example of docs/compare.md, and of motors with laws: rig takes their configs, they differ as told."""

from __future__ import annotations

import pytest

from comparing import with_laws
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


def test_runs_of_a_motor_with_laws_differ_in_their_seed_and_one_in_its_friction() -> None:
    made = [[with_laws.config(name, k) for k in range(with_laws.ALIKE + 1)] for name in with_laws.MOTORS]
    assert all(load(one).emulated is not None for runs in made for one in runs)
    assert len({one["seed"] for runs in made for one in runs}) == len(made) * (with_laws.ALIKE + 1)
    for *alike, other in ([one["emulated"]["motor"] for one in runs] for runs in made):
        assert all(one == alike[0] for one in alike) and alike[0]["parts"]
        assert other["fc_plus_V"] == pytest.approx(1.05 * alike[0]["fc_plus_V"])
