"""The offline check: each rule refuses with the numbers, at its key; what passes says what would happen."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from evidence import examples
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from rig.backends.serial import driver as serial_link
from rig.backends.serial import frames
from rig.backends.serial.link_budget import REPLY_SHARE
from rig.config import ConfigError, Experiment, load
from rig.core.calibration import Calibration
from rig.core.signals import BenchDelay
from rig.model.friction import Friction
from rig.model.motor import Motor, State
from rig.running.preflight import check, preflight
from rig.running.preflight.room_to_stop import (
    counted_delay_s,
    guard_settings_of,
    room_for_delay_s,
    stopping_rad,
    watchdog_words,
)

pytestmark = pytest.mark.long

CONFIGS = Path(__file__).parents[2] / "config"
DEMO = (CONFIGS / "demo.yaml").read_text(encoding="utf-8")


def demo(**changes: Any) -> dict[str, Any]:
    """The demo's data with dotted keys changed (``__`` for the dot); None removes."""
    data: dict[str, Any] = yaml.safe_load(DEMO)
    for dotted, value in changes.items():
        *above, last = dotted.split("__")
        section = data
        for key in above:
            section = section.setdefault(key, {})
        if value is None:
            section.pop(last, None)
        else:
            section[last] = value
    return data


def experiment(**changes: Any) -> Experiment:
    return Experiment.model_validate(demo(**changes))


SECTION_MISSING = {
    "serial without port": "daq:",
    "a real port, and no bridge": "drive:",
    "no speed of the motor": "name:",
}  # line that is named instead
REFUSED: dict[str, tuple[dict[str, Any], str, str]] = {
    "soft around no centre": ({"limits__soft_rad": [0.1, 1.1]}, "limits.soft_rad", "must enclose 0 rad"),
    "soft outside hard": ({"limits__soft_rad": [-1.1, 1.95]}, "limits.soft_rad", "not inside limits.hard_rad"),
    "hard beyond the sensor": (
        {"limits__hard_rad": [-1.95, 2.1]},
        "limits.hard_rad",
        "not inside the calibrated range of the sensor between its rails, [-2.002, 2.002] rad",
    ),
    "hard beyond the rails": (
        {"sensor__rail_counts": [100, 1018]},
        "limits.hard_rad",
        "between its rails, [-1.686, 2.002] rad",
    ),
    "no room to stop": (
        {"limits__max_speed_rad_s": 6.0},
        "limits.max_speed_rad_s",
        "no room to stop: at 6 rad/s: 0.180 (3 periods) + 0.360 (reply time-out) + 0.600 (watchdog) + 1.200 (coasting) "
        "= 2.340 rad, but from the centre of travel (0 rad) the nearer hard limit is 1.950 rad away",
    ),
    "no room on one side": (
        {"limits__hard_rad": [-1.8, 1.95]},
        "limits.max_speed_rad_s",
        "from the centre of travel (0 rad) the nearer hard limit is 1.800 rad away",
    ),
    "coasts too far": ({"limits__coast_tau_s": 0.21}, "limits.max_speed_rad_s", "1.029 (coasting)"),
    "more than the supply": (
        {"drive__bridge_drop_V": 9.5},
        "drive.max_V",
        "3 V is more than the 2.5 V that the bridge can give (12 V supply - 9.5 V drop)",
    ),
    "breakaway above the drive": ({"breakaway__max_V": 3.5}, "breakaway.max_V", "more than drive.max_V 3 V"),
    "motion below the sensor": ({"breakaway__motion_rad": 0.01}, "breakaway.motion_rad", "less than 3 counts"),
    "motion that the guard would not see": (
        {"breakaway__motion_rad": 1.5},
        "breakaway.motion_rad",
        "1.5 rad is more than 0.1 rad",
    ),
    "no speed of the motor": ({"motor": None}, "motor", "motor.no_load_speed_rad_s is missing"),
    "a ramp of one stroke": (
        {"breakaway__ramp_V_s": 1000.0},
        "breakaway.ramp_V_s",
        "1000 V/s reaches breakaway.max_V in 1 strokes each way",
    ),
    "unseen travel, a fast motor": (
        {"motor__no_load_speed_rad_s": 400.0},
        "breakaway.max_V",
        "1.2 V is too much: if the sensor is stuck or uncoupled, the shaft could turn more than 0.5 rad in the "
        "breakaway check before rig notices. By motor.no_load_speed_rad_s it reaches 40 rad/s",
    ),
    "unseen travel, a ramp that takes for ever": (
        {"breakaway__ramp_V_s": 0.01},
        "breakaway.max_V",
        "before rig notices",
    ),
    "gains above the drive": (
        {"relay__target": None, "relay__gains": [{"h1_V": 0.8, "h2_V": 1.0}, {"h1_V": 1.6, "h2_V": 1.5}]},
        "relay.gains[1]",
        "h1 + h2 = 1.6 + 1.5 = 3.1 V is more than drive.max_V 3 V",
    ),
    "gain above h_max": (
        {"relay__target": None, "relay__gains": [{"h1_V": 0.8, "h2_V": 1.0}], "relay__search": {"h_max_V": 0.9}},
        "relay.gains[0].h2_V",
        "1 V is more than relay.search.h_max_V 0.9 V",
    ),
    "search starts above h_max": (
        {"relay__search": {"h1_start_V": 3.1}, "drive__max_V": 5.0},
        "relay.search.h1_start_V",
        "3.1 V is more than relay.search.h_max_V 3 V",
    ),
    "amplitude at the soft limit": (
        {"relay__target__amplitude_rad": 1.0, "relay__target__period_s": 2.0},
        "relay.target.amplitude_rad",
        "1 rad + 15 % tolerance = 1.15 rad leaves the soft limits (1.1 rad",
    ),
    "second amplitude at the soft limit": (
        {"relay__second_ratio": 2.0, "relay__target__period_s": 2.0},
        "relay.target.amplitude_rad",
        "the larger test's 1.2 rad",
    ),
    "amplitude below the sensor": (
        {"relay__target__amplitude_rad": 0.13},  # the search may end 15 % below it
        "relay.target.amplitude_rad",
        "the smaller test's 0.091 rad - 15 % tolerance = 0.0774 rad is less than 20 counts",
    ),
    "cycle too short": (
        {"relay__target__period_s": 0.29, "relay__target__amplitude_rad": 0.15},
        "relay.target.period_s",
        "0.29 s is 29 periods of the loop; a shorter cycle than 30 is delay hunting",
    ),
    "cycle within which the guard would brake": (
        {"relay__target__amplitude_rad": 0.6, "relay__target__period_s": 1.0},
        "relay.target.amplitude_rad",
        "the guard would brake within the cycle: its predicted stop reaches 2.15 rad",
    ),
    "rest too short for the noise": (
        {"period_s": 0.02, "breakaway__rest_s": 0.1, "daq__watchdog_s": 0.1} | {"limits__max_speed_rad_s": 4.5},
        "breakaway.rest_s",
        "5 periods of the loop",
    ),
    "cycle too fast": (
        {"limits__max_speed_rad_s": 2.9},
        "relay.target.amplitude_rad",
        "= 3 rad/s, above limits.max_speed_rad_s 2.9",
    ),
    "trajectory too wide": (
        {"tracking__trajectory": [{"amplitude_rad": 0.9, "omega_rad_s": 1}, {"amplitude_rad": -0.3, "omega_rad_s": 2}]},
        "tracking.trajectory",
        "at most 0.9 + 0.3 = 1.2 rad, leaves the soft limits (1.1 rad",
    ),
    "trajectory too fast": (
        {"tracking__trajectory": [{"amplitude_rad": 0.5, "omega_rad_s": 12}]},
        "tracking.trajectory",
        "at most 0.5 x 12 = 6 rad/s, is above limits.max_speed_rad_s 4.9",
    ),
    "watchdog too short": (
        {"daq__watchdog_s": 0.025, "daq__timeout_s": 0.01},
        "daq.watchdog_s",
        "must be 3 periods of 0.01 s at least, and 0.5 s at most, not 0.025 s",
    ),
    "watchdog too long": (
        {"daq__watchdog_s": 0.505, "limits__max_speed_rad_s": 2.3, "relay__target__amplitude_rad": 0.2},
        "daq.watchdog_s",
        "not 0.505 s",
    ),
    "time-out beyond the watchdog": (
        {"daq__timeout_s": 0.05, "daq__watchdog_s": 0.05},
        "daq.timeout_s",
        "one lost reply would set off the watchdog",
    ),
    "link too slow": (
        {"daq__baud": 9600},
        "daq.baud",
        "READ 8 + STATE 32 + DRIVE 10 = 50 bytes x 11 bits / 9600 baud = 57.29 ms, + 1 ms (turnaround) = 58.29 ms; "
        "80 % of the period is 8.00 ms",
    ),
    "time-out too short for a reading": (
        {"daq__timeout_s": 0.006},
        "daq.timeout_s",
        "6 ms is too short for a reading: READ 8 + STATE 32 = 40 bytes x 11 bits / 115200 baud = 3.82 ms, + 1 ms "
        "(turnaround) = 4.82 ms; after two thirds of the time-out it is asked for again",
    ),
    "serial without port": ({"daq__port": None}, "daq.port", "`driver: serial` needs a port"),
    "a real port, and no bridge": (
        {"daq__port": "/dev/ttyACM0", "daq__adapter": "none"},
        "drive.bridge",
        "is missing, and a real motor may be behind /dev/ttyACM0",
    ),
    "simulated with port": ({"daq__driver": "simulated"}, "daq.port", "`driver: simulated` has no port"),
    "serial with a port of Modbus": (
        {"daq__port": "tcp://10.0.0.1", "daq__adapter": "none"},
        "daq.port",
        "tcp://10.0.0.1 is a port of `driver: modbus`",
    ),
    "simulated with adapter": (
        {"daq__driver": "simulated", "daq__port": None, "daq__adapter": "ftdi"},
        "daq.adapter",
        "is a key of `driver: serial`, not of `driver: simulated`",
    ),
    "emulated without section": ({"emulated": None}, "emulated", "`port: emulated` needs this section"),
    "simulated without section": (
        {"emulated": None, "daq__driver": "simulated", "daq__port": None},
        "emulated",
        "`driver: simulated` needs this section",
    ),
    "static below moving": (
        {"emulated__motor__fs_plus_V": 0.4},
        "emulated.motor.fs_plus_V",
        "static friction 0.4 V is less than the moving friction fc_plus_V 0.5 V",
    ),
    "static friction by direction of a motor with parts": (
        {"emulated__motor__fs_plus_V": 0.9, "emulated__motor__parts": {"backlash_rad": 0.01}},
        "emulated.motor.parts",
        "static friction is above moving friction by 0.4 V one way and",
    ),
    "Stribeck velocity without static friction": (
        {
            "emulated__motor__stribeck_rad_s": 0.1,
            "emulated__motor__fs_plus_V": None,
            "emulated__motor__fs_minus_V": None,
        },
        "emulated.motor.stribeck_rad_s",
        "has no effect: static friction is nowhere above moving friction",
    ),
    "starts outside": ({"emulated__motor__start_rad": -2.0}, "emulated.motor.start_rad", "outside the hard limits"),
    "starts beyond the stops": (
        {"emulated__motor__start_rad": 0.5, "emulated__motor__stop_rad": [-0.4, 0.4]},
        "emulated.motor.start_rad",
        "outside the mechanical stops",
    ),
    "relay in no device": (
        {"daq__driver": "simulated", "daq__port": None, "relay__where": "device", "limits__max_speed_rad_s": 4.5},
        "relay.where",
        "`driver: simulated` has no device",
    ),
    "too slow for the device's samples": (
        {
            "daq__baud": 57600,
            "period_s": 0.02,
            "relay__where": "device",
            "limits__max_speed_rad_s": 4.2,
            "relay__target__period_s": 1.5,
        },
        "daq.baud",
        "BLOCK 66 bytes x 11 bits / 57600 baud = 12.60 ms of every 10 ms",
    ),
    "a bent sensor": (
        {
            "relay__where": "device",
            "limits__max_speed_rad_s": 4.5,
            "sensor__calibration": [
                {"counts": 24, "rad": -2.0015625},
                {"counts": 512, "rad": 0.0082},
                {"counts": 1000, "rad": 2.0015625},
            ],
        },
        "sensor.calibration",
        "bends by 2.0 counts",
    ),
    "the device's samples are older": (
        {"relay__where": "device"},
        "limits.max_speed_rad_s",
        "0.245 (5 periods) + 0.294 (reply time-out)",
    ),
    "spinning for most of the period": (
        {
            "loop__spin_us": 1000.0,
            "period_s": 0.0019,
            "daq__baud": 2_000_000,
            "daq__watchdog_s": 0.016,
            "daq__timeout_s": 0.01,
        },
        "loop.spin_us",
        "1000 us of spinning is more than half the period of 1.9 ms",
    ),
    "tachometer without scale": ({"emulated__tachometer": True}, "emulated.tachometer", "needs the section"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_each_rule_refuses_with_one_line_at_its_key(case: str, tmp_path: Path) -> None:
    changes, key, message = REFUSED[case]
    path = tmp_path / "refused.yaml"
    path.write_text(yaml.safe_dump(demo(**changes), sort_keys=False, default_flow_style=None), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        check(path)
    (problem,) = caught.value.problems
    assert problem.key == key
    assert message in problem.message
    # the value's line; the section's, where the key is not given; the first, where the section is not
    line = path.read_text(encoding="utf-8").splitlines()[problem.line - 1].strip()
    if case in ("emulated without section", "simulated without section"):
        assert problem.line == 1
    elif key in ("relay.gains[1]", "tracking.trajectory", "sensor.calibration"):
        assert line.startswith("- {")
    elif key == "relay.gains[0].h2_V":
        assert line[problem.column - 1 - 2 :].startswith("1.0}")  # two spaces of indentation were stripped
    else:
        last = key.rpartition(".")[2]
        assert f"{last}:" in line or line.startswith(SECTION_MISSING.get(case, "?"))
    assert str(problem).startswith(f"{path}:{problem.line}:{problem.column}: {key}: ")
    # the schema alone has nothing against it, and says what would happen all the same
    assert load(path) == experiment(**changes)
    assert preflight(experiment(**changes)).lines


@pytest.mark.parametrize("name", ["demo", "demo-chip", "demo-pico", "simulated", "uno", "pico", "device-relay"])
def test_the_ready_configs_pass_and_say_what_would_happen(name: str) -> None:
    loaded, found = check(CONFIGS / f"{name}.yaml")
    assert loaded.name == name
    assert found.problems == ()
    text = "\n".join(found.lines)
    for word in ("backend:", "breakaway", "stage search", "relay", "verify", "limits:", "stopping", "failsafe"):
        assert word in text
    assert ("REAL MOTOR" in text) == (name in ("uno", "pico"))
    assert ("emulated chip" in text) == (name in ("demo-chip", "demo-pico"))
    assert ("link:" in text) == (name != "simulated")


def test_lines_name_given_gains_a_left_out_check_and_an_unused_section() -> None:
    gains = [{"h1_V": 0.8, "h2_V": 1.0}]
    lines = preflight(experiment(relay__target=None, relay__gains=gains, tracking=None, daq__port="/dev/ttyACM0")).lines
    text = "\n".join(lines)
    assert "(0.8, 1) V; their period is not known yet" in text
    assert "verify: left out" in text
    in_device = preflight(experiment(relay__target=None, relay__gains=gains, relay__where="device"))
    assert "  at (0.8, 1) V it drives +-120 and +-13 of 799 units" in in_device.lines
    assert "`emulated` is not used with port /dev/ttyACM0" in text
    assert "K and f_c will come out scaled" in "\n".join(preflight(experiment(emulated__supply_V=11.0)).lines)
    assert "rig jog" in "\n".join(preflight(experiment(emulated__motor__start_rad=1.5)).lines)


def test_frames_are_as_long_as_the_link_budget_says() -> None:
    """Against the code that builds them."""
    lengths = [
        len(frames.encode(kind, 7, bytes(frames.BODY_LENGTH[kind])))
        for kind in (frames.Kind.READ, frames.Kind.STATE, frames.Kind.DRIVE)
    ]
    text = "\n".join(preflight(experiment()).lines)
    assert "READ {} + STATE {} + DRIVE {}".format(*lengths) in text
    assert f"= {sum(lengths)} bytes" in text
    block = frames.Block(0, 0, 0, 0, 0, 0, ((0, 0),) * frames.BLOCK_ROWS).pack()
    in_device = experiment(relay__where="device", limits__max_speed_rad_s=4.5)
    assert f"BLOCK {len(frames.encode(frames.Kind.BLOCK, 7, block))} bytes" in "\n".join(preflight(in_device).lines)


def test_a_time_out_that_is_hinted_at_passes_and_the_driver_asks_again_when_the_rule_says() -> None:
    (problem,) = preflight(experiment(daq__timeout_s=0.006)).problems
    assert problem.hint == "0.0073 seconds and more, or a higher daq.baud"
    assert not preflight(experiment(daq__timeout_s=0.0073)).problems
    assert serial_link._ASK_AGAIN == REPLY_SHARE


def test_sensor_range_is_that_of_the_calibration_used_by_the_driver(tmp_path: Path) -> None:
    """A falling table with a bend: the range printed is the positions of the readings just inside the rails."""
    table = [{"counts": 0, "rad": 2.5}, {"counts": 500, "rad": 0.1}, {"counts": 1023, "rad": -2.2}]
    e = experiment(sensor__calibration=table, sensor__rail_counts=[40, 1000])
    calibration = Calibration(e.sensor.points)
    low, high = calibration.to_rad(999), calibration.to_rad(41)
    text = "\n".join(preflight(e).lines)
    assert f"sensor [{low:.4g}, {high:.4g}] rad" in text


@given(tau_s=st.floats(0.05, 0.2), fc_V=st.floats(0.0, 0.6), speed=st.floats(0.5, 5.5), latency_s=st.floats(0.0, 0.03))
@settings(max_examples=examples(100), deadline=None)
def test_the_stopping_sum_bounds_what_the_exact_motor_travels(
    tau_s: float, fc_V: float, speed: float, latency_s: float
) -> None:
    """Host dead at the worst instant: full speed held for a period, the latency and the watchdog, then 0 V."""
    e = experiment()
    assert preflight(e).problems == ()
    motor = Motor(tau_s, 6.5, Friction(fc_V, fc_V, fc_V, fc_V))
    held_s = e.period_s + latency_s + e.daq.watchdog_s
    hold_V = speed / motor.K_rad_s_V + fc_V
    state = motor.advance(State(v=speed), hold_V, held_s)
    stopped = motor.advance(state, 0.0, 40.0 * tau_s)
    assert stopped.y < e.limits.hard_rad[1]


@pytest.mark.parametrize("name", ["demo.yaml", "uno.yaml", "device-relay.yaml", "modbus-rtu.yaml"])
def test_the_guard_reckons_with_every_term_of_the_stopping_sum(name: str) -> None:
    """What `rig check` adds up is what the guard predicts from."""
    experiment = check(CONFIGS / name)[0]
    guard = guard_settings_of(experiment)
    travelled_rad = guard.max_speed_rad_s * (guard.reaction_s + guard.coast_tau_s)
    assert travelled_rad == pytest.approx(stopping_rad(experiment.device))


def test_the_guard_reckons_with_the_delay_that_was_shown() -> None:
    """What waits beyond a drive's own tick, and the upper end of what no device reports, if that is shown."""
    e = experiment()
    for delay, counted_s in (
        (BenchDelay(0.002), 0.0),
        (BenchDelay(0.0352), 0.0252),
        (BenchDelay(0.002, (-0.01, 0.004, 0.02)), 0.0),
        (BenchDelay(0.002, (0.012, 0.02, 0.03)), 0.03),
        (BenchDelay(0.0352, (0.012, 0.02, 0.03)), 0.0552),
    ):
        assert counted_delay_s(e.device, delay) == pytest.approx(counted_s)
        guard = guard_settings_of(e, 0.003, delay)
        assert guard.delay_s == pytest.approx(counted_s)
        assert guard.reaction_s == guard_settings_of(e).reaction_s


def test_in_order_write_first_a_drives_own_tick_is_the_next_one() -> None:
    modbus = check(CONFIGS / "modbus-rtu.yaml")[0]
    assert counted_delay_s(modbus.device, BenchDelay(0.0352)) == pytest.approx(0.0152)


@pytest.mark.parametrize(
    "changes",
    [
        {},  # the largest speed decides
        {"limits__max_speed_rad_s": 4.0},  # the cycle's centre decides
        {
            "relay__target__amplitude_rad": 0.9,
            "relay__target__period_s": 2.0,
            "limits__max_speed_rad_s": 4.0,
        },  # its arc
    ],
)
def test_with_as_much_delay_as_there_is_room_for_the_shaft_just_stops(changes: dict[str, Any]) -> None:
    """At the largest speed from the centre of travel, and in the largest cycle."""
    e = experiment(**changes)
    room_s, v, target = room_for_delay_s(e), e.limits.max_speed_rad_s, e.relay.target
    assert target is not None
    reaction_s = stopping_rad(e.device) / v + room_s
    largest_rad = target.amplitude_rad * max(1.0, e.relay.second_ratio) * (1.0 + target.tolerance)
    arc = np.linspace(0.0, 1.0, 2001)
    stop_rad = float(np.max(largest_rad * (1.0 - arc**2) + 8.0 * largest_rad / target.period_s * arc * reaction_s))
    assert max(stop_rad, v * reaction_s) == pytest.approx(e.limits.hard_rad[1], rel=1e-3)
    assert f"up to {1e3 * room_s:.0f} ms later than its own tick" in "\n".join(preflight(e).lines)


def test_an_emulated_board_has_no_delay_behind_its_output() -> None:
    (problem,) = preflight(experiment(emulated__motor__delay_s=0.02)).problems
    assert problem.key == "emulated.motor.delay_s"


def test_following_the_hint_on_speed_passes() -> None:
    for tau_s in (0.19, 0.21, 0.25, 0.4):
        changes = {"limits__coast_tau_s": tau_s, "limits__max_speed_rad_s": 7.77, "relay__target__amplitude_rad": 0.2}
        (problem,) = preflight(experiment(**changes)).problems
        hinted = float(problem.hint.split()[2])
        assert hinted < 7.77
        assert preflight(experiment(**{**changes, "limits__max_speed_rad_s": hinted})).problems == ()


@pytest.mark.parametrize(
    "changes",
    [
        {"breakaway__ramp_V_s": 1000.0},
        {"breakaway__ramp_V_s": 2.0},
        {"breakaway__motion_rad": 1.5},
        {"motor__no_load_speed_rad_s": 350.0},
        {"motor__no_load_speed_rad_s": 900.0},
    ],
)
def test_following_the_hint_on_the_breakaway_check_passes(changes: dict[str, Any]) -> None:
    (problem,) = preflight(experiment(**changes)).problems
    hinted = float(next(word for word in problem.hint.split() if word[0].isdigit()))
    key = problem.key.replace(".", "__")
    followed = {**changes, "breakaway__ramp_V_s": 0.4} | {key: hinted}
    if changes.get("motor__no_load_speed_rad_s") == 900.0:
        # so low a drive is reached too soon
        (problem,) = preflight(experiment(**followed)).problems
        assert problem.key == "breakaway.ramp_V_s"
        followed["breakaway__ramp_V_s"] = float(problem.hint.split()[2])
    assert preflight(experiment(**followed)).problems == ()


@pytest.mark.parametrize("period_s", [0.01, 0.02, 0.05])
def test_following_the_hint_on_baud_passes(period_s: float) -> None:
    changes = {
        "period_s": period_s,
        "daq__watchdog_s": 5 * period_s,
        "daq__timeout_s": 2 * period_s,
        "limits__max_speed_rad_s": 2.5,
        "breakaway__rest_s": 0.5,
        "motor__no_load_speed_rad_s": 75
        if period_s < 0.05
        else 20,  # a stroke lasts three such periods if the host dies
        "relay__target__amplitude_rad": 0.4,
        "relay__target__period_s": 2.0,
    }
    (problem,) = preflight(experiment(**changes, daq__baud=9600)).problems
    assert problem.key == "daq.baud"
    baud = int(problem.hint.split()[1])
    assert preflight(experiment(**changes, daq__baud=baud)).problems == ()


def test_ten_periods_are_ten_periods_in_binary_too() -> None:
    for period_s in (0.001, 0.003, 0.007, 0.009, 0.011, 0.1):
        e = experiment(period_s=period_s, daq__watchdog_s=round(10 * period_s, 6), daq__timeout_s=period_s)
        assert "daq.watchdog_s" not in [problem.key for problem in preflight(e).problems]


def cycle_peak_speed(tau_s: float, K: float, fc_V: float, h1_V: float, h2_V: float) -> tuple[float, float, float]:
    """Amplitude, period and largest speed of the relay's settled cycle, by simulation in small steps."""
    motor = Motor(tau_s, K, Friction(fc_V, fc_V, fc_V, fc_V))
    state, dt, sy, sz = State(), 0.0005, -1.0, -1.0
    rising: list[float] = []
    extent = speed = 0.0
    for k in range(24000):
        was = sy
        sy = math.copysign(1.0, state.y) if state.y else sy
        sz = math.copysign(1.0, state.z) if state.z else sz
        if k >= 12000:
            extent, speed = max(extent, abs(state.y)), max(speed, abs(state.v))
            if sy > was:
                rising.append(k * dt)
        state = motor.advance(state, -h1_V * sy - h2_V * sz, dt)
    return extent, (rising[-1] - rising[0]) / (len(rising) - 1), speed


@pytest.mark.parametrize("gains", [(0.8, 1.0), (0.5, 1.2), (0.5, 0.9)])
def test_the_peak_speed_of_a_target_is_that_of_its_cycle(gains: tuple[float, float]) -> None:
    """8 A / T, which the rule on speed uses, is above the true peak, but by no more than a quarter."""
    amplitude, period_s, peak = cycle_peak_speed(0.17, 6.5, 0.5, *gains)
    assert peak < 8.0 * amplitude / period_s < 1.25 * peak


NUMBERS = st.floats(-1e308, 1e308) | st.integers(-(2**31), 2**31) | st.sampled_from([5e-324, 1e-300, 1e300, 0.01, 0.1])
KEYS = [
    (section, key)
    for section, keys in yaml.safe_load(DEMO).items()
    if isinstance(keys, dict)
    for key, value in keys.items()
    if isinstance(value, int | float)
]


@settings(
    max_examples=examples(100), deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much]
)
@given(
    st.dictionaries(st.sampled_from(KEYS), NUMBERS, min_size=1, max_size=3), st.lists(NUMBERS, min_size=4, max_size=4)
)
def test_preflight_never_fails_on_what_the_schema_takes(
    values: dict[tuple[str, str], float], ends: list[float]
) -> None:
    data = demo(limits__soft_rad=sorted(ends)[1:3], limits__hard_rad=sorted(ends)[::3])
    for (section, key), value in values.items():
        data[section][key] = value
    try:
        e = Experiment.model_validate(data)
    except ValidationError:
        assume(False)
    found = preflight(e)
    assert found.lines
    assert all(str(problem) for problem in found.problems)


def test_the_bridge_is_for_real_serial_ports_alone() -> None:
    """The hint says both values, and where to look."""
    (problem,) = preflight(experiment(daq__port="/dev/ttyACM0", daq__adapter="none")).problems
    for words in ("pwm-dir", "in1-in2", "label", "rig doctor"):
        assert words in problem.hint
    for port in ("emulated", "emulated-realtime", "emulated-chip", "emulated-chip-realtime"):
        assert preflight(experiment(daq__port=port)).problems == ()
    problem, *_ = preflight(experiment(daq__port="emulated-real-time")).problems
    assert problem.key == "daq.port" and "emulated-realtime" in problem.hint
    assert [p.key for p in preflight(experiment(daq__port="tcp://10.0.0.1")).problems if "bridge" in p.key] == []


def test_rules_are_pure() -> None:
    """Same experiment, same answer; nothing of it changes (it is frozen), nothing is opened."""
    e = experiment(daq__port="/dev/there-is-no-such-port", daq__adapter="none", drive__bridge="pwm-dir")
    assert preflight(e) == preflight(e)
    assert preflight(e).problems == ()


def test_of_the_watchdog_it_says_what_there_is_to_do_and_nothing_in_virtual_time() -> None:
    real = {"daq__port": "emulated-realtime"}
    assert "no host stands still" in watchdog_words(experiment()) and "0.08" not in watchdog_words(experiment())
    late = watchdog_words(experiment(**real))
    assert "for 100 ms: a shorter gap is no fault" in late and "up to 8 ms late; with daq.watchdog_s 0.08 " in late
    assert "there is room for daq.watchdog_s 0.08: " in watchdog_words(experiment(**real, daq__watchdog_s=0.07))
    assert watchdog_words(experiment(**real, daq__watchdog_s=0.08)).endswith("for 80 ms: a shorter gap is no fault")
