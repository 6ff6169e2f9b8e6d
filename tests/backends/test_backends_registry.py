"""Third-party drivers by entry point: what is found, and what is refused before it meets a motor."""

import os
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from plug_in_cards import BareCard, VirtualCard, settings

from rig import ready
from rig.backends import plug_in, registry
from rig.backends.driver import Driver, DriverSettings
from rig.backends.plug_in import PlugIn
from rig.backends.simulated.driver import SimulatedDriver
from rig.config import load
from rig.core.faults import Fault
from rig.core.plug_ins import PlugInError


def offer(monkeypatch: pytest.MonkeyPatch, *pairs: tuple[str, str]) -> None:
    entries = [EntryPoint(name, value, plug_in.GROUP) for name, value in pairs]
    monkeypatch.setattr(plug_in, "entry_points", lambda group: [e for e in entries if e.group == group])


def construct(name: str, settings: DriverSettings) -> Driver:
    backend = registry.backend_named(name)
    assert isinstance(backend, PlugIn)
    return backend.construct(settings)


def test_a_driver_is_found_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    offer(monkeypatch, ("mycard", "plug_in_cards:VirtualCard"))
    assert list(plug_in.registered()) == ["mycard"]
    assert type(construct("mycard", settings())) is VirtualCard


def test_two_packages_with_one_name(monkeypatch: pytest.MonkeyPatch) -> None:
    offer(monkeypatch, ("a", "x:A"), ("a", "y:A"))
    with pytest.raises(PlugInError, match="x:A and y:A"):
        plug_in.registered()


@pytest.mark.parametrize(
    ("value", "why"),
    [
        ("rig.backends.serial.device_clock:DeviceClock", "lacks open, arm, read, write, safe_stop, close"),
        ("rig.backends.serial.driver:setup_for", "is not a class"),
        ("rig.backends.serial.driver:SerialDriver", r"must be constructed as SerialDriver\(settings\)"),
        ("plug_in_cards:WriteTakesNothing", "write must take 1 argument"),
        ("plug_in_cards:ReadTakesMore", "read must take no arguments"),
        ("no_such_package:Card", "cannot be imported: ModuleNotFoundError: No module named 'no_such_package'"),
        ("plug_in_cards:NoSuchCard", "cannot be imported: AttributeError"),
    ],
)
def test_what_is_no_driver_class_is_refused(monkeypatch: pytest.MonkeyPatch, value: str, why: str) -> None:
    offer(monkeypatch, ("it", value))
    with pytest.raises(PlugInError, match=f"driver 'it' \\({value}\\).*{why}"):
        plug_in.loaded(plug_in.registered()["it"])


@pytest.mark.parametrize(
    ("attribute", "value", "why"),
    [
        ("order", "read_first", "order must be sample_first or write_first, not 'read_first'"),
        ("failsafe", 0.1, "failsafe must be a DeviceWatchdog, or None, not 0.1"),
        ("link_statistics", None, "link_statistics must be a mapping, not None"),
        ("clock", 3, "clock must have now_s and sleep_until"),
    ],
)
def test_what_a_driver_says_of_itself_is_held_to_its_type(
    monkeypatch: pytest.MonkeyPatch, attribute: str, value: object, why: str
) -> None:
    offer(monkeypatch, ("bare", "plug_in_cards:BareCard"))
    assert construct("bare", settings()).backend == "bare"
    monkeypatch.setattr(BareCard, attribute, value, raising=False)
    with pytest.raises(PlugInError, match=why):
        construct("bare", settings())


def test_a_missing_attribute_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    offer(monkeypatch, ("bare", "plug_in_cards:BareCard"))
    monkeypatch.delattr(BareCard, "backend")
    with pytest.raises(PlugInError, match="lacks backend"):
        construct("bare", settings())


def test_refused_options_stay_a_value_error_and_anything_else_names_package_and_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    offer(monkeypatch, ("bare", "plug_in_cards:BareCard"))
    with pytest.raises(ValueError, match="channel 9: this card has 0 to 7"):
        construct("bare", settings(channel=9))
    with pytest.raises(PlugInError, match=r"cannot be constructed: KeyError: 'range' at plug_in_cards.py:\d+"):
        construct("bare", settings(mode="wide"))


def test_a_package_that_is_installed_while_a_program_runs_is_found(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def install(name: str) -> None:
        folder = tmp_path / f"{name}-1.0.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(f"Name: {name}\nVersion: 1.0\n", encoding="utf-8")
        (folder / "entry_points.txt").write_text(f"[{plug_in.GROUP}]\n{name} = plug_in_cards:VirtualCard\n")
        os.utime(tmp_path, (len(name),) * 2)  # a file system may count too coarsely for a test

    monkeypatch.syspath_prepend(tmp_path)
    assert {"first", "second"}.isdisjoint(plug_in.registered())
    install("first")
    assert "first" in plug_in.registered() and "second" not in plug_in.registered()
    install("second")
    assert type(construct("second", settings())) is VirtualCard


def test_a_bench_is_stopped_before_it_is_closed_and_closed_though_the_stop_fails(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    done: list[str] = []

    def fails(driver: SimulatedDriver) -> bool:
        done.append("stop")
        raise Fault("LINK_LOST", "the plug was pulled")

    monkeypatch.setattr(SimulatedDriver, "safe_stop", fails)
    monkeypatch.setattr(SimulatedDriver, "close", lambda driver: done.append("close"))
    with pytest.raises(Fault, match="LINK_LOST"), registry.connect(load(ready("simulated")).device):
        pass
    assert done == ["stop", "close"]


def test_only_a_device_that_says_so_is_emulated(monkeypatch: pytest.MonkeyPatch) -> None:
    with registry.connect(load(ready("simulated")).device) as bench:
        assert bench.truth is not None
    opened = SimulatedDriver.open
    monkeypatch.setattr(SimulatedDriver, "open", lambda driver: replace(opened(driver), emulated=False))
    with registry.connect(load(ready("simulated")).device) as bench:
        assert bench.truth is None
