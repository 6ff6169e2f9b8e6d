"""The whole experiment on the Pico's emulated chip as a user runs it, in virtual time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from emulated_run import finds_it_undisturbed, finds_the_truth, run_on

pytestmark = pytest.mark.long

CONFIG = Path(__file__).resolve().parents[2] / "config"


def demo() -> dict[str, Any]:
    config: dict[str, Any] = yaml.safe_load((CONFIG / "demo-pico.yaml").read_text(encoding="utf-8"))
    return config


@pytest.mark.evidence
def test_the_whole_experiment_on_the_pico_finds_the_truth(tmp_path: Path) -> None:
    outcome = run_on("emulated-pico", tmp_path, demo())
    assert outcome["backend"].startswith("emulated-pico (emulated pico board, build pico ")
    finds_it_undisturbed(outcome, 0.01)
    assert outcome["tracking"]["sampled-data"]["rms_rad"] < 0.01


@pytest.mark.evidence
def test_the_relay_in_the_pico_finds_the_truth(tmp_path: Path) -> None:
    gains = [{"h1_V": 0.42, "h2_V": 0.84}]
    outcome = run_on("emulated-pico", tmp_path, demo(), target=None, where="device", gains=gains, cycles=7)
    finds_the_truth(outcome, 0.01)
    assert outcome["link"]["bad_frames"] == 0 and not outcome["faults"]
    assert outcome["loop"]["device"]["missed"] == 0


@pytest.mark.evidence
def test_the_whole_experiment_with_an_encoder_finds_the_truth_to_a_fifth_of_a_percent(tmp_path: Path) -> None:
    """The shortest one: quicker strokes, given gains, few cycles, one check of two seconds."""
    config = yaml.safe_load((CONFIG / "encoder.yaml").read_text(encoding="utf-8"))
    config["breakaway"]["ramp_V_s"] = 1.0
    config["relay"] = {"gains": [{"h1_V": 0.42, "h2_V": 0.84}, {"h1_V": 0.3, "h2_V": 0.76}], "cycles": 4}
    config["tracking"] |= {"methods": ["sampled-data"], "duration_s": 2.0, "with_law": False}
    outcome = run_on("emulated-pico", tmp_path, config)
    finds_it_undisturbed(outcome, 0.002)
    assert outcome["tracking"]["sampled-data"]["rms_rad"] < 0.005


def test_the_demo_on_the_pico_is_the_demo_with_twelve_bits() -> None:
    demo, pico = (yaml.safe_load((CONFIG / f"{name}.yaml").read_text("utf-8")) for name in ("demo", "demo-pico"))
    assert pico["daq"].pop("port") == "emulated-pico-realtime" and demo["daq"].pop("port") == "emulated"
    assert pico.pop("name") == "demo-pico" and demo.pop("name") == "demo"
    assert pico["sensor"].pop("counts_max") == 4095 and demo["sensor"].pop("counts_max") == 1023
    assert pico["sensor"].pop("rail_counts") == [20, 4075] and demo["sensor"].pop("rail_counts") == [5, 1018]
    for point in demo["sensor"]["calibration"]:
        point["counts"] *= 4
    assert pico == demo
