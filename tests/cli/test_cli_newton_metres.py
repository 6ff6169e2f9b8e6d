"""`rig newton-metres`: what a stated mass on an arm makes of an answer in volts, exactly, and how it refuses."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from command_line import rig
from hypothesis import given
from hypothesis import strategies as st

from rig.output.newton_metres import GRAVITY_M_S2, Load, Quantity, inertia_V_s2_rad, newton_metres
from rig.run_folder.results import Answer, FoundLawResult

# the XL330 of Rhoban/bam, model M1
KT, R_OHM, INERTIA, VISCOUS, FRICTION = 0.386696, 4.017129, 1.814167e-3, 3.661672e-3, 1.283272e-2
MASS, ARM = 0.05, 0.1
CONFIG = Path(__file__).resolve().parents[2] / "config"


def answer(
    load: Load | None = None,
    motor: tuple[float, float, float, float, float] = (KT, R_OHM, INERTIA, VISCOUS, FRICTION),
    *,
    pull: float = 1.0,
    half: float = 0.0,
    **more: Any,
) -> Answer:
    """What a perfect identification says of that motor with this load: each number with a half width of ``half``, 1."""
    kt, R_ohm, inertia, viscous, friction = motor
    a, damping = kt / R_ohm, kt * kt / R_ohm + viscous
    law = []
    if load is not None:
        mass, arm = load.mass_kg.value, load.arm_m.value
        inertia += (mass + load.rod_kg / 3.0) * arm**2
        size = pull * GRAVITY_M_S2 * (mass + 0.5 * load.rod_kg) * arm / a
        law = [
            FoundLawResult(
                name="force_over_position", value=size, unit="V", ci95=(size * (1 - half), size * (1 + half))
            )
        ]
    numbers = {"tau_s": inertia / damping, "K_rad_s_V": a / damping, "fc_V": friction / a}
    ci95 = {name: (value * (1 - half), value * (1 + half)) for name, value in numbers.items()}
    return Answer(**numbers, ci95=ci95, law=tuple(law), verdict="ok", **more)


def a_load(mass_kg: float = MASS, arm_m: float = ARM, rod_kg: float = 0.0, *, half: float = 1e-3) -> Load:
    return Load(Quantity(mass_kg, half * mass_kg), Quantity(arm_m, half * arm_m), rod_kg)


@given(
    st.floats(0.05, 2.0), st.floats(0.5, 20.0), st.floats(1e-4, 0.05), st.floats(0.0, 0.1), st.floats(0.001, 0.1),
    st.floats(0.0, 0.5),
)  # fmt: skip
def test_any_motor_comes_back_in_newton_metres(
    kt: float, R_ohm: float, inertia: float, viscous: float, friction: float, rod_kg: float
) -> None:
    motor, load = (kt, R_ohm, inertia, viscous, friction), a_load(rod_kg=rod_kg)
    found = newton_metres(answer(load, motor), load, answer(None, motor), Quantity(R_ohm))
    assert found.verdict == "ok"
    numbers = found.by_gravity, found.by_inertia, found.inertia_kg_m2, found.friction_N_m, found.kt_N_m_A
    values = [one.value for one in numbers if one is not None]
    assert values == pytest.approx([kt / R_ohm, kt / R_ohm, inertia, friction, kt], rel=1e-9)
    assert found.damping_N_m_s_rad is not None
    assert found.damping_N_m_s_rad.value == pytest.approx(viscous + kt * kt / R_ohm, rel=1e-9)
    alone = newton_metres(answer(load, motor), load)  # J by gravity alone, less the load's
    assert alone.inertia_kg_m2 is not None and alone.inertia_kg_m2.value == pytest.approx(inertia, rel=1e-6)
    assert alone.verdict == "doubtful" and "one way alone" in alone.reasons[0]


def test_each_half_width_reaches_the_torque_by_its_power() -> None:
    load = Load(Quantity(MASS, 0.01 * MASS), Quantity(ARM, 0.02 * ARM))
    found = newton_metres(answer(load), load, answer())
    assert found.by_gravity is not None and found.by_inertia is not None and found.difference is not None
    assert found.by_gravity.percent == pytest.approx(math.hypot(1.0, 2.0), rel=1e-6)
    assert found.by_inertia.percent == pytest.approx(math.hypot(1.0, 4.0), rel=1e-6)
    # the mass is in both ways alike, the arm once more in the inertia
    assert 100.0 * found.difference.u95 == pytest.approx(2.0, rel=1e-6)
    assert found.torque_N_m_V == found.by_gravity  # the narrower one


def test_the_scatter_of_tau_over_K_counts_with_its_correlation_and_the_rest_without() -> None:
    scatter: dict[str, Any] = {"covariance_of": ("tau_s", "K_rad_s_V"), "correlation": ((1.0, 1.0), (1.0, 1.0))}
    assert inertia_V_s2_rad(answer(half=0.01, **scatter)).percent == pytest.approx(0.0, abs=1e-5)
    assert inertia_V_s2_rad(answer(half=0.01)).percent == pytest.approx(math.sqrt(2.0), rel=1e-6)
    wider: dict[str, Any] = {"u95": {"tau_s": 0.05 * (answer().tau_s or 0.0)}}
    assert inertia_V_s2_rad(answer(half=0.01, **scatter, **wider)).percent == pytest.approx(math.sqrt(24.0), rel=1e-6)


def test_an_error_of_the_supply_is_in_kt_alone() -> None:
    K = answer().K_rad_s_V or 0.0
    bare = answer(u95={"K_rad_s_V": 0.0}, u95_absolute={"K_rad_s_V": 0.03 * K})
    load = a_load(half=0.0)
    found = newton_metres(answer(load), load, bare, Quantity(R_OHM))
    assert found.kt_N_m_A is not None and found.inertia_kg_m2 is not None and found.torque_N_m_V is not None
    assert found.kt_N_m_A.percent == pytest.approx(3.0, rel=1e-6)
    assert found.inertia_kg_m2.u95 == found.torque_N_m_V.u95 == 0.0


def test_an_arm_that_was_not_measured_well_is_found_without_the_mass() -> None:
    stated, true = a_load(), a_load(2.0 * MASS, 1.1 * ARM)
    found = newton_metres(answer(true), stated, answer())
    assert found.verdict == "refused" and found.torque_N_m_V is None and found.inertia_kg_m2 is None
    assert found.swing_m is not None and found.swing_m.value == pytest.approx(1.1 * ARM, rel=1e-9)
    assert "0.11 m (the mass does not count)" in found.reasons[0] and "0.1 m;" in found.reasons[0]


def test_ways_that_differ_by_less_than_their_errors_agree() -> None:
    load = a_load()
    assert newton_metres(answer(load, pull=1.02, half=0.01), load, answer(half=0.01)).verdict == "ok"
    assert newton_metres(answer(load, pull=1.02), load, answer()).verdict == "refused"


def test_what_the_motor_does_not_show_is_no_way() -> None:
    load = a_load()
    level = newton_metres(answer(load).model_copy(update={"law": ()}), load, answer())
    assert level.by_gravity is None and level.by_inertia == level.torque_N_m_V
    assert level.verdict == "doubtful" and "no force over position" in level.reasons[0]
    light = newton_metres(answer(load, half=0.2), load, answer(half=0.2))
    assert light.by_inertia is None and light.by_gravity is not None
    assert "take a larger mass" in light.reasons[0]
    unknown = newton_metres(answer(load, half=1.0), load, answer(half=1.0))
    assert unknown.verdict == "refused" and unknown.torque_N_m_V is None
    refused = newton_metres(answer(load), load, answer().model_copy(update={"verdict": "refused"}))
    assert refused.verdict == "refused" and refused.reasons == ("the run without it has no usable answer",)


def test_a_run_of_another_motor_is_none_without_the_load() -> None:
    load, other = a_load(), (2.0 * KT, R_OHM, INERTIA, VISCOUS, FRICTION)
    found = newton_metres(answer(load), load, answer(None, other))
    assert found.verdict == "refused" and found.torque_N_m_V is None and "one motor" in found.reasons[0]
    near = (KT, R_OHM, INERTIA, 1.3 * VISCOUS, FRICTION)  # K 2.7 % off
    assert newton_metres(answer(load), load, answer(None, near)).verdict != "ok"
    assert newton_metres(answer(load, half=0.02), load, answer(None, near, half=0.02)).verdict == "ok"


def test_numbers_without_an_interval_are_not_exact() -> None:
    load = a_load()
    assert newton_metres(answer(load, half=0.01), load, answer().model_copy(update={"ci95": None})).verdict == "refused"


@pytest.mark.parametrize("update", [{"tau_s": 0.0}, {"K_rad_s_V": 0.0}, {"K_rad_s_V": -2.0}, {"fc_V": math.nan}])
def test_numbers_that_no_motor_has_are_refused(update: dict[str, float]) -> None:
    load = a_load()
    assert newton_metres(answer(load), load, answer().model_copy(update=update)).verdict == "refused"


def test_a_force_that_the_motor_has_without_the_load_widens_the_pull() -> None:
    """Beside the load's it may stand at any angle."""
    load = a_load(half=0.0)
    own = answer().model_copy(update={"law": answer(load, pull=0.05).law})
    found = newton_metres(answer(load), load, own)
    assert found.by_gravity is not None and found.by_gravity.percent == pytest.approx(5.0, rel=1e-2)


def test_a_motor_without_friction_is_shown(tmp_path: Path) -> None:
    load, file = a_load(), tmp_path / "loaded.json"
    none = answer(load).as_json() | {
        "fc_V": 0.0,
        "ci95": {"tau_s": [1.0, 1.0], "K_rad_s_V": [1.0, 1.0], "fc_V": [0.0, 0.0]},
    }
    file.write_text(json.dumps({"answer": none}))
    assert rig("newton-metres", file, "--mass-kg", MASS, "--arm-m", ARM).exit_code == 0


def test_what_a_volt_is_worth_is_in_kt_however_the_answer_has_it() -> None:
    """Of a log of a servo's own loop K has it in u95, too."""
    K = answer().K_rad_s_V or 0.0
    unsure = answer(u95={"K_rad_s_V": 0.41 * K}, u95_absolute={"K_rad_s_V": 0.41 * K})
    found = newton_metres(answer(a_load(half=0.0)), a_load(half=0.0), unsure, Quantity(R_OHM))
    assert found.kt_N_m_A is not None and found.kt_N_m_A.percent == pytest.approx(41.0, rel=1e-6)


def test_the_command_says_it_and_its_status(tmp_path: Path) -> None:
    load, files = a_load(half=0.0), {}
    for name, one in {"loaded": answer(load), "bare": answer()}.items():
        files[name] = tmp_path / f"{name}.json"
        files[name].write_text(json.dumps({"answer": one.as_json()}))
    options = ("--mass-kg", MASS, "--arm-m", ARM, "--bare", files["bare"])
    said = json.loads(rig("newton-metres", files["loaded"], *options, "--R-ohm", R_OHM, "--json").stdout)
    assert said["ok"] and said["kt_N_m_A"]["value"] == pytest.approx(KT, rel=1e-6)
    assert said["torque_N_m_V"]["u95"] == pytest.approx(math.hypot(0.01, 0.01) * KT / R_OHM, rel=1e-3)  # 1 %, 1 mm
    shown = rig("newton-metres", files["loaded"], *options)
    assert shown.exit_code == 0 and "both ways agree" in shown.output and "0.09626" in shown.output
    longer = rig("newton-metres", files["loaded"], *options[:2], "--arm-m", 0.12, *options[4:])
    assert longer.exit_code == 1 and "refused" in longer.output
    stated = ("--mass-kg", f"{MASS},0", "--arm-m", f"{ARM},0", "--bare", files["bare"], "--json")
    assert json.loads(rig("newton-metres", files["loaded"], *stated).stdout)["torque_N_m_V"]["u95"] == 0.0
    for wrong in (0.0005, "0.1,0.2", "-1", "nan", "0.1,", "much"):
        assert rig("newton-metres", files["loaded"], *options[:2], "--arm-m", wrong).exit_code == 2, wrong
    assert rig("newton-metres", tmp_path / "none.json", *options[:4]).exit_code == 2


def test_the_load_that_a_runs_config_states_need_not_be_said_again(tmp_path: Path) -> None:
    load, run = a_load(half=0.0), tmp_path / "loaded"
    run.mkdir()
    (run / "result.json").write_text(json.dumps({"schema": 1, "answer": answer(load).as_json()}))
    asked = rig("newton-metres", run)
    assert asked.exit_code == 2 and "states no load" in asked.output
    stated = f"load: {{mass_kg: {MASS}, arm_m: {ARM}}}\n"
    (run / "config.yaml").write_text((CONFIG / "servo.yaml").read_text() + stated)
    by_config, by_options = (
        json.loads(rig("newton-metres", run, *options, "--json").stdout)
        for options in ((), ("--mass-kg", MASS, "--arm-m", ARM))
    )
    assert by_config == by_options and by_config["torque_N_m_V"]["value"] == pytest.approx(KT / R_OHM)
    other = json.loads(rig("newton-metres", run, "--arm-m", 2.0 * ARM, "--json").stdout)
    assert other["torque_N_m_V"]["value"] == pytest.approx(2.0 * KT / R_OHM)
