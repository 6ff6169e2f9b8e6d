"""Motors with parts behind the Uno's firmware on its emulated chip: each law as motion, and one whole run."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from chip_host import ChipHost, armed_chip
from command_line import rig
from evidence import evidence
from intervals import reaches
from real_motors import EACH, FRAME, PLAIN, with_parts

from rig.model.bench import BenchModel, BenchParameters
from rig.model.friction import coulomb, tustin
from rig.model.motor import Motor

pytestmark = [pytest.mark.long, pytest.mark.laws]

# Of 400 units, every 30 ms: to and fro, to rest, and from rest with what a static level holds.
DRIVES = ((60,) * 5 + (-12, -60, -60, 14) + (0,) * 9 + (20,) * 5 + (-60,) * 6 + (0,) * 9 + (-20,) * 5) * 2 + (0,) * 20
DRIVE_S = 0.03
DEMO = Path(__file__).resolve().parents[2] / "config" / "demo.yaml"
PWM_PERIOD_S = 50e-6


def bench_with(part: str) -> BenchParameters:
    """A bench whose motor has this part; its sensor has no noise."""
    real, frame = with_parts(part)._replace(delay_s=0.0), FRAME._replace(start_s=0.0, duration_s=2.0)
    friction = tustin(real.fc_V, real.fc_V + real.static_V + real.stribeck_V, real.stribeck_rad_s)
    motor = Motor(real.tau_s, real.K_rad_s_V, friction, real.bias_V)
    return BenchParameters(motor, drive_counts=400, real=real, frame=frame)


def plain_of(bench: BenchParameters) -> BenchParameters:
    """The same without the part."""
    return replace(bench, motor=Motor(PLAIN.tau_s, PLAIN.K_rad_s_V, coulomb(PLAIN.fc_V), PLAIN.bias_V), real=None)


class Follower:
    """The simulated bench, moved by the drives that really were at a chip's pins."""

    def __init__(self, parameters: BenchParameters, host: ChipHost) -> None:
        self.bench, self._now_s = BenchModel(parameters, 1), host.heard_s
        self.bench.advance(self._now_s)
        self.bench.arm()

    def follow(self, units: int, changed_s: float, until_s: float) -> None:
        """To ``until_s``, with a drive that changed at ``changed_s``."""
        if changed_s > self._now_s:
            self.bench.advance(changed_s - self._now_s)
            self._now_s = changed_s
        self.bench.pin_counts = units
        self.bench.advance(until_s - self._now_s)
        self._now_s = until_s


STAY = ("stribeck", "backlash")  # of the friction, and of the reading


@pytest.mark.parametrize("part", [*STAY, *evidence(*(part for part in EACH if part not in STAY))])
def test_each_part_moves_the_motor_behind_the_chip_as_on_the_simulated_bench(part: str) -> None:
    parameters = bench_with(part)
    host = armed_chip(parameters)
    same, plain = Follower(parameters, host), Follower(plain_of(parameters), host)
    fastest, differs_rad, differs_counts = 0.0, 0.0, 0
    for units in DRIVES:
        host.drive(units)
        host.board.sleep_until(host.board.now_s() + DRIVE_S)
        truth = host.board.truth()
        for one in (same, plain):
            one.follow(units, truth.pin_changed_s, host.board.now_s())
        fastest = max(fastest, abs(truth.v_rad_per_s))
        # the chip's pulses begin with a period of its timer
        assert truth.y_rad == pytest.approx(same.bench.state.y, abs=fastest * PWM_PERIOD_S)
        differs_rad = max(differs_rad, abs(truth.y_rad - plain.bench.state.y))
        if truth.v_rad_per_s == 0.0:
            read = host.state().counts
            assert abs(read - same.bench.read_counts()) <= 1
            differs_counts = max(differs_counts, abs(read - plain.bench.read_counts()))
    assert differs_rad > 2e-3 or differs_counts >= 2, "the part makes no difference"


@pytest.mark.evidence
def test_a_run_on_the_chip_names_the_laws_of_the_motor_behind_it(tmp_path: Path) -> None:
    config = yaml.safe_load(DEMO.read_text(encoding="utf-8"))
    config["daq"]["port"] = "emulated-chip"
    config["limits"]["max_speed_rad_s"] = 4.7
    del config["tracking"]
    config["emulated"]["motor"] |= {
        "fc_plus_V": 0.48, "fc_minus_V": 0.48, "fs_plus_V": 0.68, "fs_minus_V": 0.68, "stribeck_rad_s": 0.3,
        "bias_V": 0.0, "parts": {"force_sin_V": 0.06, "force_cos_V": 0.03},
    }  # fmt: skip
    path = tmp_path / "chip.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    done = rig("run", path, "--out", tmp_path / "runs", "--json")
    assert done.exit_code == 0, done.output
    outcome: dict[str, Any] = json.loads(done.stdout)
    assert outcome["backend"].startswith("emulated-chip (emulated uno board, build uno ")
    laws = {law["name"]: law for law in outcome["answer"]["law"]}
    for name, true_V in (("stribeck", 0.2), ("force_over_position", math.hypot(0.06, 0.03))):
        assert reaches(laws[name]["ci95"], true_V)
    for name in ("tau_s", "K_rad_s_V", "fc_V"):
        assert outcome["answer"][name] == pytest.approx(outcome["truth"][name], rel=0.02)
