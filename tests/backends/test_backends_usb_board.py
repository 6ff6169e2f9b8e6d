"""Which board it is: its USB serial number, kept in the config, and every command that opens a board heeds it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import serial
from command_line import rig
from raised import fault_of
from serial.tools import list_ports

from rig.backends.links import usb_port as module
from rig.backends.registry import connect, unopened
from rig.config import Experiment, load, ready
from rig.config.edit import Value, with_values
from rig.config.problems import Path as Keys
from rig.running.calibrate.session import open_config
from rig.running.preflight import check, preflight
from rig.running.preflight.plan import notes

CONFIGS = Path(__file__).parents[2] / "config"
MINE, OTHER = "55736313838351E0F1A1", "A9007Uqe"


class Ports:
    """The ports of this machine: device files in a folder, and what is plugged in where."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.opened = folder, list[str]()
        self._ports: list[SimpleNamespace] = []
        monkeypatch.setattr(list_ports, "comports", lambda: self._ports)
        monkeypatch.setattr(module, "_BY_ID", folder / "by-id")
        (folder / "by-id").mkdir()
        self.meanwhile: Callable[[], None] = lambda: None  # what happens while a port is opened
        monkeypatch.setattr(serial, "Serial", self._opens)

    def _opens(self, port: str, *_: object, **__: object) -> SimpleNamespace:
        self.opened.append(port)
        self.meanwhile()
        descriptor = os.open(os.devnull, os.O_RDWR)
        return SimpleNamespace(
            fileno=lambda: descriptor, close=lambda: os.close(descriptor), set_low_latency_mode=lambda _: None
        )

    def plug(self, **numbers: str | None) -> None:
        """From now on these are there: names of ports, and their serial numbers."""
        self._ports = [
            SimpleNamespace(device=self.path(name), vid=0x2341, pid=0x0043, serial_number=number)
            for name, number in numbers.items()
        ]
        for name in numbers:
            Path(self.path(name)).touch()

    def path(self, name: str) -> str:
        return str(self.folder / name)


@pytest.fixture
def ports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Ports:
    folder = tmp_path / "dev"
    folder.mkdir()
    return Ports(folder, monkeypatch)


def bench_at(port: str, number: str | None, config: str = "uno") -> Experiment:
    data = load(CONFIGS / f"{config}.yaml").model_dump(mode="json", exclude_none=True)
    data["daq"] |= {"port": port} | ({} if number is None else {"usb_serial": number})
    return Experiment.model_validate(data)


@pytest.mark.parametrize("config", ["uno", "modbus-rtu"])
def test_swapped_boards_are_refused_before_they_are_opened_and_the_right_one_is_named(
    ports: Ports, config: str
) -> None:
    one, other = ports.path("ttyACM0"), ports.path("ttyACM1")
    ports.plug(ttyACM0=MINE, ttyACM1=OTHER)
    with unopened(bench_at(one, MINE, config).device):
        assert ports.opened == [one]
    ports.plug(ttyACM0=OTHER, ttyACM1=MINE)
    for opens in (unopened, connect):
        fault = fault_of(opens(bench_at(one, MINE, config).device).__enter__)
        assert fault.code == "OTHER_BOARD"
        assert f"{one} has serial number {OTHER} on USB, and this config is for {MINE}" in fault.detail
        assert fault.detail.endswith(f"which is at {other} now: daq.port: {other}")
    (lasting := ports.folder / "by-id" / f"usb-Arduino_{MINE}-if00").symlink_to(other)
    assert f"daq.port: {lasting}" in fault_of(unopened(bench_at(one, MINE, config).device).__enter__).detail
    assert ports.opened == [one], "to open a board resets it"
    with unopened(bench_at(str(lasting), MINE, config).device):
        pass  # by its lasting name, wherever it is


@pytest.mark.parametrize("config", ["uno", "modbus-rtu"])
def test_a_board_that_comes_to_the_port_while_it_is_opened_is_refused(ports: Ports, config: str) -> None:
    ports.plug(ttyACM0=MINE)
    ports.meanwhile = lambda: ports.plug(ttyACM0=OTHER)
    fault = fault_of(unopened(bench_at(ports.path("ttyACM0"), MINE, config).device).__enter__)
    assert fault.code == "OTHER_BOARD" and f"serial number {OTHER}" in fault.detail
    assert ports.opened == [ports.path("ttyACM0")]


@pytest.mark.parametrize("number", [None, "", "0001", OTHER])
def test_a_board_that_is_not_there_and_one_without_a_number_are_told_apart(ports: Ports, number: str | None) -> None:
    ports.plug(ttyACM0=number)
    fault = fault_of(unopened(bench_at(ports.path("ttyACM0"), MINE).device).__enter__)
    assert fault.code == "OTHER_BOARD" and "which is not plugged in" in fault.detail
    new = f'daq.usb_serial: "{OTHER}"' if number == OTHER else "leave it out"
    assert fault.detail.endswith(f"If the bench has a new board: {new}")
    assert ports.opened == []


@pytest.mark.parametrize(
    "number", ["A1\u00e9", "\u4e2d\u6587", "A\tB", "A\x1b[31m", "x" * 127, "\u200b", "x" * 126, ' a"1: ']
)
def test_a_number_that_no_config_takes_is_none(ports: Ports, number: str) -> None:
    """Else `rig init` wrote it, and `rig check` refused it."""
    ports.plug(ttyACM0=number)
    found = module.usb_port(ports.path("ttyACM0")).serial_number
    assert (found is not None) == (number in ("x" * 126, ' a"1: '))
    with unopened(bench_at(ports.path("ttyACM0"), found).device):
        pass


def test_a_config_without_a_number_takes_any_board_and_check_advises(ports: Ports) -> None:
    port = ports.path("ttyACM0")

    def advice(e: Experiment) -> list[str]:
        return [note for note in notes(e.device) if "for this bench's" in note]

    ports.plug(ttyACM0=MINE)
    e = bench_at(port, None)
    with unopened(e.device):
        assert ports.opened == [port]
    assert ["`rig calibrate` puts the number in" in note for note in advice(e)] == [True]
    assert advice(bench_at(port, MINE)) == []
    ports.plug(ttyACM0=None)
    assert ["has no serial number of its own" in note for note in advice(e)] == [True]
    ports.plug()
    assert advice(e) == [], "nothing says that it is on USB"
    for name in ("/dev/ttyUSB7", "/dev/serial/by-id/usb-1a86_USB_Serial-if00"):
        assert ["daq.usb_serial is not given" in note for note in advice(bench_at(name, None))] == [True]
    for name in ("simulated", "demo", "modbus-tcp"):
        assert advice(load(CONFIGS / f"{name}.yaml")) == []


@pytest.mark.parametrize("name", ["simulated", "demo", "modbus-tcp"])
def test_a_bench_that_is_not_on_usb_has_no_such_number(name: str) -> None:
    data = load(CONFIGS / f"{name}.yaml").model_dump(mode="json", exclude_none=True)
    data["daq"]["usb_serial"] = MINE
    found = [problem.key for problem in preflight(Experiment.model_validate(data)).problems]
    assert "daq.usb_serial" in found


def test_init_and_calibrate_keep_the_number_of_the_board_that_is_there(ports: Ports, tmp_path: Path) -> None:
    port, file = ports.path("ttyACM0"), tmp_path / "bench.yaml"
    ports.plug(ttyACM0="12345678")  # a number that YAML would take for one
    made = rig("init", file, "--yes", "--bridge", "l298n", "--no-load-rpm", 590, "--port", port)
    assert made.exit_code == 0, made.output
    assert "for the board with USB serial number 12345678, and for no other" in made.stdout
    assert f"rig flash {file}" in made.stdout, "which takes port and number from it"
    assert check(file)[0].daq.usb_serial == "12345678"
    assert open_config(file).draft.changes == {}, "it is there"
    bare = tmp_path / "bare.yaml"
    bare.write_text(with_values(ready.text("uno"), {("daq", "port"): port}), encoding="utf-8")
    assert open_config(bare).draft.changes == {("daq", "usb_serial"): "12345678"}
    ports.plug(ttyACM0=None)
    assert open_config(bare).draft.changes == {}
    made = rig("init", tmp_path / "none.yaml", "--yes", "--bridge", "l298n", "--no-load-rpm", 590, "--port", port)
    assert "has no serial number on USB" in made.stdout or "no board is at" in made.stdout
    assert check(tmp_path / "none.yaml")[0].daq.usb_serial is None
    simulated = tmp_path / "simulated.yaml"
    simulated.write_text(ready.text("simulated"), encoding="utf-8")
    assert open_config(simulated).draft.changes == {}


@pytest.mark.parametrize(
    "arguments",
    [
        "run {config}",
        "relay {config}",
        "survey {config}",
        "jog {config} --u-V 0.3",
        "home {encoder} --here",
        "doctor {config} --seconds 0.2",
    ],
)
def test_each_command_heeds_the_number(ports: Ports, tmp_path: Path, arguments: str) -> None:
    ports.plug(ttyACM0=OTHER)
    values: dict[Keys, Value] = {("daq", "port"): ports.path("ttyACM0"), ("daq", "usb_serial"): MINE}
    (tmp_path / "config.yaml").write_text(with_values(ready.text("uno"), values), encoding="utf-8")
    encoder: dict[Keys, Value] = {**values, ("drive", "bridge"): "in1-in2"}
    (tmp_path / "encoder.yaml").write_text(with_values(ready.text("encoder"), encoder), encoding="utf-8")
    files = {name: tmp_path / f"{name}.yaml" for name in ("config", "encoder")}
    done = rig(*arguments.format(**files).split(), *(() if "home" in arguments else ("--out", tmp_path / "runs")))
    assert done.exit_code == 1, done.output
    assert "OTHER_BOARD" in done.output and MINE in done.output
    assert ports.opened == []


def test_flash_finds_the_board_by_its_number_and_writes_to_no_other(ports: Ports) -> None:
    ports.plug(ttyACM0=OTHER, ttyACM1=MINE)
    one, other = ports.path("ttyACM0"), ports.path("ttyACM1")
    found = rig("flash", "--dry-run", "--usb-serial", MINE, "--hex", __file__)
    assert f"-P {other} " in found.output
    assert f"-P {other} " in rig("flash", "--dry-run", "--usb-serial", MINE, "--port", other, "--hex", __file__).output
    refused = rig("flash", "--dry-run", "--usb-serial", MINE, "--port", one, "--hex", __file__)
    assert refused.exit_code == 1 and "OTHER_BOARD" in refused.output and other in refused.output
    absent = rig("flash", "--dry-run", "--usb-serial", "none", "--hex", __file__)
    assert absent.exit_code == 1 and "no port of this machine has serial number none" in absent.output
