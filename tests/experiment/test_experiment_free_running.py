"""A bridge that lets the motor run free while PWM is low: the breakaway check names it, or says nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from free_running_rates import main, shown
from rig.config.schema import Experiment
from rig.run_folder.recording.series import TimeSeries
from rig.running.experiment import script
from rig.running.experiment.free_running import Free, free_running
from rig.running.preflight import check

ROOT = Path(__file__).resolve().parents[2]
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


def certainly_shown(e: Experiment, *, coasts: bool) -> Free:
    """What the strokes of the check show on the bench's model, the law alone."""
    found = shown(e, 1, coasts=coasts)
    assert found is not None
    return found


def test_a_quick_motor_with_an_encoder_shows_it_and_braked_shows_the_contrary(tmp_path: Path) -> None:
    e = experiment(tmp_path, "encoder.yaml", QUICK)
    free, braked = certainly_shown(e, coasts=True), certainly_shown(e, coasts=False)
    assert free.is_certain and free.evidence > 500.0
    assert not braked.is_certain and braked.evidence < -100.0
    assert free.tau_s == pytest.approx(2.0 * QUICK["tau_s"], rel=0.3)  # the data sheet may be twice too slow


def test_what_strokes_cannot_show_is_not_said(tmp_path: Path) -> None:
    """Of 10 bits with noise, a motor that is not quick: either bridge; and no bridge that brakes is ever named."""
    for motor, coasts in ((SLOWER, True), (SLOWER, False), (QUICK, False)):
        assert not certainly_shown(experiment(tmp_path, "quick.yaml", motor), coasts=coasts).is_certain


def test_the_tool_counts_both_bridges_of_both_sensors(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["free_running_rates", "--motors", "2"])
    main()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[1] for row in rows] == ["runs free", "brakes"] * 2
    assert all(row[2].endswith(" of 2") for row in rows)
    assert [row[3] for row in rows if row[1] == "brakes"] == ["0", "0"]


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
