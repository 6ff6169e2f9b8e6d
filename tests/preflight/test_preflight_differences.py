"""The emulated bench is what the config believes, unless its own section says otherwise; then `rig check` says it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from command_line import rig

from rig.backends.backend import truth_of
from rig.config import Experiment, load
from rig.config.schema import Emulated, EmulatedPotentiometer
from rig.model.bench import BenchModel
from rig.model.real_motor import Frame, MovingMotor, plain
from rig.running.preflight.plan import differences

ROOT = Path(__file__).resolve().parents[2]
NOTE_ON_PARTS = "the emulated motor has parts that tau, K and f_c leave out (emulated.motor.parts"
SHIPPED = sorted(path.name for path in (ROOT / "config").glob("*.yaml") if "emulated:" in path.read_text())

ODD: dict[str, Any] = {
    "sensor": {
        "counts_max": 4095,
        "calibration": [{"counts": 3900, "rad": -2.2}, {"counts": 200, "rad": 2.0}],
        "rail_counts": [20, 4070],
    },
    "drive": {
        "supply_V": 10.0, "bridge_drop_V": 1.4, "dead_band_duty": {"plus": 0.03, "minus": 0.05}, "max_V": 3.0,
        "reversed": True,
    },
    "tachometer": {"rad_s_per_count": 0.02, "zero_counts": 2048.0},
}  # fmt: skip


def changed(emulated: dict[str, Any] | None = None, **sections: Any) -> dict[str, Any]:
    """config/quick.yaml with other sections, and other keys in `emulated`."""
    config = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    config["emulated"] = {"motor": config["emulated"]["motor"]} | (emulated or {})
    return dict(config | sections)


def experiment(emulated: dict[str, Any] | None = None, **sections: Any) -> Experiment:
    return Experiment.model_validate(changed(emulated, **sections))


def test_every_key_that_is_left_out_is_as_the_config_believes() -> None:
    bench = truth_of(experiment(**ODD).device)
    assert bench is not None
    assert bench.rad_per_count == pytest.approx(4.2 / (200 - 3900))
    assert bench.centre_counts == pytest.approx(200 + 2.0 * 3700 / 4.2)
    assert bench.counts_max == 4095
    assert (bench.supply_V, bench.bridge_drop_V) == (10.0, 1.4)
    assert (bench.dead_band_plus, bench.dead_band_minus, bench.reversed) == (0.03, 0.05, True)
    assert (bench.tachometer_rad_s_per_count, bench.tachometer_zero_counts) == (0.02, 2048.0)
    assert list(differences(experiment(**ODD).device)) == []


def test_no_key_is_left_without_a_value() -> None:
    """A key whose default is None takes it from the config: one that is added and forgotten fails here."""
    emulated = experiment().emulated
    assert emulated is not None
    for section, of in ((emulated, Emulated), (emulated.potentiometer, EmulatedPotentiometer)):
        taken = [name for name, field in of.model_fields.items() if not field.is_required() and field.default is None]
        assert taken
        other_sensor = {"encoder"} if experiment().sensor.encoder is None else set()
        other_sensor |= {"coasting"}  # None is a bridge that brakes: old run folders do not have the key
        other_sensor |= {"rehearsal"}  # None is none
        assert all(getattr(section, name) is not None for name in set(taken) - other_sensor)


@pytest.mark.parametrize("name", SHIPPED)
def test_the_configs_of_the_project_mean_what_they_did(name: str) -> None:
    """What was a fixed default until the config was asked."""
    read = load(ROOT / "config" / name)
    bench = truth_of(read.device)
    assert bench is not None
    if name == "demo-pico.yaml":  # 12 bits
        assert (bench.rad_per_count, bench.centre_counts, bench.counts_max) == (4.2 / 4096, 2048.0, 4095)
    elif read.sensor.servo is not None:
        assert (bench.encoder, bench.centre_counts) == (True, 0.0)
        assert bench.rad_per_count == pytest.approx(math.tau / 4096)
        assert bench.supply_V == {"servo.yaml": 5.0, "servo-sts3215.yaml": 7.4}[name]
        return
    elif read.sensor.encoder is None:
        assert (bench.rad_per_count, bench.centre_counts, bench.counts_max) == (4.2 / 1024, 512.0, 1023)
    else:
        assert (bench.encoder, bench.centre_counts) == (True, 0.0)
        assert bench.rad_per_count == pytest.approx(math.tau / 3200)
    assert (bench.supply_V, bench.bridge_drop_V, bench.dead_band_plus, bench.dead_band_minus) == (12.0, 0.0, 0.0, 0.0)
    assert (bench.reversed, bench.tachometer_rad_s_per_count) == (False, None)
    parts = read.emulated is not None and read.emulated.motor.parts is not None
    assert [sentence.split(":")[0] for sentence in differences(read.device)] == ([NOTE_ON_PARTS] if parts else [])


SAYS: dict[str, tuple[dict[str, Any], str]] = {
    "supply": ({"supply_V": 8.0}, "the emulated bridge gives 8 V, by the config it gives 12 V: K and f_c"),
    "drop": ({"bridge_drop_V": 2.0}, "the emulated bridge gives 10 V, by the config it gives 12 V: K and f_c"),
    "dead band": ({"dead_band_duty": {"plus": 0.04}}, "passes nothing below 0.04 and 0 of full duty, drive.dead_band"),
    "turned": ({"reversed": True}, "turns the shaft the opposite way to drive.reversed"),
    "count": (
        {"potentiometer": {"rad_per_count": 0.003636}},
        "one count of the emulated potentiometer is 0.003636 rad, sensor.calibration says 0.00410156 rad: "
        "every position and K will come out 1.128 times the true one",
    ),
    "centre": (
        {"potentiometer": {"centre_counts": 520}},
        "reads 520 counts at position 0, sensor.calibration says 512",
    ),
    "range": ({"potentiometer": {"counts_max": 4095}}, "reads 0 to 4095 counts, sensor.counts_max is 1023"),
    "stops": (
        {"motor": {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_plus_V": 0.5, "fc_minus_V": 0.46, "stop_rad": [-1.5, 2.6]}},
        "meets its mechanical stops at [-1.5, 2.6] rad, inside limits.hard_rad [-1.95, 1.95]",
    ),
}


@pytest.mark.parametrize("told", list(SAYS))
def test_rig_check_notes_what_is_told_otherwise(tmp_path: Path, told: str) -> None:
    emulated, words = SAYS[told]
    (tmp_path / "told.yaml").write_text(yaml.safe_dump(changed(emulated)), encoding="utf-8")
    notes = [line for line in rig("check", tmp_path / "told.yaml").stdout.splitlines() if line.startswith("note: ")]
    assert len(notes) == 1
    assert words in notes[0]


def test_rig_check_notes_a_missing_velocity_channel_and_a_bent_calibration() -> None:
    bent = {"calibration": [{"counts": 24, "rad": -2.0}, {"counts": 512, "rad": 0.1}, {"counts": 1000, "rad": 2.0}]}
    table, tachometer = differences(experiment({"tachometer": False}, sensor=bent, tachometer=ODD["tachometer"]).device)
    assert "no velocity channel" in tachometer
    assert "bends by up to 24.4 counts" in table


def test_a_potentiometer_that_never_moves_is_refused() -> None:
    with pytest.raises(ValueError, match="must not be 0"):
        experiment({"potentiometer": {"rad_per_count": 0.0}})


PARTS = {"backlash_rad": 0.02, "lag_s": 0.005, "drift": 0.1, "drift_over_s": 40.0, "centre_rad": 0.1}


def with_parts(**motor: Any) -> Experiment:
    """An experiment whose true motor has parts."""
    return experiment({"motor": changed()["emulated"]["motor"] | {"parts": PARTS} | motor})


def test_a_motor_with_parts_is_the_given_one_and_its_parts() -> None:
    bench = truth_of(with_parts().device)
    assert bench is not None and bench.real is not None
    assert bench.real == plain(bench.motor)._replace(backlash_rad=0.02, lag_s=0.005, drift=0.1)
    assert bench.frame == Frame(0.1, 1.0, 0.0, 40.0)
    (said,) = differences(with_parts().device)
    assert "emulated.motor.parts: lag_s 0.005, backlash_rad 0.02, drift 0.1" in said
    without = truth_of(experiment().device)
    assert without is not None and without.real is None


def test_a_bench_with_parts_moves_as_its_motor() -> None:
    bench = truth_of(with_parts().device)
    assert bench is not None and bench.real is not None
    model, moving = BenchModel(bench, 1), MovingMotor(bench.real, bench.frame, bench.start_rad)
    model.arm()
    for tick in range(100):
        model.pin_counts = 120.0 if tick % 20 < 12 else -90.0
        moving.advance(model.motor_V, tick * 0.01, 0.01)
        model.advance(0.01)
        assert model.sensed_rad == pytest.approx(moving.reading_rad, abs=1e-12)
    model.pin_counts = 400.0
    for _ in range(200):
        model.advance(0.01)
    assert model.state.y == bench.stop_rad[1] and model.state.v == 0.0
    assert model.sensed_rad == pytest.approx(bench.stop_rad[1] - 0.01)
