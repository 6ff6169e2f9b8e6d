"""The worked example of docs/plug-in-driver.md, installed as a package and run on a stand-in for nidaqmx."""

import math
import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from rig.backends.driver import DriverSettings
from rig.backends.registry import connect
from rig.config import Experiment
from rig.core.faults import Fault
from rig.running.experiment import script as experiment
from rig.running.preflight import check
from rig.testing import conformance

if TYPE_CHECKING:
    from nidaqmx.card import Card

ROOT = Path(__file__).parent.parent.parent
EXAMPLE = ROOT / "docs/examples/nidaqmx_driver"
FAKE = Path(__file__).parent / "fake_nidaqmx"
OURS = ("nidaqmx", "rig_nidaqmx", "virtual_nidaqmx")


def install(site: Path) -> list[str]:
    """What `pip install` of the example leaves behind: its entry points, and beside them the one in virtual time."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    folder = site / f"rig_nidaqmx-{project['version']}.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    lines = [f"{name} = {value}" for name, value in project["entry-points"]["rig.daq"].items()]
    lines.append("nidaqmx-virtual = virtual_nidaqmx:VirtualCardDriver")
    (folder / "entry_points.txt").write_text("\n".join(["[rig.daq]", *lines, ""]))
    return [str(site), str(EXAMPLE), str(FAKE)]


@pytest.fixture
def card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator["Card"]:
    """The stand-in's card, new, with the example installed."""
    for path in install(tmp_path / "site"):
        monkeypatch.syspath_prepend(path)
    forget()
    from nidaqmx.card import CARD

    yield CARD
    forget()


def forget() -> None:
    for name in [name for name in sys.modules if name.split(".")[0] in OURS]:
        del sys.modules[name]


def config(tmp_path: Path, driver: str = "nidaqmx-virtual", **changes: object) -> Path:
    """card.yaml with changes to its sections, the motor behind the stand-in named as the truth."""
    data = yaml.safe_load((EXAMPLE / "card.yaml").read_text(encoding="utf-8"))
    data["daq"]["driver"] = driver
    for key, value in changes.items():
        section, _, name = key.partition("__")
        data[section][name] = value
    data["emulated"] = {
        "motor": {
            "tau_s": 0.17, "K_rad_s_V": 6.5, "fc_plus_V": 0.50, "fc_minus_V": 0.46,
            "fs_plus_V": 0.54, "fs_minus_V": 0.50, "bias_V": 0.01,
        }
    }  # fmt: skip
    path = tmp_path / "card.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path


def load(path: Path) -> Experiment:
    return check(path)[0]


def rig(tmp_path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([*install(tmp_path / "site"), str(ROOT / "tests")])
    return subprocess.run(
        [sys.executable, "-m", "rig", *arguments],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_rig_check_takes_the_example_as_it_stands_without_a_card(tmp_path: Path) -> None:
    done = rig(tmp_path, "check", str(EXAMPLE / "card.yaml"))
    assert done.returncode == 0, done.stderr
    assert "backend: plug-in driver nidaqmx: assume a REAL MOTOR" in done.stdout
    assert "driver 'nidaqmx' (rig_nidaqmx:CardDriver of rig-nidaqmx 0.1.0): sample first" in done.stdout
    assert "failsafe before it is opened: none" in done.stdout
    assert "drives all the same (daq.accept_no_watchdog: true)" in done.stdout
    assert "link: the budget of a plug-in driver is not known" in done.stdout


@pytest.mark.evidence
def test_the_whole_experiment(card: "Card", tmp_path: Path) -> None:
    e = load(config(tmp_path, tracking__duration_s=3.0))
    outcome = experiment.run(e, tmp_path / "runs")
    assert outcome.failure == ""
    result: dict[str, Any] = outcome.result.as_json()
    assert result["backend"] == "nidaqmx:Dev1 (PCI-6221, serial 1A2B3C4)"
    estimate, truth = result["estimates"]["sampled-data"], result["truth"]
    assert estimate["verdict"] == "ok"
    for name in ("tau_s", "K_rad_s_V", "fc_V"):
        assert estimate[name] == pytest.approx(truth[name], rel=0.03)
    assert result["link"]["errors"] == 0
    assert result["link"]["reads"] > 2000
    meta = yaml.safe_load((outcome.folder / "meta.json").read_text(encoding="utf-8"))
    assert meta["failsafe"] == "none: the device holds its last drive"
    assert meta["firmware"]["build"] == "NI-DAQmx 24.5.0"
    assert card.output_V == 0.0
    assert card.reserved == {}
    assert card.restarts == 0
    assert max(map(abs, card.written)) <= 3.0 / 1.2 + 1e-3  # drive.max_V over the amplifier's gain


def test_it_conforms(card: "Card", tmp_path: Path) -> None:
    suite = conformance.suite(config(tmp_path), cut=lambda driver: setattr(card, "plugged_in", False))
    names = [name for base in reversed(suite.__mro__) for name in vars(base) if name.startswith("test_")]
    assert "test_a_dead_link_is_a_fault_and_safe_stop_does_not_raise" in names
    for name in names:
        test = suite()
        card.plugged_in = True
        test.setup_method()
        getattr(test, name)()
        test.teardown_method()
    suite.teardown_class()
    assert card.output_V == 0.0


def test_no_run_without_leave_to_do_without_a_watchdog(card: "Card", tmp_path: Path) -> None:
    e = load(config(tmp_path, daq__accept_no_watchdog=False))
    with pytest.raises(Fault, match="NO_WATCHDOG"), connect(e.device):
        pass
    assert card.reserved == {}


def test_the_output_is_zero_once_it_is_open_whatever_it_held_before(card: "Card", tmp_path: Path) -> None:
    card.output_V = 4.0
    with connect(load(config(tmp_path)).device) as bench:
        assert card.output_V == 0.0
        assert bench.driver.read().u_V == 0.0


def test_the_drive_is_that_of_the_converter(card: "Card", tmp_path: Path) -> None:
    e = load(config(tmp_path))
    with connect(e.device) as bench:
        bench.driver.arm(e.device.arming)
        for u_V in (1.0, -0.7, 3.0):
            bench.driver.write(u_V)
            assert card.output_V == pytest.approx(u_V / 1.2, abs=20.0 / 65536)
            assert bench.driver.read().u_V == pytest.approx(1.2 * card.output_V, abs=1e-3)
            assert math.isclose(bench.driver.read().t_u_s, bench.clock.now_s(), abs_tol=5e-4)


def test_a_card_that_is_pulled_out_ends_the_run_and_nobody_claims_that_it_stopped(card: "Card", tmp_path: Path) -> None:
    e = load(config(tmp_path))
    with connect(e.device) as bench:
        bench.driver.arm(e.device.arming)
        bench.driver.write(1.0)
        card.plugged_in = False
        with pytest.raises(Fault, match=r"LINK_LOST.*Dev1: Device cannot be accessed\.\)$"):
            bench.driver.read()
        assert bench.driver.safe_stop() is False
        assert card.output_V > 0.0  # as it says: it holds its last output


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"device": "Dev2"}, "LINK_OPEN.*Dev2: Device identifier is invalid"),
        ({"position": "ai9"}, "LINK_OPEN.*Physical channel specified does not exist"),
    ],
)
def test_another_card_than_the_config_says(card: "Card", tmp_path: Path, changes: dict[str, str], words: str) -> None:
    options = yaml.safe_load((EXAMPLE / "card.yaml").read_text(encoding="utf-8"))["daq"]["options"] | changes
    with pytest.raises(Fault, match=words), connect(load(config(tmp_path, daq__options=options)).device):
        pass
    assert card.reserved == {}


def test_a_channel_that_another_program_holds(card: "Card", tmp_path: Path) -> None:
    card.reserved["Dev1/ao0"] = object()
    with pytest.raises(Fault, match=r"LINK_OPEN.*resource is reserved"), connect(load(config(tmp_path)).device):
        pass
    assert list(card.reserved) == ["Dev1/ao0"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"devise": "Dev1"}, "devise is unknown; known: device, position"),
        ({"device": 1}, "device must be text, not 1"),
        ({"wiring": "SINGLE"}, "wiring must be one of RSE, NRSE, DIFF"),
        ({"position_V": [5, 0]}, r"position_V must be \[low, high\] in V"),
        ({"position_V": 5}, r"position_V must be \[low, high\] in V"),
        ({"position_V": [0, "x"]}, r"position_V must be \[low, high\] in V"),
        ({"amplifier_gain": 0}, "amplifier_gain must be a number above 0"),
        ({"amplifier_gain": True}, "amplifier_gain must be a number above 0"),
        ({"amplifier_gain": 1.0}, "amplifier_gain 1 gives 10 V at most; drive.supply_V less .* is 12 V"),
        ({"amplifier_gain": 1.2, "drive_bits": 12.5}, "drive_bits must be a whole number"),
        ({"amplifier_gain": 1.2, "drive_bits": 40}, "drive_bits must be a whole number"),
    ],
)
def test_options_that_cannot_be(card: "Card", options: dict[str, object], words: str) -> None:
    from plug_in_cards import settings
    from rig_nidaqmx import CardDriver

    with pytest.raises(ValueError, match=words):
        CardDriver(settings(**options))
    assert isinstance(settings(), DriverSettings)


@pytest.mark.parametrize(("bits", "step_V"), [(16, 1.2 * 20 / 65536), (12, 1.2 * 20 / 4096)])
def test_a_unit_of_the_drive_is_a_step_of_the_converter(card: "Card", bits: int, step_V: float) -> None:
    from plug_in_cards import settings
    from rig_nidaqmx import CardDriver

    driver = CardDriver(settings(amplifier_gain=1.2, drive_bits=bits))
    assert driver._drive_map.to_volts(1) == pytest.approx(step_V, rel=1e-3)
