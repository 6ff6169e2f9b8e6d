"""The whole experiment with an encoder on the Uno's emulated chip, in virtual time, as a user runs it; `rig home`."""

from __future__ import annotations

import json
import math
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner
from evidence import evidence

from emulated_chips.truth import Contact
from emulated_chips.virtual_chip import VirtualChip
from rig.backends.backend import Line
from rig.backends.registry import connect
from rig.backends.serial import opening
from rig.backends.serial.driver import SerialDriver
from rig.cli import main
from rig.config.load import load
from rig.config.schema import Experiment
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.run_folder.live.stop_flag import StopFlag
from rig.run_folder.recording.reader import read_run
from rig.running.experiment import zero
from rig.running.replay import replay
from rig.testing.line import lines_opened_by

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config/encoder.yaml"
PARAMETERS = ("tau_s", "K_rad_s_V", "fc_V")
HOME = {"end": "high", "at_rad": 1.5, "u_V": 0.9}


@contextmanager
def standing(chip: VirtualChip) -> Iterator[None]:
    """Commands open this chip, as a board that has been on all the time, and no hand but `rig home` sets its zero."""
    with (
        lines_opened_by(lambda _, e: nullcontext(Line(chip, chip, "chip", emulated=True))),
        pytest.MonkeyPatch.context() as m,
    ):
        m.setattr(opening, "_by_hand", lambda e, line: None)
        m.setattr(chip, "close", lambda: None)
        yield


def changed(folder: Path, **sections: dict[str, Any] | None) -> Path:
    """config/encoder.yaml with other keys; a section that is None goes."""
    config = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    for name, keys in sections.items():
        if keys is None:
            del config[name]
        else:
            config[name] = {key: value for key, value in (config[name] | keys).items() if value is not None}
    path = folder / "encoder.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    return path


def run(folder: Path, path: Path) -> dict[str, Any]:
    result = CliRunner().invoke(main, ["run", str(path), "--out", str(folder / "runs"), "--json"])
    assert result.exit_code == 0, result.output
    outcome: dict[str, Any] = json.loads(result.stdout)
    return outcome


@pytest.mark.evidence
def test_the_whole_experiment_finds_the_truth_to_a_fifth_of_a_percent(tmp_path: Path) -> None:
    outcome = run(tmp_path, CONFIG)
    estimate, truth = outcome["estimates"]["sampled-data"], outcome["truth"]
    assert estimate["verdict"] == "ok", estimate["reasons"]
    for name in PARAMETERS:
        assert estimate[name] == pytest.approx(truth[name], rel=0.002)
        low, high = estimate["ci95"][name]
        assert 0.5 * (high - low) < 0.001 * truth[name]  # with 10 bits and 3 mrad of noise 0.15 to 0.25 %
    assert outcome["tracking"]["sampled-data"]["rms_rad"] < 0.005
    assert outcome["loop"]["skipped"] == 0 and not outcome["faults"]


ENDLESS = {"travel": "none", "soft_rad": None, "hard_rad": None}


@pytest.mark.evidence
@pytest.mark.parametrize("where", ["device", *evidence("host")])
def test_a_shaft_without_limits_is_identified_and_turned_on_and_on(tmp_path: Path, where: str) -> None:
    gains = [{"h1_V": 0.42, "h2_V": 0.84}, {"h1_V": 0.3, "h2_V": 0.76}]
    path = changed(
        tmp_path,
        limits=ENDLESS,
        relay={"target": None, "gains": gains, "cycles": 6, "where": where},
        tracking={
            "turn_rad_s": 2.0,
            "methods": ["sampled-data"],
            "trajectory": [{"amplitude_rad": 0.5, "omega_rad_s": 2}],
        },
        emulated={"motor": yaml.safe_load(CONFIG.read_text())["emulated"]["motor"] | {"start_rad": 700.0}},
    )
    outcome = run(tmp_path, path)
    estimate, truth = outcome["estimates"]["sampled-data"], outcome["truth"]
    for name in PARAMETERS:
        assert estimate[name] == pytest.approx(truth[name], rel=0.002)
    assert outcome["tracking"]["sampled-data"]["rms_rad"] < 0.01
    (folder,) = (tmp_path / "runs").iterdir()
    rows = (folder / "samples.csv").read_text(encoding="utf-8").splitlines()
    last_rad = float(rows[-1].split(",")[rows[0].split(",").index("y_rad")])
    assert last_rad > 2.0 * 2.0 * math.pi  # from where the command found the shaft


def test_a_bound_in_turns_holds_in_the_device_from_where_the_command_finds_the_shaft(tmp_path: Path) -> None:
    motor = yaml.safe_load(CONFIG.read_text())["emulated"]["motor"] | {"start_rad": 700.0}
    experiment = load(changed(tmp_path, limits=ENDLESS | {"turns": 3}, emulated={"motor": motor}))
    with connect(experiment.device) as bench:
        chip = bench.clock
        assert isinstance(chip, VirtualChip)
        chip.place(700.0 + 3 * math.tau - 0.1)
        chip.sleep_until(chip.now_s() + 1.0)  # the edges come one by one
        bench.driver.arm(experiment.device.arming)
        bench.driver.read()
        chip.place(700.0 + 3 * math.tau + 0.1)
        chip.sleep_until(chip.now_s() + 0.05)
        with pytest.raises(Fault) as ended:
            bench.driver.read()
    assert ended.value.code == "DEVICE_TRAVEL"


@pytest.mark.evidence
@pytest.mark.parametrize("limits", [{}, ENDLESS], ids=["limits", "endless"])
def test_tests_until_the_motor_is_known_run_in_the_device_on_counts(tmp_path: Path, limits: dict[str, Any]) -> None:
    until = {"until": {"interval_percent": 0.1}, "where": "device"}
    relay = dict.fromkeys(("target", "cycles", "second_ratio")) | until
    motor = yaml.safe_load(CONFIG.read_text())["emulated"]["motor"] | {"start_rad": 700.0 if limits else 0.1}
    outcome = run(tmp_path, changed(tmp_path, limits=limits, relay=relay, tracking=None, emulated={"motor": motor}))
    assert outcome["stopped"]["known"], outcome["stopped"]["why"]
    estimate, truth = outcome["estimates"]["sampled-data"], outcome["truth"]
    assert estimate["verdict"] == "ok", estimate["reasons"]
    for name in PARAMETERS:
        assert estimate[name] == pytest.approx(truth[name], rel=0.002)
    (folder,) = (tmp_path / "runs").iterdir()
    recording = read_run(folder)
    assert {"strokes-1", "relay-1"} & set(recording.stages())
    assert limits or float(abs(recording.y_rad).max()) < 1.1  # the soft limits
    done = replay(folder)
    assert done.is_same, done.difference


def test_home_by_an_end_switch_finds_zero_to_a_few_counts(tmp_path: Path) -> None:
    encoder = {"counts_per_turn": 64, "gear": 50, "home": HOME}
    motor = yaml.safe_load(CONFIG.read_text())["emulated"]["motor"] | {"start_rad": -0.7}
    path = changed(
        tmp_path, sensor={"encoder": encoder}, emulated={"motor": motor, "encoder": {"end_rad": [-1.5, 1.5]}}
    )
    experiment = load(path)
    with connect(experiment.device) as bench:
        found = zero.find_by_switch(experiment, bench, StopFlag())
        chip = bench.clock
        assert isinstance(chip, VirtualChip)
        true_rad = chip.truth().y_rad
    assert found.y_rad == pytest.approx(true_rad, abs=4 * math.tau / 3200)
    low, high = experiment.limits.soft_rad
    assert low < found.y_rad < high


@pytest.mark.parametrize(
    ("end_rad", "home", "code"),
    [
        (None, HOME, "NO_MOTION"),  # no switch, but the mechanical stop
        ([-1.5, 1.5], HOME | {"end": "low", "at_rad": -1.5}, None),
        *evidence(([-1.5, 1.5], HOME | {"u_V": 0.3}, "NO_MOTION")),
    ],
)
def test_home_says_why_it_gives_up(tmp_path: Path, end_rad: Any, home: dict[str, Any], code: str | None) -> None:
    encoder = {"counts_per_turn": 64, "gear": 50, "home": home}
    emulated = {"encoder": {"end_rad": end_rad} if end_rad else {}}
    experiment = load(changed(tmp_path, sensor={"encoder": encoder}, emulated=emulated))
    if code is None:
        assert -1.1 < zero.by_switch(experiment, tmp_path).y_rad < 1.1
        return
    with pytest.raises(Fault) as failed:
        zero.by_switch(experiment, tmp_path)
    assert failed.value.code == code, failed.value


def _opens(which: Contact, duration_s: float, chip: VirtualChip) -> None:
    chip.contact(which, is_open=True)
    if math.isfinite(duration_s):
        chip.sleep_until(chip.now_s() + duration_s)
        chip.contact(which, is_open=False)


def with_end_switches(tmp_path: Path) -> Experiment:
    """The shaft stands inside, with an end switch to home to on each side."""
    encoder = {"counts_per_turn": 64, "gear": 50, "home": HOME}
    motor = yaml.safe_load(CONFIG.read_text())["emulated"]["motor"] | {"start_rad": -0.25}
    switches = {"motor": motor, "encoder": {"end_rad": [-1.5, 1.5]}}
    return load(changed(tmp_path, sensor={"encoder": encoder}, emulated=switches))


@pytest.mark.parametrize(
    ("at_rad", "act", "code", "words"),
    [
        (0.0, partial(_opens, "end_high", 0.003), "NOT_HOME", "two places"),  # a glitch
        (0.0, lambda chip: chip.rewire(sensor="stuck"), "NO_MOTION", "did not move the shaft"),
        (0.0, lambda chip: chip.rewire(drive="reversed"), "POLARITY", ""),
        (0.0, lambda _: os.kill(os.getpid(), signal.SIGTERM), "INTERRUPTED", ""),
        (0.0, lambda chip: chip.sleep_until(chip.now_s() + 0.3), "DEVICE_WATCHDOG", ""),  # as after kill -9
        *evidence(
            (0.0, partial(_opens, "end_low", math.inf), "NOT_HOME", "that of the low end"),  # a broken wire
            (0.0, partial(_opens, "e_stop", 0.05), "DEVICE_ESTOP", ""),
            (0.0, lambda chip: chip.reset(2), "DEVICE_RESET", ""),
            (0.0, lambda chip: chip.rewire(sensor="still"), "DEVICE_ENCODER_STILL", ""),
            (1.2, partial(_opens, "end_high", 0.003), "NOT_HOME", "two places"),  # it coasts on to the switch
            (0.0, partial(_opens, "end_low", 0.003), "NOT_HOME", "two places"),
            (0.0, lambda chip: chip.rewire(sensor="jumped"), "DEVICE_ENCODER_LOST", ""),
            (0.0, lambda _: os.kill(os.getpid(), signal.SIGINT), "INTERRUPTED", ""),
        ),
    ],
)
def test_a_homing_that_goes_wrong_leaves_no_zero(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    at_rad: float,
    act: Callable[[VirtualChip], None],
    code: str,
    words: str,
) -> None:
    """Not the one of before, either, which may be wrong: the next command is refused, and the drive stays at 0."""
    experiment = with_end_switches(tmp_path)
    with connect(experiment.device) as bench:
        chip, driver = bench.clock, bench.driver
        assert isinstance(chip, VirtualChip) and isinstance(driver, SerialDriver)
        driver.set_zero(chip.truth().y_rad - 1.2)
        read, acts, zeros = driver.read, [act], list[float]()

        def read_and_act() -> Sample:
            if acts and chip.truth().y_rad >= at_rad:
                acts.pop()(chip)
            return read()

        monkeypatch.setattr(driver, "read", read_and_act)
        monkeypatch.setattr(driver, "set_zero", zeros.append)
        with pytest.raises(Fault) as failed:
            zero.find_by_switch(experiment, bench, StopFlag())
        chip.sleep_until(chip.now_s() + 0.2)
        assert not acts and not zeros
        assert chip.truth().pin_V == 0.0
        chip.rewire()
        with standing(chip), connect(experiment.device) as again, pytest.raises(Fault) as refused:
            again.driver.arm(experiment.device.arming)
        assert chip.truth().pin_V == 0.0
    assert failed.value.code == code and words in str(failed.value), failed.value
    assert refused.value.code == "DEVICE_NO_ZERO"


@pytest.mark.parametrize("is_lost", [False, True], ids=["a signal", "the reply to ZERO is lost"])
def test_what_happens_in_the_last_moment_of_a_homing_leaves_no_zero(
    is_lost: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = with_end_switches(tmp_path)
    with connect(experiment.device) as bench:
        chip, driver = bench.clock, bench.driver
        assert isinstance(chip, VirtualChip) and isinstance(driver, SerialDriver)
        set_zero = driver.set_zero

        def signalled(here_rad: float) -> None:
            set_zero(here_rad)
            if is_lost:
                raise Fault("LINK_TIMEOUT", "no reply")
            os.kill(os.getpid(), signal.SIGINT)

        monkeypatch.setattr(driver, "set_zero", signalled)
        with pytest.raises(Fault, match="LINK_TIMEOUT" if is_lost else "INTERRUPTED"):
            zero.find_by_switch(experiment, bench, StopFlag())
        with pytest.raises(Fault, match="DEVICE_NO_ZERO"):
            driver.arm(experiment.device.arming)


def test_a_homing_that_ends_before_it_arms_leaves_no_zero(tmp_path: Path) -> None:
    """The e-stop is pressed, or the link dies, before anything moves."""
    path = changed(tmp_path, sensor={"encoder": {"counts_per_turn": 64, "gear": 50, "home": HOME}})
    experiment = load(path)
    with connect(experiment.device) as bench:
        chip, driver = bench.clock, bench.driver
        assert isinstance(chip, VirtualChip) and isinstance(driver, SerialDriver)
        chip.contact("e_stop", is_open=True)
        chip.sleep_until(chip.now_s() + 0.01)
        with pytest.raises(Fault) as failed:
            zero.find_by_switch(experiment, bench, StopFlag())
        assert failed.value.code == "DEVICE_ESTOP"
        chip.contact("e_stop", is_open=False)
        with standing(chip), connect(experiment.device) as again, pytest.raises(Fault) as refused:
            assert any("rig home" in remark for remark in again.info.remarks)
            again.driver.arm(experiment.device.arming)
    assert refused.value.code == "DEVICE_NO_ZERO"


def test_by_hand_the_zero_is_forgotten_before_the_hand_turns_the_shaft(tmp_path: Path) -> None:
    """Whoever is not sure and gives up at the prompt is left without a zero."""
    experiment = load(CONFIG)
    with connect(experiment.device) as bench:
        chip = bench.clock
        assert isinstance(chip, VirtualChip)
        with standing(chip):
            given_up = CliRunner().invoke(main, ["home", str(CONFIG)], input="")
            assert given_up.exit_code == 1 and "press Enter" in given_up.output
            outcome = CliRunner().invoke(main, ["run", str(CONFIG), "--out", str(tmp_path), "--json"])
            assert json.loads(outcome.stdout)["faults"][0]["code"] == "DEVICE_NO_ZERO"
            assert CliRunner().invoke(main, ["home", str(CONFIG), "--at-rad", "0.2"], input="\n").exit_code == 0
            with connect(experiment.device) as again:
                assert not again.info.remarks
                again.driver.arm(experiment.device.arming)
                assert again.driver.read().y_rad == pytest.approx(0.2, abs=math.tau / 3200)


def test_a_zero_that_the_encoder_loses_at_once_is_none(tmp_path: Path) -> None:
    """A wire is loose while `rig home` talks to the device: it says so, instead of "zero is set"."""
    experiment = load(CONFIG)
    with connect(experiment.device) as bench:
        chip = bench.clock
        assert isinstance(chip, VirtualChip)
        with standing(chip), connect(experiment.device) as again:
            driver = again.driver
            assert isinstance(driver, SerialDriver)
            driver.forget_zero()
            chip.rewire(sensor="still")
            chip.place(0.4)
            chip.sleep_until(chip.now_s() + 0.1)
            with pytest.raises(Fault) as failed:
                driver.set_zero(0.4)
        assert failed.value.code == "DEVICE_ENCODER_STILL"
        chip.rewire()
        with standing(chip):
            result = CliRunner().invoke(main, ["run", str(CONFIG), "--out", str(tmp_path), "--json"])
        assert json.loads(result.stdout)["faults"][0]["code"] == "DEVICE_NO_ZERO"
        assert "trembled on an edge" in result.stdout + result.stderr


@pytest.mark.parametrize(("gear", "unseen"), [(50, "0.13 rad"), (20, "0.32 rad")])
def test_rig_check_says_how_far_a_loose_channel_goes_unseen(tmp_path: Path, gear: int, unseen: str) -> None:
    path = changed(tmp_path, sensor={"encoder": {"counts_per_turn": 64, "gear": gear}})
    assert f"one loose channel is seen after {unseen}" in CliRunner().invoke(main, ["check", str(path)]).output


def test_by_hand_the_shaft_stands_where_the_hand_says() -> None:
    found = zero.by_hand(load(CONFIG), 0.25)
    assert found.y_rad == pytest.approx(0.25, abs=math.tau / 3200)
    assert found.y_counts == round(0.25 / (math.tau / 3200))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sensor": {"counts_max": 1023}}, "an encoder has no counts_max"),
        ({"sensor": {"encoder": {"counts_per_turn": 2}}}, "sensor.encoder.counts_per_turn"),
        ({"sensor": {"encoder": {"counts_per_turn": 64, "sign": 0}}}, "sensor.encoder.sign"),
        ({"sensor": {"encoder": None}}, "needs `calibration`, of a potentiometer, `encoder`, or `servo`"),
        ({"limits": {"travel": "none"}}, "`travel: none` leaves no soft_rad"),
        ({"limits": {"soft_rad": None}}, "soft_rad missing"),
        ({"limits": {"turns": 3}}, "`turns` bounds a shaft that turns without end"),
        ({"limits": ENDLESS | {"turns": 1}}, "limits.turns"),
        ({"limits": ENDLESS | {"turns": 2}, "tracking": {"turn_rad_s": 2.0}}, "limits.turns 2 leaves 9.42 rad"),
        ({"limits": ENDLESS | {"max_speed_rad_s": None}}, "limits.max_speed_rad_s"),
        ({"tracking": {"turn_rad_s": 1.0}}, "a shaft that turns on needs limits.travel: none"),
        ({"emulated": {"wiring": {"sensor": "noisy"}}}, "this sensor has no fault `noisy`"),
    ],
)
def test_rig_check_refuses_what_does_not_fit(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    result = CliRunner().invoke(main, ["check", str(changed(tmp_path, **changes))])
    assert result.exit_code == 2
    assert words in result.output
