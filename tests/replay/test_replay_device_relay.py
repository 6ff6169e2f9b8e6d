"""A run whose relay ran in the device of another package: the replay asks that package what the device made of it."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from run_copy import GOLDEN, RunCopy

from rig.backends import plug_in
from rig.backends.backend import Backend
from rig.backends.driver import RelayRules
from rig.backends.serial.backend import SerialBackend
from rig.backends.serial.firmware_laws import FirmwareLawRules
from rig.config.schema import DeviceSetup
from rig.core.calibration import DriveMap
from rig.run_folder.recording.errors import RecordingError


class Clone(SerialBackend):
    """A board with firmware like rig's."""

    name = "clone"


class OtherSupply(Clone):
    """One that drives as on another supply."""

    def relay_rules(self, d: DeviceSetup, drive_map: DriveMap, clock_ratio: float) -> RelayRules:
        return FirmwareLawRules(d.sensor.curve, DriveMap(1.1 * drive_map.supply_V), clock_ratio)


class Silent(Clone):
    """One that does not say what it makes of the gains."""

    relay_rules = Backend.relay_rules  # type: ignore[assignment]


CLONE, OTHER, SILENT = Clone(), OtherSupply(), Silent()


@pytest.fixture
def run(tmp_path: Path) -> RunCopy:
    copy = RunCopy(GOLDEN / "chip-relay-in-device", tmp_path / "run")
    config = copy.folder / "config.yaml"
    config.write_text(config.read_text(encoding="utf-8").replace("driver: serial", "driver: clone"), encoding="utf-8")
    return copy


def install(monkeypatch: pytest.MonkeyPatch, backend: str) -> None:
    entry = EntryPoint("clone", f"{__name__}:{backend}", plug_in.GROUP)
    monkeypatch.setattr(plug_in, "entry_points", lambda group: [entry])


def test_its_own_rules_are_asked(run: RunCopy, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, "CLONE")
    assert run.replay().is_same
    install(monkeypatch, "OTHER")
    found = run.replay().difference
    assert found is not None and found.stage.startswith("relay-") and found.by == "law"


def test_a_device_that_does_not_say_is_refused(run: RunCopy, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, "SILENT")
    with pytest.raises(RecordingError, match="driver 'clone' does not say what its device makes of the gains"):
        run.replay()
