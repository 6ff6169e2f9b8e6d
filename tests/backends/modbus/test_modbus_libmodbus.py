"""Our driver against a slave that is not ours: libmodbus, with a motor of its own (libmodbus_slave/slave.c)."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from libmodbus_peer import EXAMPLE_MAP, LibmodbusSlave

from rig.backends.driver import Driver
from rig.backends.registry import connect
from rig.config import load
from rig.config.schema import Experiment
from rig.control.relay import DualChannelRelay
from rig.core.faults import Fault
from rig.core.signals import Sample

CONFIG = Path(__file__).resolve().parents[3] / "config" / "modbus-rtu.yaml"
SUPPLY_V = 12.0
LINKS = [(kind, requests) for kind in ("rtu", "tcp") for requests in ("read-write", "separate")]
ONE_OF_EACH = [("rtu", "read-write"), ("tcp", "separate")]


def experiment_at(port: str, registers: dict[str, Any] | None = None, **modbus: Any) -> Experiment:
    """The RTU example with another port, and with these keys of `modbus` and its `registers` changed.

    Time-outs are long: this is about what is said, not about how soon, and the machine may be busy.
    """
    data = load(CONFIG).model_dump(mode="json", exclude_none=True)
    data["daq"] |= {"port": port, "timeout_s": 0.3, "watchdog_s": 1.0}
    data["daq"]["modbus"] |= modbus
    data["daq"]["modbus"]["registers"] |= registers or {}
    return Experiment.model_validate(data)


@contextmanager
def opened(experiment: Experiment) -> Iterator[Driver]:
    with connect(experiment.device) as bench:
        bench.driver.arm(experiment.device.arming)
        yield bench.driver


def exchanged(driver: Driver, u_V: float) -> Sample:
    """One tick; the sample that tells of this drive."""
    driver.write(u_V)
    return driver.read()


@pytest.mark.realtime
@pytest.mark.parametrize(("kind", "requests"), LINKS)
def test_every_drive_arrives_once_and_in_order(kind: str, requests: str, tmp_path: Path) -> None:
    draw = random.Random(1)
    commanded_V = [round(draw.uniform(-3.0, 3.0), 3) for _ in range(30)]
    with LibmodbusSlave(kind, *EXAMPLE_MAP, "counts_per_rad=10", log=tmp_path / "executed.csv") as slave:
        with opened(experiment_at(slave.port, requests=requests)) as driver:
            samples, bounds_s = [], []
            for u_V in commanded_V:
                begin_s = time.monotonic()
                samples.append(exchanged(driver, u_V))
                bounds_s.append((begin_s, time.monotonic()))
            before_stop = len(slave.executed())
            stopped = driver.safe_stop()
        executed = slave.executed()
    units = [round(u_V / SUPPLY_V * 10000) for u_V in commanded_V]
    assert [row.drive for row in executed[before_stop - len(units) : before_stop]] == units
    assert all(row.drive == 0 for row in executed[: before_stop - len(units)])  # while arming
    # the slave's clock is ours: when it executed the drive is when the driver says that it did
    for sample, row, (begin_s, end_s) in zip(
        samples, executed[before_stop - len(units) : before_stop], bounds_s, strict=True
    ):
        assert begin_s <= row.t_s + 1e-6
        assert row.t_s - 1e-6 <= end_s
        assert begin_s <= sample.t_u_s <= end_s
    assert [sample.u_V for sample in samples] == pytest.approx([SUPPLY_V * n / 10000 for n in units], abs=1e-12)
    assert stopped
    assert executed[-1].drive == 0
    assert "stopped" in {row.cause for row in executed[before_stop:]}


@pytest.mark.realtime
@pytest.mark.parametrize(("word_order", "reading"), [("high-first", 137), ("low-first", 902)])
@pytest.mark.parametrize(
    ("drive_type", "full", "position_type", "scale", "offset"),
    [
        ("int16", 10000, "int16", 0.02, 512.0),
        ("int32", 3_000_000, "int32", 1e-4, 512.0),
        ("int32", 3_000_000, "uint32", 2.5e-7, 0.0),  # from 2^31 on, too
        ("float32", 1.0, "float32", 243.8, 512.0),  # a duty, and rad
    ],
)
def test_types_and_word_orders_are_those_of_libmodbus(
    drive_type: str,
    full: float,
    position_type: str,
    scale: float,
    offset: float,
    word_order: str,
    reading: int,
    tmp_path: Path,
) -> None:
    registers: dict[str, dict[str, Any]] = {
        "drive": {"address": 0, "type": drive_type, "full": full},
        "sequence": {"address": 2 if drive_type != "int16" else 1, "echo": 22},
        "limits": {"low": 40, "high": 42},
        "max_drive": {"address": 44},
        "rails": {"low": 46, "high": 48},
        "position": {"address": 20, "type": position_type, "scale": scale, "offset_counts": offset},
        "applied": {"address": 24, "type": drive_type},
        "status": {"address": 26},
    }
    slave_map = (
        f"drive=0:{drive_type}", f"sequence={registers['sequence']['address']}", "control=8", "watchdog=9",
        f"low=40:{position_type}", f"high=42:{position_type}", f"max_drive=44:{drive_type}",
        f"rail_low=46:{position_type}", f"rail_high=48:{position_type}",
        f"position=20:{position_type}", "echo=22", f"applied=24:{drive_type}", "status=26",
    )  # fmt: skip
    options = (f"full={full}", f"scale={scale}", f"offset_counts={offset}", f"word_order={word_order}")
    log = tmp_path / "executed.csv"
    # 1e-9 counts a rad: the reading stays where it is
    with (
        LibmodbusSlave("rtu", *slave_map, *options, f"centre={reading}", "counts_per_rad=1e-9", log=log) as slave,
        opened(experiment_at(slave.port, registers, word_order=word_order)) as driver,
    ):
        for u_V in (1.2345, -2.9999, 0.0, -0.0012):
            sample = exchanged(driver, u_V)
            assert sample.y_counts == reading
            acting = slave.executed()[-1].drive / full * SUPPLY_V
            assert acting == pytest.approx(u_V, abs=0.6 * SUPPLY_V / max(full, 10000))
            assert sample.u_V == pytest.approx(acting, abs=1e-6)


@pytest.mark.realtime
def test_a_device_that_is_deaf_after_an_unknown_question_is_met_all_the_same() -> None:
    """Asked who it is, libmodbus refuses over TCP after 0.5 s and drops what came meanwhile; here with our time-out."""
    experiment = load(CONFIG)
    with LibmodbusSlave("tcp", *EXAMPLE_MAP) as slave:
        daq = experiment.daq.model_copy(update={"port": slave.port})
        assert daq.timeout_s < 0.1
        with connect(experiment.model_copy(update={"daq": daq}).device) as bench:
            assert (bench.info.board, bench.info.emulated) == ("Modbus device", False)
            assert bench.driver.link_statistics["timeouts"] >= 1


@pytest.mark.realtime
def test_a_position_in_the_input_registers(tmp_path: Path) -> None:
    registers = {"position": {"address": 16, "type": "uint16", "table": "input"}}
    with (
        LibmodbusSlave("rtu", *EXAMPLE_MAP, "table=input", "centre=345", "counts_per_rad=1e-9") as slave,
        opened(experiment_at(slave.port, registers, requests="separate")) as driver,
    ):
        assert exchanged(driver, 0.5).y_counts == 345


@pytest.mark.realtime
def test_without_any_optional_register() -> None:
    """A plain output and a plain input: no control, no echo, no status; one register, so FC06."""
    data = {"drive": {"address": 0, "full": 10000}, "position": {"address": 16}}
    experiment = experiment_at("unused", requests="separate")
    modbus = experiment.daq.modbus
    assert modbus is not None
    plain = modbus.model_copy(update={"registers": type(modbus.registers).model_validate(data)})
    with LibmodbusSlave("rtu", "drive=0:int16", "position=16", "centre=345") as slave:
        daq = experiment.daq.model_copy(update={"port": slave.port, "modbus": plain, "accept_no_watchdog": True})
        with connect(experiment.model_copy(update={"daq": daq}).device) as bench:
            assert bench.driver.failsafe is None
            bench.driver.arm(experiment.device.arming)
            assert bench.driver.read().y_counts == 345
            assert bench.driver.safe_stop()


@pytest.mark.realtime
@pytest.mark.parametrize(("kind", "requests"), ONE_OF_EACH)
def test_silence_ends_the_drive_and_says_so(kind: str, requests: str, tmp_path: Path) -> None:
    with LibmodbusSlave(kind, *EXAMPLE_MAP, log=tmp_path / "executed.csv") as slave:
        experiment = experiment_at(slave.port, requests=requests)
        experiment = experiment.model_copy(update={"daq": experiment.daq.model_copy(update={"watchdog_s": 0.15})})
        with opened(experiment) as driver:
            exchanged(driver, 1.0)
            while slave.executed()[-1].cause != "silence":
                time.sleep(0.01)
            with pytest.raises(Fault) as caught:
                driver.read()
        executed = slave.executed()
    assert caught.value.code == "DEVICE_WATCHDOG"
    silence = next(k for k, row in enumerate(executed) if row.cause == "silence")
    assert executed[silence].t_s - executed[silence - 1].t_s >= 0.15


@pytest.mark.realtime
@pytest.mark.parametrize(("kind", "requests"), ONE_OF_EACH)
def test_an_exception_names_register_and_cause(kind: str, requests: str) -> None:
    """The slave has registers 0 to 199."""
    registers = {"position": {"address": 300}, "sequence": None, "applied": None, "status": None}
    data = experiment_at("unused", requests=requests).model_dump(mode="json", exclude_none=True)
    data["daq"]["modbus"]["registers"] = {
        name: value
        for name, value in (data["daq"]["modbus"]["registers"] | registers).items()
        if value is not None and name not in ("limits", "rails")
    }
    with LibmodbusSlave(kind, *EXAMPLE_MAP) as slave:
        data["daq"]["port"] = slave.port
        with pytest.raises(Fault) as caught, opened(Experiment.model_validate(data)) as driver:
            driver.read()
    assert caught.value.code == "MODBUS_EXCEPTION"
    for words in ("illegal data address", "position", "300"):
        assert words in str(caught.value)


def crossings(positions_rad: list[float]) -> int:
    """How often the shaft passes the centre."""
    return sum(a * b < 0 for a, b in pairwise(positions_rad))


@pytest.mark.realtime
@pytest.mark.parametrize("kind", ["rtu", "tcp"])
def test_a_relay_makes_the_slaves_motor_cycle(kind: str, tmp_path: Path) -> None:
    """A closed loop through FC23 at 10 ms: it switches again and again, about the centre."""
    positions_rad: list[float] = []
    drives_V: list[float] = []
    with LibmodbusSlave(kind, *EXAMPLE_MAP, log=tmp_path / "executed.csv") as slave:
        with opened(experiment_at(slave.port)) as driver:
            law = DualChannelRelay(0.8, 1.0, 10.0)
            sample = driver.read()
            next_s = time.monotonic()
            # a busy machine makes ticks late and the cycle slow: as many ticks as four crossings take, within 15 s
            while crossings(positions_rad) < 4 and len(positions_rad) < 1500:
                u_V = law.step(sample)
                sample = exchanged(driver, u_V)
                positions_rad.append(sample.y_rad)
                drives_V.append(u_V)
                next_s += 0.01
                time.sleep(max(0.0, next_s - time.monotonic()))
        executed = slave.executed()
    assert crossings(positions_rad) >= 4
    assert 0.02 < max(map(abs, positions_rad)) < 1.5
    relayed = [row.drive for row in executed if row.drive != 0]
    assert relayed == [round(u_V / SUPPLY_V * 10000) for u_V in drives_V if u_V != 0.0]
