"""What a device or a file says reaches the terminal without its escape sequences."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner
from evidence import one_of_each

from rig import config
from rig.backends.driver import DeviceInfo
from rig.backends.modbus.requests import identity_of
from rig.cli import main
from rig.core.faults import Fault
from rig.running.experiment import script as experiment

ROOT = Path(__file__).resolve().parents[2]
CLEAR = "\x1b[2J\x1b]0;owned\x07"
SHOWN = r"\x1b[2J\x1b]0;owned\x07"


def said(*arguments: str) -> str:
    """Both streams of a command."""
    result = CliRunner().invoke(main, list(arguments))
    return result.stdout + result.stderr


def test_a_vendor_string_is_shown_escaped_in_result_and_backend(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A Modbus device that calls itself a terminal command, in a run on the emulated block."""
    objects = b"".join(bytes([k, len(text)]) + text for k, text in enumerate((CLEAR.encode(), b"block\r\n", b"1.0")))
    reply = bytes([0x2B, 0x0E, 0x01, 0x01, 0x00, 0x00, 3]) + objects
    assert identity_of(reply) == (SHOWN, r"block\r\n", "1.0")
    monkeypatch.setattr("rig.backends.modbus.driver.identity_of", lambda pdu: identity_of(reply))
    e = config.load(ROOT / "config/modbus-rtu.yaml")
    e = e.model_copy(update={"daq": e.daq.model_copy(update={"port": "emulated"})})
    outcome = experiment.jog(e, 0.0, 0.05, tmp_path)
    assert SHOWN in outcome.result.backend and "\x1b" not in json.dumps(outcome.as_json(), ensure_ascii=False)


def test_what_any_driver_says_of_its_device_and_any_fault_is_printable() -> None:
    info = DeviceInfo(build=CLEAR, board="a\nb", reset_cause="\x9b31m", emulated=True)
    assert (info.build, info.board, info.reset_cause) == (SHOWN, r"a\nb", r"\x9b31m")
    fault = Fault("LINK_REPLY", f"it says {CLEAR}")
    assert fault.detail == f"it says {SHOWN}" and "\x1b" not in str(fault)


@pytest.mark.parametrize(
    ("command", "file"),
    one_of_each(
        ("replay", "events.jsonl"), ("identify", "meta.json"), ("report", "samples.csv"), ("report", "config.yaml")
    ),
)
def test_a_run_folder_of_a_stranger_is_shown_escaped(command: str, file: str, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(ROOT / "tests/golden/simulated-fault", folder)
    path = folder / file
    text = path.read_text(encoding="utf-8")
    if file == "events.jsonl":
        events = [json.loads(line) for line in text.splitlines()]
        for event in events:
            event |= {key: CLEAR for key in ("detail", "name", "stage") if key in event}
        path.write_text("".join(json.dumps(event) + "\n" for event in events), encoding="utf-8")
    elif file == "meta.json":
        meta = json.loads(text)
        path.write_text(json.dumps(meta | {"order": CLEAR, "backend": CLEAR, "script": {"name": CLEAR}}))
    elif file == "samples.csv":
        path.write_text(text.replace("relay-1", CLEAR), encoding="utf-8")
    else:
        e = yaml.safe_load(text)
        e["daq"]["driver"] = e["name"] = CLEAR
        path.write_text(yaml.safe_dump(e), encoding="utf-8")
    output = said(command, str(folder))
    assert output and not {c for c in output if not c.isprintable() and c != "\n"}


def test_a_config_of_a_stranger_is_shown_escaped(tmp_path: Path) -> None:
    e = yaml.safe_load((ROOT / "config/uno.yaml").read_text(encoding="utf-8"))
    e["daq"]["port"] = f"/dev/{CLEAR}"
    path = tmp_path / "config.yaml"
    path.write_text(yaml.safe_dump(e), encoding="utf-8")
    for command in ("check", "doctor", "run"):
        output = said(command, str(path))
        assert SHOWN in output and "\x1b" not in output
