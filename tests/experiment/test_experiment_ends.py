"""However a run ends: nothing arms again, the record is whole, there is a result, and no traceback."""

from __future__ import annotations

import json
import math
import os
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from command_line import rig
from evidence import evidence

from rig import config as configs
from rig.backends.driver import DeviceInfo
from rig.backends.registry import Bench, connect
from rig.backends.simulated.driver import SimulatedDriver
from rig.config.schema import DeviceSetup
from rig.control.law import Constant
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.identification import Identification, identify
from rig.run_folder.recording.reader import read_run
from rig.run_folder.recording.recording import Recording
from rig.running import session
from rig.running.experiment import script, stages

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[2]


def quick(folder: Path, **changes: object) -> Path:
    """Given gains, few cycles, no tracking."""
    config = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    del config["tracking"]
    config["relay"] = {"gains": [{"h1_V": 0.42, "h2_V": 0.85}], "cycles": 4}
    path = folder / "quick.yaml"
    path.write_text(yaml.safe_dump(config | changes), encoding="utf-8")
    return path


def test_nothing_arms_again_after_a_fault_or_a_signal(tmp_path: Path) -> None:
    config = yaml.safe_load(quick(tmp_path).read_text(encoding="utf-8"))
    config["emulated"]["wiring"] = {"drive": "reversed"}
    (tmp_path / "wrong.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    result = rig("run", tmp_path / "wrong.yaml", "--repeat", 3, "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 1
    assert len(json.loads(result.stdout)["runs"]) == 1
    assert len(list((tmp_path / "runs").iterdir())) == 1


@pytest.mark.evidence
def test_a_bridge_that_lets_the_motor_run_free_is_named_and_nothing_is_believed(tmp_path: Path) -> None:
    """The breakaway check cannot see it; what the relay tests give is another motor than the data sheet's."""
    config = yaml.safe_load(quick(tmp_path).read_text(encoding="utf-8"))
    config["emulated"]["coasting"] = True
    config["relay"]["gains"] = [{"h1_V": 0.4, "h2_V": 0.55}]
    config["relay"]["search"] = {"timeout_s": 20}
    (tmp_path / "coasting.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    result = json.loads(rig("run", tmp_path / "coasting.yaml", "--out", tmp_path / "runs", "--json").stdout)
    assert [fault["code"] for fault in result["faults"]] == ["NO_CYCLE"]  # in the relay test, behind the check
    assert result["estimates"]["sampled-data"]["verdict"] == "refused"
    assert any("lets the motor run free" in note for note in result["notes"])


@pytest.mark.parametrize("law", ["free_between", "no_brake", "runs_free", "drag"])
def test_a_bridge_that_an_answer_names_is_a_note_on_the_room_to_stop(tmp_path: Path, law: str) -> None:
    answer = SimpleNamespace(law=[SimpleNamespace(name=law)])
    found: Any = SimpleNamespace(leading=None, answer=answer)
    notes = session.beside_data_sheet(configs.load(quick(tmp_path)), found)
    assert ["0 V does not stop it" in note for note in notes] == [True] * (law != "drag")


@pytest.mark.parametrize("number", [signal.SIGINT, *evidence(signal.SIGTERM, signal.SIGHUP)])
def test_a_signal_in_the_loop_or_while_identifying_ends_the_run_with_a_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    original = identify

    def interrupted(recordings: Sequence[Recording]) -> Identification:
        os.kill(os.getpid(), number)
        return original(recordings)

    monkeypatch.setattr(stages, "identify", interrupted)
    result = rig("relay", quick(tmp_path), "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 1
    outcome = json.loads(result.stdout)
    assert outcome["faults"][0]["code"] == "INTERRUPTED"
    assert outcome["faults"][0]["detail"] == number.name
    assert outcome["estimates"]
    assert (Path(outcome["folder"]) / "report.html").is_file()


def test_a_defect_of_the_program_is_a_fault_with_its_traceback_in_the_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(self: Constant, sample: Sample) -> float:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(Constant, "step", broken)
    result = rig("jog", quick(tmp_path), "--u-V", 0.5, "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 1
    outcome = json.loads(result.stdout)
    assert outcome["faults"][0]["code"] == "INTERNAL"
    events = (Path(outcome["folder"]) / "events.jsonl").read_text()
    assert "ZeroDivisionError" in events
    assert "broken" in events


def test_a_drive_that_is_no_number_never_reaches_the_bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Constant, "step", lambda self, sample: math.nan)
    result = rig("jog", quick(tmp_path), "--u-V", 0.5, "--out", tmp_path / "runs", "--json")
    outcome = json.loads(result.stdout)
    assert outcome["faults"][0]["code"] == "LAW_FAILED"
    recording = read_run(Path(outcome["folder"]))
    assert abs(recording.u_V).max() == 0.0
    # the tick that ended the run is in the record
    assert recording.stage[-1] == "jog"


def test_a_report_that_cannot_be_written_costs_the_report_and_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(folder: Path, identification: Identification) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(session, "write_report", full)
    result = rig("relay", quick(tmp_path), "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["estimates"]["sampled-data"]["verdict"] in ("ok", "doubtful")
    assert "Traceback" not in result.output

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(session, "write_report", interrupted)
    result = rig("jog", quick(tmp_path), "--u-V", 0.3, "--out", tmp_path / "jogs")
    assert result.exit_code == 1 and "no report: interrupted; `rig report " in result.output
    assert "run:" in result.output and "drive is on" not in result.output


def test_a_result_that_cannot_be_made_is_the_least_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(session, "run_result", broken)
    shown = rig("jog", quick(tmp_path), "--u-V", 0.3, "--out", tmp_path / "runs", "--json")
    assert shown.exit_code == 1
    outcome = json.loads(shown.stdout)
    result = json.loads((Path(outcome["folder"]) / "result.json").read_text(encoding="utf-8"))
    assert any("the result is incomplete: ZeroDivisionError" in note for note in result["notes"])
    assert result["loop"]["ticks"] > 10


def test_what_the_device_had_latched_since_the_last_run_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = connect

    @contextmanager
    def cleared(setup: DeviceSetup) -> Iterator[Bench]:
        with original(setup) as bench:
            yield replace(bench, info=replace(bench.info, acknowledged=("DEVICE_ESTOP",), remarks=("of old",)))

    monkeypatch.setattr(session, "connect", cleared)
    said = rig("jog", quick(tmp_path), "--u-V", 0.3, "--out", tmp_path / "runs", "--json")
    notes = json.loads(said.stdout)["notes"]
    assert notes[:2] == ["of old", "e-stop pressed since the last run: the device had latched DEVICE_ESTOP"]


@pytest.mark.parametrize(
    ("measured_V", "at_least", "said"),
    [
        (13.0, False, "a motor supply of 13.0 V, drive.supply_V is 12 V: K is 8 % too large then, and f_c too small"),
        *evidence(
            (12.4, False, ""),
            (
                11.0,
                False,
                "a motor supply of 11.0 V, drive.supply_V is 12 V: K is 8 % too small then, and f_c too large",
            ),
            (13.0, True, "at least 13.0 V, drive.supply_V is 12 V: K is at least 8 % too large"),
            (11.0, True, ""),
        ),
    ],
)
def test_a_supply_that_is_a_little_off_is_said_and_makes_the_estimates_doubtful(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, measured_V: float, at_least: bool, said: str
) -> None:
    original = connect

    @contextmanager
    def measuring(setup: DeviceSetup) -> Iterator[Bench]:
        with original(setup) as bench:
            yield replace(bench, info=replace(bench.info, supply_V=measured_V, supply_at_least=at_least))

    monkeypatch.setattr(session, "connect", measuring)
    result = rig("relay", quick(tmp_path), "--out", tmp_path / "runs", "--json")
    outcome = json.loads(result.stdout)
    estimate = outcome["estimates"]["sampled-data"]
    page = (Path(outcome["folder"]) / "report.html").read_text(encoding="utf-8")
    again = json.loads(rig("identify", outcome["folder"], "--json").stdout)["estimates"]["sampled-data"]
    for heard in (result.stderr, *outcome["notes"][:1], page):
        assert ("measures a motor supply" in heard) is bool(said)
    assert any(said in note and "set drive.supply_V" in note for note in outcome["notes"]) is bool(said)
    for judged in (estimate, again):
        assert any("measures a motor supply" in reason and said in reason for reason in judged["reasons"]) is bool(said)
        assert judged["verdict"] == "doubtful" or not said


@pytest.mark.parametrize(("plus_V", "differs"), [(0.8, True), (0.54, False)])
def test_friction_that_differs_by_more_than_the_bound_reckons_with_is_said(
    tmp_path: Path, plus_V: float, differs: bool
) -> None:
    path = quick(tmp_path)
    text = yaml.safe_load(path.read_text(encoding="utf-8"))
    text["emulated"]["motor"]["fs_plus_V"] = plus_V
    path.write_text(yaml.safe_dump(text), encoding="utf-8")
    notes = json.loads(rig("relay", path, "--out", tmp_path / "runs", "--json").stdout)["notes"]
    assert any("bounds unseen travel for at most 10 %" in n for n in notes) is differs


def test_a_run_cut_off_before_a_settled_cycle_gives_no_number_as_ok(tmp_path: Path) -> None:
    outcome = json.loads(rig("relay", quick(tmp_path), "--out", tmp_path / "runs", "--json").stdout)
    folder = Path(outcome["folder"])
    lines = (folder / "samples.csv").read_text().splitlines(keepends=True)
    begin = next(k for k, line in enumerate(lines) if ",relay-1," in line)
    (folder / "samples.csv").write_text("".join(lines[: begin + 61]))
    (folder / "result.json").unlink()
    cut = rig("identify", folder, "--json")
    assert cut.exit_code == 0
    said = json.loads(cut.stdout)
    # the methods of the cycle have none; the motion of half a second says little, and says so
    assert any("triple-relay: relay-1: 1 full cycles are too few" in note for note in said["notes"])
    assert said["estimates"].keys() == {"sampled-data"}
    estimate = said["estimates"]["sampled-data"]
    low, high = estimate["ci95"]["tau_s"]
    assert estimate["verdict"] == "doubtful"
    assert low < 0.17 < high
    page = rig("report", folder)
    assert page.exit_code == 0
    assert "tau is only known to" in (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("accepted", [False, True])
def test_a_device_without_watchdog_is_refused_unless_the_config_accepts_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, accepted: bool
) -> None:
    original = SimulatedDriver.open

    def without(self: SimulatedDriver) -> DeviceInfo:
        info = original(self)
        self.failsafe = None
        return info

    monkeypatch.setattr(SimulatedDriver, "open", without)
    config = yaml.safe_load(quick(tmp_path).read_text(encoding="utf-8"))
    config["daq"]["accept_no_watchdog"] = accepted
    (tmp_path / "none.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    result = rig("jog", tmp_path / "none.yaml", "--u-V", 0.5, "--seconds", 0.1, "--out", tmp_path / "runs")
    assert result.exit_code == (0 if accepted else 1)
    assert ("NO_WATCHDOG" in result.stderr) != accepted
    assert ("accept_no_watchdog" in result.stderr) != accepted


def test_an_unconfirmed_stop_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    from simulated_bench import LIMITS, simulated_bench

    bench = simulated_bench()
    monkeypatch.setattr(type(bench.driver), "safe_stop", lambda self: False)
    with pytest.raises(Fault) as caught, bench.loop.armed(LIMITS):
        bench.loop.run(Constant(0.3, 0.1), "jog")
    assert caught.value.code == "STOP_UNCONFIRMED"

    def broken(self: SimulatedDriver) -> bool:
        raise OSError("a broken driver")

    monkeypatch.setattr(type(bench.driver), "safe_stop", broken)
    with pytest.raises(Fault) as caught, bench.loop.armed(LIMITS):
        raise Fault("POLARITY")
    assert caught.value.code == "POLARITY"  # why the run ended is not hidden
    assert bench.record.events[-1]["confirmed"] is False


def test_the_guards_part_in_a_cycle_is_said_and_no_method_that_takes_it_for_the_relays_is_ok(tmp_path: Path) -> None:
    config = yaml.safe_load(quick(tmp_path).read_text(encoding="utf-8"))
    config["relay"] = {"gains": [{"h1_V": 0.45, "h2_V": 0.95}], "cycles": 6}
    config["daq"]["timeout_s"] = 0.08
    config["limits"] |= {"max_speed_rad_s": 4.3}
    (tmp_path / "tight.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    result = rig("relay", tmp_path / "tight.yaml", "--out", tmp_path / "runs", "--json")
    outcome = json.loads(result.stdout)
    assert any("the guard braked in" in note for note in outcome["notes"]), outcome["notes"]
    assert any("the guard changed the drive in" in note for note in outcome["notes"])
    # the sampled-data estimator reads the drive as it acted: the guard's part does not mislead it
    others = [estimate for method, estimate in outcome["estimates"].items() if method != "sampled-data"]
    assert {estimate["verdict"] for estimate in others} == {"doubtful"}
    assert all(any("the guard changed the drive in" in reason for reason in one["reasons"]) for one in others)


def test_nothing_is_tracked_where_the_sampled_data_estimate_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from dataclasses import replace

    config = yaml.safe_load(quick(tmp_path).read_text(encoding="utf-8"))
    whole = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    (tmp_path / "whole.yaml").write_text(yaml.safe_dump(config | {"tracking": whole["tracking"]}), encoding="utf-8")
    original = identify

    def refusing(recordings: Sequence[Recording]) -> Identification:
        found = original(recordings)
        estimates = {**found.estimates}
        estimates["sampled-data"] = estimates["sampled-data"].judged("refused", "for this test")
        return replace(found, estimates=estimates, motor_law=None)

    monkeypatch.setattr(stages, "identify", refusing)
    result = rig("run", tmp_path / "whole.yaml", "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 1
    outcome = json.loads(result.stdout)
    assert outcome["estimates"]["triple-relay"]["verdict"] != "refused"
    assert all("good enough" in entry["not_run"] for entry in outcome["tracking"].values())
    assert not any(stage.startswith("track:") for stage in read_run(Path(outcome["folder"])).stages())


def test_a_defect_after_the_loop_costs_neither_record_nor_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tracking errors, identification and report, each broken by a defect of the program."""

    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("a defect")

    config = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    config["relay"] = {"gains": [{"h1_V": 0.42, "h2_V": 0.85}], "cycles": 4}
    config["tracking"] |= {"duration_s": 3.0, "methods": ["sampled-data"]}
    (tmp_path / "tracks.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    monkeypatch.setattr(stages, "tracking_errors", broken)
    monkeypatch.setattr(session, "write_report", broken)
    result = rig("run", tmp_path / "tracks.yaml", "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 1
    folder = Path(json.loads(result.stdout)["folder"])
    outcome = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert outcome["estimates"]["sampled-data"]["verdict"] != "refused"
    assert outcome["faults"][0]["code"] == "INTERNAL" and "a defect" in outcome["faults"][0]["detail"]
    assert "track:sampled-data" in read_run(folder).stages()

    monkeypatch.setattr(session, "identify", broken)
    monkeypatch.setattr(stages, "identify", broken)
    result = rig("relay", quick(tmp_path), "--out", tmp_path / "others", "--json")
    folder = Path(json.loads(result.stdout)["folder"])
    outcome = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert outcome["faults"][0]["code"] == "INTERNAL" and "relay-1" in read_run(folder).stages()


@pytest.mark.parametrize(
    "changed", [{"tau_s": 0.6, "K_rad_s_V": 1.2}, *evidence({"fc_V": 2.5})], ids=["sluggish", "rough"]
)
def test_a_model_that_fails_in_simulation_never_drives_the_bench(changed: dict[str, Any], tmp_path: Path) -> None:
    """Measured at the drive: the record has no tick of it, and the model that passed never goes beyond the limits."""
    e = configs.load(ROOT / "config/quick.yaml")
    e = e.model_copy(update={"tracking": e.tracking and e.tracking.model_copy(update={"duration_s": 2.0})})
    found = identify([read_run(ROOT / "tests/golden/simulated")], ["sampled-data", "triple-relay"], choose_law=False)
    found.estimates["triple-relay"] = replace(found.estimates["triple-relay"], **changed)
    outcome = script.run_tracking(e, found.as_result(), tmp_path, tmp_path / "runs")
    assert outcome.fault is None
    reason = outcome.result.tracking["triple-relay"].not_run
    assert reason is not None and "in simulation on the best model" in reason
    recording = read_run(outcome.folder)
    assert "track:sampled-data" in recording.stages() and "track:triple-relay" not in recording.stages()
    assert abs(recording.y_rad).max() < e.limits.soft_rad[1] and abs(recording.u_V).max() <= e.drive.max_V
