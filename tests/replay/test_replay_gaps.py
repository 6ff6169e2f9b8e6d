"""A run whose host stood still now and then, replayed: laws and guard decide the same."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from evidence import evidence

from rig import config
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.config import Experiment
from rig.core.signals import FLAG_SKIPPED
from rig.run_folder.recording.reader import read_run
from rig.running.experiment import script as experiment
from rig.running.replay import replay

CONFIG = Path(__file__).resolve().parents[2] / "config" / "demo.yaml"
STALL_S = 0.085
IN_CHECK_S, LATER_S = 0.71, 2.3  # it meets strokes, pauses and cycles at every phase


@pytest.mark.parametrize("before_drive", [*evidence(False), True], ids=["late readings", "late drives"])
def test_a_run_with_gaps_decides_the_same(before_drive: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    next_s = [4.0]  # once it drives
    name = "write" if before_drive else "read"
    original = getattr(VirtualBoard, name)

    def stand_still(self: VirtualBoard) -> None:
        if self.now_s() > next_s[0]:
            next_s[0] = self.now_s() + (IN_CHECK_S if self.now_s() < 14.0 else LATER_S)
            self.sleep_until(self.now_s() + STALL_S)

    def write(self: VirtualBoard, data: bytes) -> None:
        stand_still(self)
        original(self, data)

    def read(self: VirtualBoard, timeout_s: float) -> bytes:
        data: bytes = original(self, timeout_s)
        stand_still(self)
        return data

    monkeypatch.setattr(VirtualBoard, name, write if before_drive else read)
    e = config.load(CONFIG).model_dump(mode="json")
    e["relay"] |= {"target": None, "until": None, "gains": [{"h1_V": 0.42, "h2_V": 0.84}], "cycles": 3}
    outcome = experiment.run_relay(Experiment.model_validate_json(json.dumps(e | {"tracking": None})), tmp_path)
    assert outcome.fault is None
    run = read_run(outcome.folder)
    assert run.stage is not None and run.flags is not None
    assert np.count_nonzero(run.flags & FLAG_SKIPPED) > 10
    in_check = np.array([str(stage) == "breakaway" for stage in run.stage])
    ended_itself = in_check & (run.u_V == 0.0) & (run.t_u_s < run.t_s)  # before the host asked for 0 V
    assert np.count_nonzero(ended_itself) > 0
    done = replay(outcome.folder)
    assert done.is_same and done.fault is None and done.replayed == done.rows
    assert done.compared > 0.9 * done.rows
