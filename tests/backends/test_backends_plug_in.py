"""A plug-in driver from the config to the bench: what is checked, what is refused, and in which words."""

from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner
from plug_in_cards import VirtualCard

from rig import config
from rig.backends import plug_in
from rig.backends.clock import MonotonicClock, VirtualClock
from rig.backends.driver import DriverSettings
from rig.backends.plug_in import driver_settings_of
from rig.backends.registry import connect
from rig.cli import main
from rig.config.load import json_schema
from rig.core.faults import Fault
from rig.running.preflight import check

SOURCE = Path(__file__).parent.parent / "testing/virtual-card.yaml"


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two packages with drivers: one in virtual time, one without a watchdog."""
    entries = [
        EntryPoint("virtual-card", "plug_in_cards:VirtualCard", plug_in.GROUP),
        EntryPoint("bare-card", "plug_in_cards:BareCard", plug_in.GROUP),
    ]
    monkeypatch.setattr(plug_in, "entry_points", lambda group: entries)


def written(tmp_path: Path, **changes: object) -> Path:
    """The config with changes to its section daq; None leaves a key out. Others as section__key."""
    data = yaml.safe_load(SOURCE.read_text(encoding="utf-8"))
    for key, value in changes.items():
        section, _, name = key.rpartition("__")
        data[section or "daq"][name] = value
    data["daq"] = {key: value for key, value in data["daq"].items() if value is not None}
    path = tmp_path / "card.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path


def refused(tmp_path: Path, *, command: str = "check", **changes: object) -> tuple[str, str]:
    """The one line that a command says of a bad config."""
    path = written(tmp_path, **changes)
    result = CliRunner().invoke(main, [command, str(path), *(["--out", str(tmp_path)] if command == "run" else [])])
    assert result.exit_code == 2, result.output
    (line,) = result.stderr.splitlines()
    place, _, words = line.removeprefix(f"{path}:").partition(": ")
    row = int(place.split(":")[0])
    return path.read_text(encoding="utf-8").splitlines()[row - 1].strip(), words


def test_check_says_what_is_known_and_what_is_not(installed: None, tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["check", str(written(tmp_path))])
    assert result.exit_code == 0, result.stderr
    assert "backend: plug-in driver virtual-card: assume a REAL MOTOR, every 10 ms" in result.stdout
    assert "link: the budget of a plug-in driver is not known; `rig doctor` measures it" in result.stdout
    assert "failsafe: the plug-in driver's; if its device has none, a run is refused" in result.stdout
    assert "driver 'virtual-card' (plug_in_cards:VirtualCard): sample first" in result.stdout
    assert "failsafe before it is opened: 0 V after 1000 ms of silence" in result.stdout


@pytest.mark.parametrize("command", ["check", "run"])
@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("virtual-cart", "did you mean 'virtual-card'?"),
        ("simulatd", "did you mean 'simulated'?"),
        ("labjack", "install the package that offers it (docs/plug-in-driver.md)"),
    ],
)
def test_an_unknown_driver_lists_those_that_there_are(
    installed: None, tmp_path: Path, command: str, name: str, hint: str
) -> None:
    line, words = refused(tmp_path, command=command, driver=name)
    assert line == f"driver: {name}"
    assert words == (
        f"daq.driver: no driver '{name}'; built in: simulated, serial, modbus, servo; plug-ins installed: bare-card, "
        f"virtual-card; {hint}"
    )


def test_with_no_plug_in_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(plug_in, "entry_points", lambda group: [])
    assert "; plug-ins installed: none; " in refused(tmp_path)[1]
    with pytest.raises(config.ConfigError, match="no driver 'virtual-card'"):
        check(SOURCE)  # nobody said where plug-ins are
    with pytest.raises(config.ConfigError, match="no driver 'virtual-card'"), connect(config.load(SOURCE).device):
        pass


def test_options_that_the_driver_refuses_are_named_with_their_place(installed: None, tmp_path: Path) -> None:
    line, words = refused(tmp_path, options={"sead": 3})
    assert line == "sead: 3"
    assert words == "daq.options: driver 'virtual-card': unknown: sead; known: seed"


def test_a_defect_of_the_plug_in_names_package_and_line(installed: None, tmp_path: Path) -> None:
    _, words = refused(tmp_path, driver="bare-card", options={"mode": "wide"})
    assert words.startswith("daq.driver: driver 'bare-card' (plug_in_cards:BareCard) cannot be constructed: KeyError")
    assert "plug_in_cards.py:" in words


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"port": "/dev/ttyACM0"}, "daq.port: is a key of built-in drivers, not of `virtual-card`; see daq.options"),
        ({"relay__where": "device"}, "relay.where: driver 'virtual-card' has no relay in its device; set it to host"),
    ],
)
def test_keys_that_do_not_go_with_a_plug_in(
    installed: None, tmp_path: Path, changes: dict[str, str], words: str
) -> None:
    assert refused(tmp_path, **changes)[1] == words


def test_a_device_without_strokes_is_refused_where_tests_are_designed_in_it(
    installed: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class WithRelay(VirtualCard):
        tick_s = 0.001
        relay_command = start_relay = keep = read_rows = stop_relay = lambda self, *of: None

    monkeypatch.setattr("plug_in_cards.VirtualCard", WithRelay)
    data = yaml.safe_load(SOURCE.read_text(encoding="utf-8"))
    path = tmp_path / "card.yaml"
    path.write_text(yaml.safe_dump(data | {"relay": {"where": "device", "until": {}}}), encoding="utf-8")
    result = CliRunner().invoke(main, ["check", str(path)])
    assert result.exit_code == 2
    assert "driver 'virtual-card' runs no strokes in its device; relay.until does; set it to host" in result.stderr


def test_check_constructs_the_driver_once_and_a_changed_config_anew(
    installed: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[object] = []

    class Counted(VirtualCard):
        def __init__(self, settings: DriverSettings) -> None:
            made.append(settings.options)
            super().__init__(settings)

    monkeypatch.setattr("plug_in_cards.VirtualCard", Counted)
    path = written(tmp_path, options={"seed": 3})
    check(path)
    assert made == [{"seed": 3}]
    check(written(tmp_path, options={"seed": 4}))
    assert made == [{"seed": 3}, {"seed": 4}]


def test_options_are_of_plug_ins_only(tmp_path: Path) -> None:
    line, words = refused(
        tmp_path, driver="serial", port="/dev/ttyACM0", adapter="none", options={"seed": 1}, drive__bridge="pwm-dir"
    )
    assert line == "seed: 1"
    assert words == "daq.options: is a key of plug-in drivers, not of `driver: serial`; remove it"


def test_options_arrive_as_written_and_survive_the_resolved_config(installed: None, tmp_path: Path) -> None:
    options = {"seed": 3, "deep": {"list": [1, 2.5, "x", True, None]}}
    e = config.load(written(tmp_path, options=options))
    settings = driver_settings_of(e.device)
    assert dict(settings.options) == options
    assert (settings.period_s, settings.watchdog_s, settings.timeout_s) == (0.01, 0.1, 0.03)
    assert (settings.counts_max, settings.rail_counts) == (1023, (5, 1018))
    assert settings.calibration.to_rad(512.0) == 0.0
    assert settings.drive_map.full_V == 12.0
    with pytest.raises(TypeError):
        settings.options["seed"] = 4  # type: ignore[index]  # which a reader of types is told, too
    again = tmp_path / "again.yaml"
    again.write_text(config.dump(e), encoding="utf-8")
    assert config.load(again) == e


def test_a_driver_lives_in_its_own_clock_or_in_the_hosts(installed: None, tmp_path: Path) -> None:
    with connect(config.load(written(tmp_path)).device) as bench:
        assert isinstance(bench.driver, VirtualCard)
        assert isinstance(bench.clock, VirtualClock)
        assert bench.clock is bench.driver.clock
        assert bench.truth is None
    with connect(config.load(written(tmp_path, driver="bare-card", accept_no_watchdog=True)).device) as bench:
        assert isinstance(bench.clock, MonotonicClock)


def test_a_device_without_a_watchdog_needs_leave(installed: None, tmp_path: Path) -> None:
    with pytest.raises(Fault, match="NO_WATCHDOG"), connect(config.load(written(tmp_path, driver="bare-card")).device):
        pass
    path = written(tmp_path, driver="bare-card", accept_no_watchdog=True)
    lines = check(path)[1].lines
    assert any("drives all the same (daq.accept_no_watchdog: true)" in line for line in lines)


def test_any_name_is_valid_for_editors() -> None:
    schema: Any = json_schema()
    daq = schema["$defs"]["Daq"]["properties"]
    assert daq["driver"]["examples"] == ["simulated", "serial", "modbus", "servo"]
    assert "enum" not in daq["driver"]
    assert daq["options"]["anyOf"][0]["additionalProperties"] is True
