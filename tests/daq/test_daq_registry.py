"""Third-party drivers by entry point."""

from importlib.metadata import EntryPoint

import pytest

from rig.daq import registry, serial_link


def offer(monkeypatch, *pairs):
    entries = [EntryPoint(name, value, registry.GROUP) for name, value in pairs]
    monkeypatch.setattr(registry, "entry_points", lambda group: [e for e in entries if e.group == group])


def test_a_driver_is_found_by_name(monkeypatch):
    offer(monkeypatch, ("mycard", "rig.daq.serial_link:SerialDriver"))
    assert list(registry.registered()) == ["mycard"]
    assert registry.load("mycard") is serial_link.SerialDriver


def test_an_unknown_name_lists_what_is_known(monkeypatch):
    offer(monkeypatch, ("b", "x:B"), ("a", "x:A"))
    with pytest.raises(LookupError, match="known: a, b"):
        registry.load("c")
    offer(monkeypatch)
    with pytest.raises(LookupError, match="none is installed"):
        registry.load("c")


def test_two_packages_with_one_name(monkeypatch):
    offer(monkeypatch, ("a", "x:A"), ("a", "y:A"))
    with pytest.raises(ValueError, match="x:A and y:A"):
        registry.load("a")


def test_what_is_no_driver_is_refused(monkeypatch):
    offer(monkeypatch, ("clock", "rig.daq.device_clock:DeviceClock"), ("f", "rig.daq.serial_link:open_serial"))
    with pytest.raises(TypeError, match=r"lacks open, arm, read, write, safe_stop, close"):
        registry.load("clock")
    with pytest.raises(TypeError, match="not a class"):
        registry.load("f")
