"""`rig doctor` as it is typed."""

import json
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner, Result

from emulated_chips.opening import emulated_chip
from rig.backends.servo.emulated.bus import LineTimes
from rig.backends.servo.emulated.virtual_bus import VirtualServoBus
from rig.backends.servo.line import emulated_servo
from rig.cli import main
from rig.config import load
from rig.testing.line import on_device

ROOT = Path(__file__).parents[2]


def doctor(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["doctor", "--seconds", "0.2", *map(str, arguments)])


def config_with(tmp_path: Path, name: str, **daq: object) -> Path:
    document = yaml.safe_load((ROOT / "config" / name).read_text(encoding="utf-8"))
    document["daq"].update(daq)
    path = tmp_path / name
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


def test_a_machine_by_itself() -> None:
    done = doctor("--json")
    found = json.loads(done.stdout)["findings"]
    assert {"kernel", "real time", "governor", "disk", "wake-up"} <= {f["topic"] for f in found}


def test_virtual_time_has_nothing_to_measure_and_names_what_has() -> None:
    for name, other in (("simulated", ""), ("demo", "emulated-realtime"), ("modbus-tcp", "emulated-tcp-realtime")):
        done = doctor(ROOT / "config" / f"{name}.yaml")
        assert done.exit_code == 0
        assert "virtual time" in done.stdout
        assert ("daq.port" in done.stdout) == bool(other) and other in done.stdout


@pytest.mark.realtime
@pytest.mark.parametrize(("name", "words"), [
    ("demo.yaml", "host board"), ("servo.yaml", "0.5 ms (return delay) = 1.12 ms"),
])  # fmt: skip
def test_a_device_is_met_and_timed_but_not_armed(name: str, words: str, tmp_path: Path) -> None:
    done = doctor(config_with(tmp_path, name, port="emulated-realtime"), "--json")
    found = {f["topic"]: f for f in json.loads(done.stdout)["findings"]}
    assert words in found["device"]["words"] + found["round trip"]["words"]
    assert "exchanges" in found["round trip"]["words"]
    assert "ticks took" in found["period"]["words"]


@pytest.mark.parametrize("echoes", [False, True])
def test_of_a_servo_it_tells_echo_and_return_delay(echoes: bool) -> None:
    config = ROOT / "config/servo.yaml"
    bus = VirtualServoBus([emulated_servo(load(config).device)], line=LineTimes(echo=echoes))
    with on_device(bus):
        told = " ".join(doctor(config).stdout.split())
    assert ("the adapter ties TX to RX" in told) == echoes and "the servo waits 500 us before it answers" in told


def test_a_port_that_is_not_there_ends_the_visit_with_status_1(tmp_path: Path) -> None:
    done = doctor(config_with(tmp_path, "demo.yaml", port=str(tmp_path / "ttyACM9"), adapter="none"))
    assert done.exit_code == 1
    assert "ttyACM9 is not there" in done.stdout
    assert "wake-up" not in done.stdout


def test_a_port_without_a_device_behind_it_is_a_finding_not_a_traceback(tmp_path: Path) -> None:
    done = doctor(config_with(tmp_path, "demo.yaml", port="/dev/null", adapter="none"))
    assert done.exit_code == 1
    assert "LINK_OPEN" in done.stdout
    assert "->" in done.stdout


def test_without_the_bridge_it_says_which_one_the_firmware_is_for(tmp_path: Path) -> None:
    """No run does without that key; how a person finds out must not."""
    config = config_with(tmp_path, "demo.yaml", port="/dev/null", adapter="none")
    assert CliRunner().invoke(main, ["jog", str(config), "--u-V", "0"]).exit_code == 2
    e = load(config)
    device = emulated_chip(e.model_copy(update={"drive": e.drive.model_copy(update={"bridge": "in1-in2"})}).device)
    with on_device(device, emulated=False):
        done = doctor(config)
    assert done.exit_code == 1
    assert "CONFIG_MISMATCH" in done.stdout and "write bridge: in1-in2" in " ".join(done.stdout.split())


def test_a_bad_config_is_bad_input(tmp_path: Path) -> None:
    assert doctor(config_with(tmp_path, "demo.yaml", bauds=1)).exit_code == 2
