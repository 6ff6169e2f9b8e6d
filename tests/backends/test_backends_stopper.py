"""A device that one process has opened and drives is stopped by another, on the same link: at the device's drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import yaml
from simulated_bench import DEMO

import rig
from emulated_chips.virtual_chip import VirtualChip
from rig.backends import backend
from rig.backends.backend import Line
from rig.backends.modbus.emulated.virtual_io_block import VirtualIoBlock
from rig.backends.modbus.opening import emulated_io_block
from rig.backends.registry import backend_of
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.config import Experiment, load

Device = VirtualBoard | VirtualChip | VirtualIoBlock


def experiment(name: str, **daq: Any) -> Experiment:
    config = yaml.safe_load(rig.ready(name).read_text(encoding="utf-8"))
    return load({**config, "daq": {**config["daq"], **daq}})


def bare() -> Experiment:
    e = yaml.safe_load(rig.ready("modbus-rtu").read_text(encoding="utf-8"))["daq"]["modbus"]
    kept = {name: e["registers"][name] for name in ("drive", "sequence", "position")}
    return experiment("modbus-rtu", port="emulated", accept_no_watchdog=True, modbus={**e, "registers": kept})


CASES: dict[str, Callable[[], tuple[Experiment, Any]]] = {
    "board": lambda: (experiment("demo"), VirtualBoard(DEMO, 3)),
    "chip": lambda: (experiment("demo"), VirtualChip(DEMO, 3)),
    "block": lambda: (e := experiment("modbus-rtu", port="emulated"), emulated_io_block(e.device)),
    "block without watchdog": lambda: (e := bare(), emulated_io_block(e.device)),
}


def drive_V(device: Device) -> float:
    """At the device's output."""
    return device.truth().output_V if isinstance(device, VirtualIoBlock) else device.truth().pin_V


@contextmanager
def inherited(device: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The device is what its link's number leads to, in this process too."""
    monkeypatch.setattr(backend, "OpenLink", lambda descriptor: device)
    yield


@pytest.mark.parametrize("name", CASES)
def test_a_stopper_stops_what_another_process_drives(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    e, device = CASES[name]()
    kind = backend_of(e.device)
    driver = kind.driver(e.device, Line(device, device, "test", emulated=True))  # type: ignore[attr-defined]  # it has a line
    driver.open()
    driver.arm(e.device.arming)
    for _ in range(5):
        driver.write(0.7)
        device.sleep_until(device.now_s() + e.period_s)
        driver.read()
    assert drive_V(device) > 0.5
    with inherited(device, monkeypatch):
        stopper = kind.stopper(e.device, 7)
    assert stopper is not None
    assert stopper.safe_stop() is True
    device.sleep_until(device.now_s() + 0.02)
    assert drive_V(device) == 0.0


def test_a_device_without_a_link_has_no_stopper() -> None:
    e = experiment("simulated")
    assert backend_of(e.device).stopper(e.device, 7) is None
