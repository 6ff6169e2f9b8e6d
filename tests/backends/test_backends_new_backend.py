"""A new kind of device is one file: this one. It is found like a package's, checked by `rig check`, and run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
import yaml
from command_line import rig
from pydantic import Field
from simulated_bench import DEMO

from rig.backends import plug_in, registry
from rig.backends.backend import Backend, Unopened, Watchdog
from rig.backends.clock import VirtualClock
from rig.backends.link_budget import LinkBudget
from rig.backends.registry import backend_of
from rig.backends.simulated.driver import SimulatedDriver, SimulatedLatency
from rig.config import load
from rig.config.problems import Problem, wrong
from rig.config.schema import DeviceSetup, Experiment
from rig.core.plug_ins import PlugInError
from rig.core.section import Positive, Section
from rig.testing import conformance

CARD = Path(__file__).parents[1] / "testing" / "virtual-card.yaml"


# ---------------------------------------------------------------------- the one file


class ScopeOptions(Section):
    """What stands under ``daq.options``."""

    channel: int = Field(ge=0, le=3, description="input of the potentiometer")
    conversion_s: Positive = Field(0.0005, description="time of one conversion")


class Scope(Backend):
    """An oscilloscope with a generator, behind a motor in virtual time."""

    name = "scope"
    section = ScopeOptions

    def rules(self, d: DeviceSetup) -> Iterator[Problem]:
        if d.tachometer is not None and self.options(d, ScopeOptions).channel == 3:
            yield wrong("daq.options.channel", "3 is the tachometer's", "0 to 2")
        if not self.budget(d).fits(d.period_s):
            yield self.budget(d).too_slow("daq.options.conversion_s", d.period_s, ())

    def watchdog(self, d: DeviceSetup) -> Watchdog:
        return Watchdog(d.daq.watchdog_s)

    def writes_first(self, d: DeviceSetup) -> bool:
        return False

    def budget(self, d: DeviceSetup) -> LinkBudget:
        return LinkBudget((("two conversions", 2.0 * self.options(d, ScopeOptions).conversion_s),), "2 conversions")

    def words(self, d: DeviceSetup) -> str:
        return f"channel {self.options(d, ScopeOptions).channel} of an oscilloscope, nothing moves"

    def is_emulated(self, d: DeviceSetup) -> bool:
        return True

    def plan(self, d: DeviceSetup) -> Iterator[str]:
        yield f"link: {self.budget(d).beside(d.period_s)}"

    @contextmanager
    def unopened(self, d: DeviceSetup) -> Iterator[Unopened]:
        clock = VirtualClock()
        latency = SimulatedLatency(self.options(d, ScopeOptions).conversion_s, 0.0)
        driver = SimulatedDriver(clock, DEMO, d.scaling, latency, d.seed)
        yield Unopened(driver, clock, DEMO)


SCOPE = Scope()


# ---------------------------------------------------------------------- what is seen of it


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a package that offers it."""
    entry = EntryPoint("scope", f"{__name__}:SCOPE", plug_in.GROUP)
    monkeypatch.setattr(plug_in, "entry_points", lambda group: [entry])


def written(folder: Path, options: Any, **sections: Any) -> Path:
    data = yaml.safe_load(CARD.read_text(encoding="utf-8"))
    data["daq"] |= {"driver": "scope"} | ({} if options is None else {"options": options})
    path = folder / "scope.yaml"
    path.write_text(yaml.safe_dump(data | sections, sort_keys=False), encoding="utf-8")
    return path


def test_check_asks_it_and_says_what_it_says(tmp_path: Path) -> None:
    done = rig("check", written(tmp_path, {"channel": 1}))
    assert done.exit_code == 0, done.stderr
    assert "backend: channel 1 of an oscilloscope, nothing moves, every 10 ms" in done.stdout
    assert "link: 2 conversions = 1.00 ms; 80 % of the period is 8.00 ms" in done.stdout
    assert "failsafe: the device sets 0 V after 100 ms of silence" in done.stdout


def test_its_port_has_any_name_and_keys_of_other_devices_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, {"channel": 1})
    config = path.read_text(encoding="utf-8")
    path.write_text(config.replace("driver: scope", "driver: scope\n  port: tcp://scope.local"), encoding="utf-8")
    assert rig("check", path).exit_code == 0
    path.write_text(config.replace("driver: scope", "driver: scope\n  adapter: ftdi"), encoding="utf-8")
    assert "daq.adapter: is a key of `driver: serial`, not of `driver: scope`; remove it" in rig("check", path).stderr


TACHOMETER = {"tachometer": {"rad_s_per_count": 0.1}}


@pytest.mark.parametrize(
    ("options", "sections", "line", "words"),
    [
        ({"chanel": 1}, {}, "chanel: 1", "daq.options.chanel: unknown key; did you mean 'channel'?"),
        ({"channel": 7}, {}, "channel: 7", "daq.options.channel: must be at most 3, got 7"),
        (
            {"channel": "1"},
            {},
            "channel: '1'",
            'daq.options.channel: must be a whole number, got the text "1"; leave out the quotes',
        ),
        (None, {}, "daq:", "daq.options.channel: required key is missing; add it: input of the potentiometer"),
        ({"channel": 3}, TACHOMETER, "channel: 3", "daq.options.channel: 3 is the tachometer's; 0 to 2"),
        (
            {"channel": 1, "conversion_s": 0.006},
            {},
            "conversion_s: 0.006",
            "daq.options.conversion_s: too slow for the period: 2 conversions = 12.00 ms; 80 % of the period is "
            "8.00 ms (the host needs the rest to wake, decide and record); period_s of 0.015 and more",
        ),
    ],
)
def test_what_is_wrong_in_its_section_has_line_and_key(
    options: Any, sections: dict[str, Any], line: str, words: str, tmp_path: Path
) -> None:
    path = written(tmp_path, options, **sections)
    done = rig("check", path)
    assert done.exit_code == 2
    (said,) = done.stderr.splitlines()
    place, _, told = said.removeprefix(f"{path}:").partition(": ")
    assert path.read_text(encoding="utf-8").splitlines()[int(place.split(":")[0]) - 1].strip() == line
    assert told == words


def test_a_run_opens_it(tmp_path: Path) -> None:
    relay = {"relay": {"gains": [{"h1_V": 0.45, "h2_V": 0.9}], "cycles": 5}}
    done = rig("relay", written(tmp_path, {"channel": 0}, **relay), "--out", tmp_path / "runs")
    assert done.exit_code == 0, done.stderr
    assert "tau" in done.stdout


def test_one_that_calls_itself_otherwise_is_refused() -> None:
    entry = EntryPoint("other", f"{__name__}:SCOPE", plug_in.GROUP)
    with pytest.raises(PlugInError, match="its name must be 'other', not 'scope'"):
        plug_in.loaded(entry)


def test_no_name_of_a_driver_is_compared_in_rig() -> None:
    """Who wants to know something of a device asks it."""
    sources = (Path(registry.__file__).parents[1]).rglob("*.py")
    compared = [
        f"{path.name}: {line.strip()}"
        for path in sources
        for line in path.read_text(encoding="utf-8").splitlines()
        if any(f"driver {way} " in line for way in ("==", "!=", "in", "not in")) and "daq" in line.split("driver")[0]
    ]
    assert compared == []


def test_every_built_in_device_is_found_as_any_other(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in registry.BUILT_IN:
        data = load(CARD).model_dump(mode="json", exclude_none=True)
        data["daq"]["driver"] = name
        assert backend_of(Experiment.model_validate(data).device).name == name


def test_the_conformance_suite_takes_it(tmp_path: Path) -> None:
    suite = conformance.suite(written(tmp_path, {"channel": 2}))
    tests = suite()
    tests.setup_method()
    tests.test_a_reading_is_complete_before_anything_was_armed()
    tests.teardown_method()
    suite.teardown_class()
