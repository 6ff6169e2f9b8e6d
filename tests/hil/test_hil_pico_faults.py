"""What goes wrong in a relay test on the Pico: the pins go to 0 in time, and the run ends with the right code."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner
from evidence import evidence

from emulated_chips import opening
from emulated_chips.virtual_pico import VirtualPico
from rig.cli import main
from rig.config.schema import DeviceSetup

CONFIG = Path(__file__).resolve().parents[2] / "config" / "demo-pico.yaml"
FROM_S = 6.5  # in the relay test


class Troubled(VirtualPico):
    """A Pico to which something happens while it drives, from ``FROM_S`` on."""

    def __init__(self, parameters: dict[str, Any], trouble: Callable[[VirtualPico], None]) -> None:
        super().__init__(parameters)
        self._trouble: Callable[[VirtualPico], None] | None = trouble
        self.at_s = math.inf

    def sleep_until(self, t_s: float) -> float:
        now_s = super().sleep_until(t_s)
        if self._trouble is not None and now_s >= FROM_S and self.truth().pin_V != 0.0:
            self.at_s = now_s
            self._trouble(self)
            self._trouble = None
        return now_s


def config(folder: Path) -> Path:
    made = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    made["daq"]["port"] = "emulated-pico"
    made["limits"]["max_speed_rad_s"] = 4.7
    made["relay"] = {"gains": [{"h1_V": 0.42, "h2_V": 0.84}], "cycles": 12}
    del made["tracking"]
    path = folder / "pico.yaml"
    path.write_text(yaml.safe_dump(made), encoding="utf-8")
    return path


TROUBLES: dict[str, tuple[Callable[[VirtualPico], None], str, float]] = {
    "e-stop": (lambda pico: pico.contact("e_stop", is_open=True), "DEVICE_ESTOP", 10e-6),
    "hang": (lambda pico: pico.hang("everything"), "LINK_TIMEOUT", 0.130),
    "reset": (lambda pico: pico.reset(2, 0.005), "DEVICE_RESET", 0.0),
    "cable": (lambda pico: pico.unplug(), "LINK_LOST", 0.111),
}


@pytest.mark.parametrize("name", ["e-stop", *evidence("cable", "hang", "reset")])
def test_the_run_ends_by_its_code_with_the_pins_at_0(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trouble, code, within_s = TROUBLES[name]
    picos: list[Troubled] = []

    def made(d: DeviceSetup) -> Troubled:
        picos.append(Troubled(opening.parameters_of(d), trouble))
        return picos[-1]

    monkeypatch.setattr(opening, "emulated_pico", made)
    result = CliRunner().invoke(main, ["run", str(config(tmp_path)), "--out", str(tmp_path / "runs"), "--json"])
    assert result.exit_code == 1, result.output
    [pico] = picos
    VirtualPico.sleep_until(pico, pico.now_s() + 0.3)
    truth = pico.truth()
    assert truth.pin_V == 0.0 and truth.pin_changed_s - pico.at_s <= within_s + 2e-6
    [run] = (tmp_path / "runs").iterdir()
    found = json.loads((run / "result.json").read_text(encoding="utf-8"))
    assert [fault["code"] for fault in found["faults"]] == [code]
    pico.end()
