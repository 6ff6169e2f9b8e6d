"""A bridge that lets the motor run free while PWM is low: the breakaway check names it, or says nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from rig.backends.emulated.bench import bench_parameters
from rig.config.schema import Experiment
from rig.experiment import script
from rig.experiment.free_running import Free, free_running
from rig.experiment.stages import breakaway_check
from rig.model.bench import BenchModel
from rig.preflight import check
from rig.recording.series import TimeSeries
from rig.signals import Sample

ROOT = Path(__file__).resolve().parents[2]
LATENCY_S = 0.0012
QUICK = {"tau_s": 0.05, "K_rad_s_V": 4.1, "fc_plus_V": 0.34, "fc_minus_V": 0.36, "fs_plus_V": 0.39, "fs_minus_V": 0.4}
SLOWER = {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_plus_V": 0.34, "fc_minus_V": 0.36, "fs_plus_V": 0.39, "fs_minus_V": 0.4}


def experiment(folder: Path, config: str, motor: dict[str, float], **changes: Any) -> Experiment:
    told: dict[str, Any] = yaml.safe_load((ROOT / "config" / config).read_text(encoding="utf-8"))
    told["daq"] = {"driver": "simulated"}
    told["breakaway"]["max_V"] = 0.77
    told["emulated"]["motor"].update(motor)
    told["motor"]["no_load_speed_rad_s"] = 11.6 * motor["K_rad_s_V"]
    for section, change in changes.items():
        told[section].update(change)
    (folder / "bench.yaml").write_text(yaml.safe_dump(told), encoding="utf-8")
    return check(folder / "bench.yaml")[0]


def shown(e: Experiment, *, coasts: bool, seed: int = 1) -> Free:
    """What the strokes of the check show on the bench's model, the law alone."""
    assert e.emulated is not None and e.motor is not None
    bench, law = BenchModel(replace(bench_parameters(e.emulated), coasting=coasts), seed), breakaway_check(e)
    bench.arm()
    rows, t_s, full = [], 0.0, bench.parameters.drive_counts
    while not law.finished:
        counts = bench.read_counts()
        u_V = law.step(Sample(t_s, e.sensor.curve.to_rad(counts), counts))
        units = float(round(u_V / e.drive.supply_V * full))
        rows.append((t_s, e.sensor.curve.to_rad(counts), t_s + LATENCY_S, units / full * e.drive.supply_V))
        bench.advance(LATENCY_S)
        bench.pin_counts = units
        bench.advance(e.period_s - LATENCY_S)
        t_s += e.period_s
    series = TimeSeries(*np.array(rows).T)
    found = free_running(series, law.noise_rad, e.sensor.curve.lsb_rad, e.drive.supply_V, e.motor.no_load_speed_rad_s)
    assert found is not None
    return found


def test_a_quick_motor_with_an_encoder_shows_it_and_braked_shows_the_contrary(tmp_path: Path) -> None:
    e = experiment(tmp_path, "encoder.yaml", QUICK)
    free, braked = shown(e, coasts=True), shown(e, coasts=False)
    assert free.is_certain and free.evidence > 500.0
    assert not braked.is_certain and braked.evidence < -100.0
    assert free.tau_s == pytest.approx(2.0 * QUICK["tau_s"], rel=0.3)  # the data sheet may be twice too slow


def test_what_strokes_cannot_show_is_not_said(tmp_path: Path) -> None:
    """Of 10 bits with noise, a motor that is not quick: either bridge; and no bridge that brakes is ever named."""
    for motor, coasts in ((SLOWER, True), (SLOWER, False), (QUICK, False)):
        assert not shown(experiment(tmp_path, "simulated.yaml", motor), coasts=coasts).is_certain


def test_no_rows_with_a_drive_show_nothing() -> None:
    still = TimeSeries(np.arange(5.0), np.zeros(5), np.arange(5.0) + 0.1, np.array([0.0, 0.0, 0.0, 0.0, 0.0]))
    assert free_running(still, 0.001, 0.002, 12.0, 75.0) is None


@pytest.mark.parametrize("bridge", ["pwm-dir", "in1-in2"])
def test_the_run_names_the_bridge_and_the_wires_to_move_and_goes_on(tmp_path: Path, bridge: str) -> None:
    e = experiment(tmp_path, "encoder.yaml", QUICK, emulated={"coasting": True}, drive={"bridge": bridge})
    outcome = script.run_breakaway(e, tmp_path / "runs")
    assert outcome.fault is None and outcome.result is not None
    named = [note for note in outcome.result.notes if "lets the motor run free" in note]
    assert len(named) == (bridge == "pwm-dir")
    for note in named:
        for words in ("IN1 and IN2 to the two PWM pins", "D9 and D10", "GP16 and GP17", "--bridge in1-in2"):
            assert words in note
