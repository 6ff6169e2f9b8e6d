"""The rules of a servo's config: one mistake, one line; which combinations of servo and load may run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from rig import config
from rig.config import ConfigError
from rig.running.preflight import check

CONFIG = Path(__file__).resolve().parents[2] / "config"


def changed(tmp_path: Path, name: str = "servo", **sections: Any) -> Path:
    """A ready config with keys of its sections changed; None takes one out."""
    data = yaml.safe_load((CONFIG / f"{name}.yaml").read_text(encoding="utf-8"))
    for section, keys in sections.items():
        if not isinstance(keys, dict):
            data[section] = keys
            continue
        one = data.setdefault(section, {})
        for key, value in keys.items():
            inner = one.setdefault(key, {}) if isinstance(value, dict) else one
            if isinstance(value, dict):
                inner.update(value)
            elif value is None:
                inner.pop(key)
            else:
                inner[key] = value
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def problems(path: Path) -> list[str]:
    try:
        check(path)
    except ConfigError as error:
        return str(error).splitlines()
    return []


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"daq": {"port": None}}, "needs a port"),
    ({"daq": {"port": "emulated-chip"}}, "no emulated-chip for `driver: servo`"),
    ({"daq": {"servo": {"model": "ax-12"}}}, "no servo 'ax-12'"),
    ({"daq": {"servo": {"id": 253}}}, "252"),
    ({"daq": {"servo": {"supply_switch": "   "}}}, "daq.servo.supply_switch: say which switch"),
    ({"daq": {"accept_no_watchdog": "   "}}, "must be true or false"),
    ({"daq": {"baud": 250000}}, "has no 250000 baud"),
    ({"daq": {"baud": 57600}}, "too slow for the period"),
    ({"daq": {"watchdog_s": 0.05}}, "no whole number of 0.02 s"),
    ({"daq": {"timeout_s": 0.02}}, "longer than the period"),
    ({"daq": {"adapter": "ftdi"}}, "daq.servo.adapter"),
    ({"drive": {"supply_V": 12.0}}, "takes 3.1 to 7 V"),
    ({"drive": {"bridge": "pwm-dir"}}, "its bridge inside"),
    ({"limits": {"hard_rad": [-3.2, 3.2]}}, "within one turn alone"),
    ({"tachometer": {"rad_s_per_count": 0.1}}, "position alone"),
]


@pytest.mark.parametrize(("sections", "words"), REFUSED)
def test_one_mistake_is_one_line(sections: dict[str, Any], words: str, tmp_path: Path) -> None:
    said = problems(changed(tmp_path, **sections))
    assert len(said) == 1 and words in said[0], said


def test_a_sensor_beside_the_servos_own_is_refused(tmp_path: Path) -> None:
    path = changed(tmp_path, sensor={"encoder": {"counts_per_turn": 64}})
    assert any("give `servo` alone" in line for line in problems(path))
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    data["sensor"] = {"encoder": {"counts_per_turn": 4096}}
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    assert any("has a sensor of its own" in line for line in problems(path))


@pytest.mark.parametrize("name", ["servo", "servo-sts3215"])
def test_a_runs_own_config_is_read_again(name: str, tmp_path: Path) -> None:
    e = config.load(CONFIG / f"{name}.yaml")
    (tmp_path / "config.yaml").write_text(config.dump(e), encoding="utf-8")
    assert config.load(tmp_path / "config.yaml") == e


def test_a_feetech_needs_leave_to_run_without_a_watchdog(tmp_path: Path) -> None:
    said = problems(changed(tmp_path, "servo-sts3215", daq={"accept_no_watchdog": False}))
    assert len(said) == 1 and "keeper on this machine" in said[0]


@pytest.mark.parametrize(("name", "accepts", "attached", "switch", "max_V", "words"), [
    ("servo", False, "nothing", None, 1.6, ""),
    ("servo", False, "load", None, 1.6, ""),
    ("servo", False, "joint", None, 1.6, ""),  # the watchdog is proven, or the run ends before it drives
    ("servo", True, "joint", None, 1.6, "put a switch"),
    ("servo", True, "joint", "the red one", 1.6, ""),
    ("servo-sts3215", True, "nothing", None, 3.0, ""),
    ("servo-sts3215", True, "load", None, 3.0, ""),
    ("servo-sts3215", True, "joint", None, 3.0, "put a switch"),
    ("servo-sts3215", True, "joint", "the red one", 3.0, ""),
])  # fmt: skip
def test_which_combinations_run(
    name: str, accepts: bool, attached: str, switch: str | None, max_V: float, words: str, tmp_path: Path
) -> None:
    servo = {"attached": attached} | ({} if switch is None else {"supply_switch": switch})
    said = problems(
        changed(tmp_path, name, daq={"accept_no_watchdog": accepts, "servo": servo}, drive={"max_V": max_V})
    )
    assert said == [] if words == "" else len(said) == 1 and words in said[0], said


def test_a_load_without_a_watchdog_bounds_the_drive(tmp_path: Path) -> None:
    daq = {"accept_no_watchdog": True, "servo": {"attached": "load"}}
    path = changed(tmp_path, daq=daq, drive={"max_V": 4.8}, motor={"no_load_speed_rad_s": 40.0})
    said = [line for line in problems(path) if "could leave limits.hard_rad" in line]
    assert len(said) == 1
    most_V = float(said[0].rpartition("at most ")[2].split()[0])
    path = changed(tmp_path, daq=daq, drive={"max_V": most_V}, motor={"no_load_speed_rad_s": 40.0})
    assert not any("could leave" in line for line in problems(path))


ARM = {"mass_kg": 0.1, "arm_m": 0.1}  # 0.94 V of a servo of 0.52 N m at 5 V; friction is 0.13 V
LEVER = {"mass_kg": 0.01, "arm_m": 0.1}  # 0.09 V
TORQUE = {"stall_torque_N_m": 0.52}


def loaded(
    tmp_path: Path, load: dict[str, Any], attached: str = "load", name: str = "servo", **sections: Any
) -> list[str]:
    servo = {"daq": {"servo": {"attached": attached}}}
    return problems(changed(tmp_path, name, load=load, **{"motor": TORQUE} | servo | sections))


@pytest.mark.parametrize("attached", ["load", "joint"])
@pytest.mark.parametrize(("load", "words"), [
    (ARM, "the arm falls when the torque goes off"),
    (LEVER, ""),
    (ARM | {"hangs": True}, ""),
    (ARM | {"axis": "vertical"}, ""),
])  # fmt: skip
def test_an_arm_that_falls_is_refused(load: dict[str, Any], words: str, attached: str, tmp_path: Path) -> None:
    said = loaded(tmp_path, load, attached)
    assert said == [] if words == "" else len(said) == 1 and words in said[0], said
    assert words == "" or all(way in said[0] for way in ("on its rest", "load.hangs: true", "off the horn"))


def test_friction_that_holds_the_arm_is_that_of_the_breakaway_check(tmp_path: Path) -> None:
    pull_V = 9.81 * 0.1 * 0.1 / 0.52 * 5.0
    for times, holds in ((2.9, False), (3.1, True)):
        said = loaded(tmp_path, ARM, breakaway={"max_V": times * pull_V}, drive={"max_V": 3.2})
        assert any("the arm falls" in line for line in said) is not holds


def test_a_load_needs_its_torque_and_something_attached(tmp_path: Path) -> None:
    said = problems(changed(tmp_path, load=LEVER, daq={"servo": {"attached": "load"}}))
    assert len(said) == 1 and "stall_torque_N_m is missing" in said[0]
    said = loaded(tmp_path, LEVER, "nothing")
    assert len(said) == 1 and "nothing is attached" in said[0]


def test_a_joint_whose_arm_swings_to_a_stop_is_refused(tmp_path: Path) -> None:
    limits = {"soft_rad": [-0.6, 1.2], "hard_rad": [-1.1, 2.2], "max_speed_rad_s": 6.0}
    slow: dict[str, Any] = {"limits": limits, "drive": {"max_V": 0.8}}
    assert loaded(tmp_path, ARM | {"hangs": True}, "load", **slow) == []
    said = loaded(tmp_path, ARM | {"hangs": True}, "joint", **slow)
    assert len(said) == 1 and "can swing through 0 rad" in said[0] and "at most 1.1 rad" in said[0]


def test_a_joint_has_room_for_its_watchdog_and_a_unit_of_it(tmp_path: Path) -> None:
    """3 periods, time-out, watchdog, 20 ms and coasting are 0.18 s; 1.6 V are 3.84 rad/s."""
    far_rad = 0.18 * 12.0 * 1.6 / 5.0
    joint: dict[str, Any] = {"daq": {"servo": {"attached": "joint"}}}
    for more_rad, fits in ((0.002, True), (-0.002, False)):
        hard_rad = 1.2 + far_rad + more_rad
        said = problems(changed(tmp_path, limits={"hard_rad": [-hard_rad, hard_rad]}, **joint))
        assert (said == []) is fits, said
    assert len(said) == 1 and "before the drive is taken away" in said[0]
    most_V = float(said[0].rpartition("at most ")[2].split()[0])
    limits = {"hard_rad": [-hard_rad, hard_rad]}
    assert 1.58 < most_V < 1.6 and problems(changed(tmp_path, limits=limits, drive={"max_V": most_V}, **joint)) == []
    assert problems(changed(tmp_path, limits=limits)) == []  # a free horn has no stop


def test_a_joint_without_a_watchdog_has_room_for_late_answers(tmp_path: Path) -> None:
    """3 periods, as long as its keeper waits, and coasting are 0.15 s; 3 V are 2.43 rad/s."""
    far_rad = 0.15 * 6.0 * 3.0 / 7.4
    joint: dict[str, Any] = {"daq": {"servo": {"attached": "joint", "supply_switch": "the red one"}}}
    for more_rad, fits in ((0.002, True), (-0.002, False)):
        hard_rad = 1.2 + far_rad + more_rad
        said = problems(changed(tmp_path, "servo-sts3215", limits={"hard_rad": [-hard_rad, hard_rad]}, **joint))
        assert (said == []) is fits, said


def test_a_load_without_a_watchdog_stays_inside_from_the_soft_limit_on(tmp_path: Path) -> None:
    limits = {"soft_rad": [-1.2, 1.2], "hard_rad": [-1.4, 1.4]}
    load: dict[str, Any] = {"daq": {"servo": {"attached": "load"}}}
    said = problems(changed(tmp_path, "servo-sts3215", limits=limits, **load))
    assert len(said) == 1 and "within 0.1 s of a soft limit" in said[0]
    most_V = float(said[0].rpartition("at most ")[2].split()[0])
    assert abs(most_V - 0.2 / 0.1 * 7.4 / 6.0) < 0.02
    assert problems(changed(tmp_path, "servo-sts3215", limits=limits, drive={"max_V": most_V}, **load)) == []


def test_a_load_is_of_a_servo(tmp_path: Path) -> None:
    said = problems(changed(tmp_path, "demo", load=LEVER))
    assert len(said) == 1 and "load on a servo alone" in said[0]
