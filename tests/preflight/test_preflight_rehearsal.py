"""A rehearsal: the config's own bench on an emulated device, and a motor made from its data sheet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rig import config
from rig.config import ConfigError, Experiment
from rig.config.edit import Value, changed
from rig.config.problems import Path as Key
from rig.run_folder.results import JsonObject
from rig.running.preflight import DataSheet, SheetError, check, rehearsed

ROOT = Path(__file__).resolve().parents[2]
NOTHING = DataSheet()


def rehearsal(name: str, sheet: DataSheet = NOTHING, values: Mapping[Key, Value] | None = None) -> Experiment:
    """A ready config, with these values, rehearsed."""
    document = config.read(ROOT / "config" / f"{name}.yaml")
    document = replace(document, data=changed(document.data, values or {}))
    return rehearsed(document, sheet)


def no_load_rad_s(e: Experiment) -> float:
    """Speed of the measured shaft at the config's supply."""
    assert e.emulated is not None
    motor = e.emulated.motor
    return motor.K_rad_s_V * (e.drive.supply_V - 0.5 * (motor.fc_plus_V + motor.fc_minus_V))


def test_all_but_the_device_is_the_configs_own() -> None:
    own, found = check(ROOT / "config/uno.yaml")[0], rehearsal("uno")
    assert found.emulated is not None and found.emulated.rehearsal
    assert (found.daq.port, found.daq.adapter, found.emulated.drive_counts) == ("emulated", "16u2", 400)
    assert own.model_copy(update={"daq": None, "emulated": None}) == found.model_copy(
        update={"daq": None, "emulated": None}
    )
    assert own.daq.model_copy(update={"port": "emulated"}) == found.daq


def test_without_a_data_sheet_the_motor_is_typical_and_as_fast_as_the_config_says() -> None:
    found = rehearsal("uno")
    assert found.emulated is not None and found.motor is not None
    motor = found.emulated.motor
    assert no_load_rad_s(found) == pytest.approx(found.motor.no_load_speed_rad_s, rel=1e-3)
    assert motor.tau_s == 0.5 * found.limits.coast_tau_s
    assert motor.fc_plus_V + motor.fc_minus_V == pytest.approx(2.0 * 0.05 * 12.0)
    assert (motor.fs_plus_V or 0.0) > motor.fc_plus_V > motor.fc_minus_V
    assert motor.stop_rad[1] > found.limits.hard_rad[1]


def test_a_data_sheet_gives_the_speed_behind_the_gear_at_its_own_supply() -> None:
    found = rehearsal("uno", DataSheet(rated_V=24.0, no_load_rpm=10_000.0, gear=20.0, friction_V=0.4, tau_s=0.05))
    assert found.emulated is not None
    motor = found.emulated.motor
    assert motor.K_rad_s_V * (24.0 - 0.4) == pytest.approx(10_000.0 * math.tau / 60.0 / 20.0, rel=1e-3)
    assert motor.tau_s == 0.05
    assert motor.fc_plus_V + motor.fc_minus_V == pytest.approx(2.0 * 0.4)


def test_a_motor_that_is_there_already_is_taken_and_options_change_what_they_say() -> None:
    own = check(ROOT / "config/demo.yaml")[0]
    assert own.emulated is not None
    found, slower = rehearsal("demo"), rehearsal("demo", DataSheet(tau_s=0.1))
    assert found.emulated == own.emulated.model_copy(update={"rehearsal": True})
    assert slower.emulated is not None
    assert slower.emulated.motor == own.emulated.motor.model_copy(update={"tau_s": 0.1})


@pytest.mark.parametrize(
    ("name", "port", "becomes"),
    [
        ("modbus-rtu", "/dev/ttyUSB0", "emulated"),
        ("modbus-tcp", "tcp://192.168.0.5:502", "emulated-tcp"),
        ("modbus-tcp", "emulated-tcp-realtime", "emulated-tcp"),
        ("demo", "emulated-realtime", "emulated"),
        ("encoder", "emulated-chip-realtime", "emulated-chip"),
        ("pico", "/dev/serial/by-id/pico", "emulated"),
    ],
)
def test_each_device_has_its_emulated_one_in_virtual_time(name: str, port: str, becomes: str) -> None:
    values: dict[Key, Value] = {("daq", "port"): port}
    if name == "pico":
        values[("daq", "usb_serial")] = "E660"
    found = rehearsal(name, values=values)
    assert (found.daq.port, found.daq.usb_serial) == (becomes, None)
    if name == "pico":
        assert found.emulated is not None and found.emulated.drive_counts == 6250


@pytest.mark.parametrize("name", ["uno", "modbus-rtu", "servo"])
def test_a_bench_whose_port_is_not_known_yet_is_rehearsed(name: str) -> None:
    document = config.read(ROOT / "config" / f"{name}.yaml")
    own = document.data["daq"]
    assert isinstance(own, dict)
    daq: JsonObject = {key: value for key, value in own.items() if key != "port"}
    assert rehearsed(replace(document, data={**document.data, "daq": daq}), NOTHING) == rehearsal(name)
    with pytest.raises(ConfigError, match=r"daq.port: no emulated-none"):
        rehearsal(name, values={("daq", "port"): "emulated-none"})


def test_a_device_that_rig_does_not_emulate_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.backends.serial.backend.SerialBackend.rehearsed", lambda self, e: None)
    with pytest.raises(ConfigError, match=r"uno.yaml:.*: daq.driver: rig has no emulated device.*driver: simulated"):
        rehearsal("uno")


@pytest.mark.parametrize(
    ("sheet", "says"),
    [
        ({"rated_V": 0.0, "no_load_rpm": 5000.0, "gear": 10.0}, "--rated-V 0 V is no motor's"),
        ({"no_load_rpm": 5000.0}, "--no-load-rpm is the speed of the motor's own shaft.*\n.*--gear 1 where"),
        ({"no_load_rpm": 5000.0, "gear": math.nan}, "--gear nan is no motor's"),
        ({"gear": 10.0}, "--gear says nothing without --no-load-rpm"),
        ({"tau_s": -1.0}, "--tau-s -1 s is no motor's"),
        ({"friction_V": 12.0}, "friction of 12 V takes the whole supply of 12 V"),
    ],
)
def test_numbers_that_make_no_motor_are_refused(sheet: dict[str, Any], says: str) -> None:
    with pytest.raises(SheetError, match=says):
        rehearsal("uno", DataSheet(**sheet))


@pytest.mark.parametrize(
    ("sheet", "says"),
    [
        (
            {"no_load_rpm": 8000.0, "gear": 10.0},
            r"uno.yaml:\d+:\d+: motor.no_load_speed_rad_s: this motor turns .* at 83.8 rad/s at 12 V, more than 62",
        ),
        ({"tau_s": 0.4}, r"limits.coast_tau_s: this motor's time constant is 0.4 s, longer than 0.2: .*coasts 1.8 rad"),
        ({"friction_V": 1.5}, r"breakaway.max_V: 1.5 V does not move this motor, whose static friction is 1.69 V"),
        (
            {"no_load_rpm": 5000.0, "gear": 50.0, "tau_s": 0.2, "friction_V": 1.0},
            r"relay.target: to swing 0.45 rad every 1.6 s this motor needs about 3.6 V, and drive.max_V is 3",
        ),
    ],
)
def test_a_motor_that_the_config_does_not_fit_is_refused_with_the_key(sheet: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        rehearsal("uno", DataSheet(**sheet))
