"""The whole experiment over Modbus, as a user runs it: RTU and TCP in virtual time; refusals."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from command_line import rig
from evidence import evidence
from short_runs import finds_the_truth, short, written

from rig.run_folder.recording.reader import read_run

ROOT = Path(__file__).resolve().parents[2]
GAINS = [{"h1_V": 0.43, "h2_V": 0.80}, {"h1_V": 0.33, "h2_V": 0.74}]  # such as its own search finds


def example(name: str) -> dict[str, Any]:
    config: dict[str, Any] = yaml.safe_load((ROOT / f"config/modbus-{name}.yaml").read_text(encoding="utf-8"))
    return config


def shorter(config: dict[str, Any]) -> dict[str, Any]:
    """Gains given, six cycles at each pair, one short check: half a minute."""
    return short(config, GAINS, cycles=6, tracking_s=3.0)


def searched() -> dict[str, Any]:
    config = example("tcp")
    config["tracking"]["methods"] = ["sampled-data"]
    return config


def separate() -> dict[str, Any]:
    config = shorter(example("rtu"))
    config["daq"]["watchdog_s"] = 0.08
    config["daq"]["modbus"]["requests"] = "separate"
    config["period_s"] = 0.02
    return config


@pytest.mark.evidence
@pytest.mark.parametrize(("config", "order"), [(separate, "sample_first"), *evidence((searched, "write_first"))])
def test_in_virtual_time_by_the_search_and_by_separate_requests(
    config: Callable[[], dict[str, Any]], order: str, tmp_path: Path
) -> None:
    result = rig("run", written(config(), tmp_path), "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 0, result.output
    outcome = json.loads(result.stdout)
    finds_the_truth(outcome)
    assert read_run(Path(outcome["folder"])).meta.order == order


def test_the_worked_example_of_the_docs(tmp_path: Path) -> None:
    """Floats low word first, input registers, no FC23, nothing but an output time-out."""
    path = ROOT / "docs/examples/remote-io.yaml"
    checked = rig("check", path)
    assert checked.exit_code == 0, checked.output
    assert "= 12.63 ms" in checked.output
    (note,) = re.findall("^note: (.*)", checked.output, re.MULTILINE)
    assert "has no status" in note
    config = shorter(yaml.safe_load(path.read_text(encoding="utf-8")))
    result = rig("run", written(config, tmp_path), "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 0, result.output
    finds_the_truth(json.loads(result.stdout))
    config["period_s"] = 0.01
    too_fast = rig("check", written(config, tmp_path))
    assert too_fast.exit_code != 0 and "period_s of 0.016 and more" in " ".join(too_fast.output.split())
    config["emulated"]["potentiometer"]["counts_max"] = 1023
    config["period_s"] = 0.02
    assert "emulated potentiometer reads 0 to 1023 counts" in rig("check", written(config, tmp_path)).output


def test_9600_baud_is_refused_with_the_sum(tmp_path: Path) -> None:
    config = example("rtu")
    config["daq"]["baud"] = 9600
    for command in ("check", "run"):
        result = rig(command, written(config, tmp_path))
        assert result.exit_code != 0
        text = " ".join(result.output.split())
        assert (
            "too slow for the period: FC23 request 17 + FC23 reply 13 = 30 bytes x 10 bits / 9600 baud = 31.25 ms, "
            "+ 7.29 ms (2 silences) + 0.5 ms (turnaround) = 39.04 ms; 80 % of the period is 8.00 ms" in text
        )
        assert "daq.baud 115200 fits" in text
    assert not (tmp_path / "runs").exists()


def test_check_says_what_the_link_needs(tmp_path: Path) -> None:
    result = rig("check", ROOT / "config/modbus-rtu.yaml")
    assert result.exit_code == 0
    assert (
        "FC23 request 17 + FC23 reply 13 = 30 bytes x 10 bits / 115200 baud = 2.60 ms, "
        "+ 3.5 ms (2 silences) + 0.5 ms (turnaround) = 6.60 ms" in result.output
    )
