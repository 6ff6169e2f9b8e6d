"""The tables of registers against the ``.model`` files of dynamixel-sdk, and by themselves."""

from __future__ import annotations

import random
from itertools import pairwise
from pathlib import Path

import dynamixel_easy_sdk
import pytest

from rig.backends.servo.models import MODELS, Register, ServoModel, models_of
from rig.backends.servo.registers import servo_map

FOLDER = Path(dynamixel_easy_sdk.__file__).parent / "control_table"
# The e-Manual has them; the files have not.
NOT_IN_FILES = {"startup_configuration", "backup_ready"}
NOT_NUMBERED = {"xw430-t200": 1280}  # their list has not, and the e-Manual has
RENAMED = {"secondary(shadow)_id": "secondary_id"}
DYNAMIXELS = [name for name, model in MODELS.items() if model.protocol == "dynamixel"]


def _file(name: str) -> tuple[dict[str, tuple[int, int]], dict[str, float]]:
    """Address and size by name, and units, of one of their files; indirect addresses left out."""
    section, table, units = "", {}, {}
    for line in (FOLDER / f"{name.replace('-', '_')}.model").read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            section = line.strip("[] ")
            continue
        words = line.split("\t")
        if section == "control table" and words[0].isdigit() and not words[2].startswith("Indirect"):
            key = words[2].strip().lower().replace(" ", "_")
            table[RENAMED.get(key, key)] = int(words[0]), int(words[1])
        if section == "unit info" and len(words) > 2 and words[2] == "rad/s":
            units[words[0].lower().replace(" ", "_")] = float(words[1])
    return table, units


@pytest.mark.parametrize("name", DYNAMIXELS)
def test_each_register_is_where_their_file_has_it(name: str) -> None:
    theirs, units = _file(name)
    ours = {r.name: (r.address, r.size) for r in MODELS[name].registers.values() if r.name not in NOT_IN_FILES}
    assert ours == theirs
    for register, scale in units.items():
        assert MODELS[name][register].scale == scale
        assert MODELS[name][register].kind == "int32"


def test_each_number_is_theirs() -> None:
    """dynamixel.model: number and file."""
    lines = (FOLDER / "dynamixel.model").read_text(encoding="utf-8").splitlines()[1:]
    theirs = {line.split("\t")[1].removesuffix(".model"): int(line.split("\t")[0]) for line in lines}
    for name in DYNAMIXELS:
        assert MODELS[name].number == (NOT_NUMBERED.get(name) or theirs[name.replace("-", "_")])
        assert models_of(MODELS[name].number, "dynamixel") == [MODELS[name]]


@pytest.mark.parametrize("model", MODELS.values(), ids=str)
def test_a_table_is_whole(model: ServoModel) -> None:
    registers = list(model.registers.values())
    for first, second in pairwise(registers):
        assert first.end <= second.address, "they overlap, or are not in order"
    for role, name in model.roles.items():
        assert model.role(role) is model[name]
    for register in registers:
        assert model.at(register.address) is register and model.at(register.end - 1) is register
        for value in (register.shipped, register.low, register.high):
            if value is not None:
                assert register.unpack(register.pack(value)) == value
    read = servo_map(model).read
    seen = model.unpack(bytes(read.words), read.address)
    assert {model.roles[role] for role in ("position", "applied", "velocity", "voltage", "temperature")} <= seen.keys()
    assert model.is_eeprom(model.role("mode")) and not model.is_eeprom(model.role("torque"))
    assert model["model_number"].shipped == model.number


def test_the_slope_of_the_330() -> None:
    """e-Manual: 140 of 1.977 mV/ms take 5 V in 18 ms; the 12 V servos have another unit."""
    slope = MODELS["xl330-m288"].role("slope")
    assert slope.shipped is not None and 5.0 / (slope.shipped * slope.scale) == pytest.approx(0.01806, abs=1e-5)
    assert MODELS["xc330-t288"].role("slope").scale == pytest.approx(2.0 * slope.scale, rel=1e-3)
    assert "slope" not in MODELS["xl430-w250"].roles


@pytest.mark.parametrize(
    ("kind", "value", "raw"),
    [
        ("uint8", 255, "ff"),
        ("int8", -1, "ff"),
        ("int16", -885, "8bfc"),
        ("uint16", 885, "7503"),
        ("int32", -2, "feffffff"),
        ("sign10", -300, "2c05"),
        ("sign11", -1, "0108"),
        ("sign15", -1, "0180"),
    ],
)
def test_kinds(kind: str, value: int, raw: str) -> None:
    register = Register("r", 0, kind)  # type: ignore[arg-type]
    assert register.pack(value) == bytes.fromhex(raw)
    assert register.unpack(bytes.fromhex(raw)) == value
    for beyond in (register.least - 1, register.most + 1):
        with pytest.raises(ValueError, match="cannot hold"):
            register.pack(beyond)
    with pytest.raises(ValueError, match="bytes, not"):
        register.unpack(bytes(9))


@pytest.mark.parametrize("name", ["xl330-m288", "sts3215"])
def test_a_reading_taken_apart_at_once_says_what_each_register_says(name: str) -> None:
    span, rng, refused = servo_map(MODELS[name]).read, random.Random(1), 0
    for _ in range(200):
        data = rng.randbytes(span.words)
        cells = {r: data[r.address - span.address :][: r.words] for r in span.registers}
        try:
            said = {r.name: r.unpack(own) for r, own in cells.items()}
        except ValueError:
            refused += 1  # bits above a sign
            with pytest.raises(ValueError, match="above its sign"):
                span.values(data)
        else:
            assert span.values(data) == said
    assert (refused > 0) == (name == "sts3215")
    with pytest.raises(ValueError, match="bytes where"):
        span.values(data[:-1])
