"""`rig export --to TOOL`: each model, loaded by its own tool, beside rig's own motion."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from command_line import rig
from control.nlsys import input_output_response
from evidence import evidence
from run_with_laws import GOLDEN, LAWS, PERIOD_S, PLAIN, drive, motor_of, own_motion, run_with
from scipy.io import loadmat
from wpimath.controller import ArmFeedforward, SimpleMotorFeedforwardRadians

from rig.control.known_motor import KnownMotor
from rig.control.relay import DualChannelRelay
from rig.core.signals import Sample
from rig.identification import identify
from rig.model.cycle_detector import CycleDetector
from rig.model.real_motor import PARTS
from rig.output.export import TOOLS, export_model
from rig.output.export.tool import IN_NONE
from rig.run_folder.recording.reader import read_run
from rig.running.run_tuning import Asked, tune_run

IN_VOLTS = [tool for tool in TOOLS if tool != "bam"]  # it takes newton metres: test_export_newton_metres.py
RIGID = [law for law in LAWS if law not in ("backlash", "bristle", *IN_NONE)]
ON_A_SERVO = ("load_friction", "source", "force_over_position", "lag")
YIELDING = ("bristle", "backlash")
MANY = ("dead_band", "gain_by_sign", "lag", "stribeck", "static", "viscous_by_direction", "force_over_position", "drag")
OTHERS = ("cogging", "friction_over_position", "sag", "linearity")
EACH = [(), *((law,) for law in RIGID), MANY]
# bristles beside what they react to: a level that falls or that changes over the travel, a lag, a force
WITH_BRISTLES = ("bristle", "backlash", "stribeck", "lag", "force_over_position", "friction_over_position")


def module(file: Path) -> ModuleType:
    """A Python file, imported."""
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Makes a run with these laws, exports it to a tool, and returns the folder with the run and the files."""
    made: dict[tuple[str, ...], Path] = {}

    def of(tool: str, *laws: str) -> Path:
        if laws not in made:
            made[laws] = run_with(tmp_path_factory.mktemp("run"), *laws)
        export_model(made[laws], tool, made[laws].parent, overwrite=True)
        return made[laws].parent

    return of


def run_in(folder: Path) -> Path:
    (run,) = (path for path in folder.iterdir() if path.is_dir() and path.name.startswith("2026"))
    return run


@pytest.mark.parametrize(
    "laws",
    [EACH[0], MANY, WITH_BRISTLES, *evidence(*((laws,) for laws in EACH[1:-1]), *(((law,),) for law in YIELDING))],
    ids=lambda laws: "-".join(laws),
)
def test_python_control_moves_the_sampled_system_as_rig_moves_the_motor(
    exported: Callable[..., Path], laws: tuple[str, ...]
) -> None:
    folder = exported("control", *laws)
    exporting = module(folder / "motor_control.py")
    system, u_V = exporting.sampled(PERIOD_S), drive()
    theirs = input_output_response(system, np.arange(u_V.size) * PERIOD_S, u_V, exporting.at_rest()).outputs
    readings, velocities = own_motion(motor_of(run_in(folder)), u_V)
    assert np.ptp(readings) > 3.0
    np.testing.assert_allclose(theirs[0], readings, rtol=0.0, atol=2e-6)
    np.testing.assert_allclose(theirs[1], velocities, rtol=0.0, atol=2e-5)


def test_python_control_has_the_linear_part(exported: Callable[..., Path]) -> None:
    plain = module(exported("control") / "motor_control.py")
    gain, pole = PLAIN["K_rad_s_V"], -1.0 / PLAIN["tau_s"]
    assert sorted(plain.linear().poles().real) == pytest.approx([pole, 0.0])
    assert plain.linear()(1j)[1, 0] == pytest.approx(gain / (1.0 + 1j * PLAIN["tau_s"]))


@pytest.mark.parametrize("laws", [MANY, WITH_BRISTLES], ids="-".join)
def test_python_controls_smooth_motor_is_near_rigs_own(exported: Callable[..., Path], laws: tuple[str, ...]) -> None:
    folder = exported("control", *laws)
    exporting = module(folder / "motor_control.py")
    system, u_V = exporting.motor(), drive(100)
    fine = np.arange(0.0, (u_V.size - 1) * PERIOD_S, 2e-4)
    held = u_V[(fine / PERIOD_S + 1e-9).astype(int)]
    options = {"max_step": 1e-3, "rtol": 1e-7, "atol": 1e-9}
    at_rest = exporting.at_rest()
    found = input_output_response(system, fine, held, at_rest, solve_ivp_method="LSODA", solve_ivp_kwargs=options)
    readings, _ = own_motion(motor_of(run_in(folder)), u_V)
    assert np.abs(found.outputs[0][::50] - readings[:-1]).max() < 2e-3  # friction that turns over 1 mrad/s


@pytest.mark.parametrize(
    "laws",
    [EACH[0], MANY, ON_A_SERVO, ("no_brake", "lag"), *evidence(*((laws,) for laws in EACH[1:-1]))],
    ids=lambda laws: "-".join(laws),
)
def test_mujoco_moves_as_rig_moves_the_motor(exported: Callable[..., Path], laws: tuple[str, ...]) -> None:
    folder = exported("mujoco", *laws)
    shaft = module(folder / "motor_mujoco.py")
    model, data = shaft.load()
    u_V = drive()
    readings, _ = own_motion(motor_of(run_in(folder)), u_V)
    theirs = []
    for volts in u_V.tolist():
        theirs.append(shaft.reading(float(data.qpos[0])))
        shaft.step(model, data, volts, PERIOD_S)
    assert np.abs(np.array(theirs) - readings).max() < 2e-3


def test_mujoco_swings_with_the_recorded_period_and_amplitude_under_the_recorded_relay(tmp_path: Path) -> None:
    """The recording is of a relay in the device: at 1 kHz one cycle is as the next."""
    golden = GOLDEN.parent / "chip-relay-in-device"
    found: dict[str, Any] = identify([read_run(golden)], ("sampled-data",), choose_law=False).as_result().as_json()
    run = run_with(tmp_path, golden=golden)
    result = json.loads((run / "result.json").read_text(encoding="utf-8"))
    result["estimates"] = found["estimates"]
    (run / "result.json").write_text(json.dumps(result), encoding="utf-8")
    assert rig("export", run, "--to", "mujoco", "--into", tmp_path).exit_code == 0
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "motor.xml"))
    tick_s, late_s = 1e-3, found["estimates"]["sampled-data"]["delay_s"]
    late = round(min(late_s, tick_s) / model.opt.timestep)
    (recorded,) = found["relays"]
    data, relay = mujoco.MjData(model), DualChannelRelay(recorded["h1_V"], recorded["h2_V"], 10.0)
    detector = CycleDetector(30.0 * PERIOD_S, 0.01)
    for k in range(9_000):
        y = float(data.qpos[0])
        drive_V = relay.step(Sample(k * tick_s, y, 0))
        detector.step(k * tick_s, y, relay.z_rad_s)
        mujoco.mj_step(model, data, late)
        data.ctrl[0] = drive_V
        mujoco.mj_step(model, data, round(tick_s / model.opt.timestep) - late)
    assert detector.settled
    period_s, amplitude_rad = detector.mean()
    assert period_s == pytest.approx(recorded["period_s"], rel=0.02)
    assert amplitude_rad == pytest.approx(recorded["amplitude_rad"], rel=0.02)


def test_mujoco_names_what_its_model_alone_has_not(exported: Callable[..., Path]) -> None:
    file = exported("mujoco", *MANY) / "motor.xml"
    texts = {one.get("name"): one.get("data", "") for one in ElementTree.parse(file).iter("text")}
    for law in ("dead_band", "gain_by_sign", "stribeck", "static", "viscous_by_direction"):
        assert f"motor_mujoco.py adds {law}" in texts["lacks"]
    for law in ("lag", "force_over_position", "drag"):
        assert law not in texts["lacks"]


@pytest.mark.parametrize("laws", [(), ("force_over_position", "dead_band")], ids="-".join)
def test_wpilib_computes_the_drive_that_rig_asks_for(exported: Callable[..., Path], laws: tuple[str, ...]) -> None:
    folder = exported("wpilib", *laws)
    file = json.loads((folder / "motor_wpilib.json").read_text(encoding="utf-8"))
    gains = {name: one["value"] for name, one in file["gains"].items()}
    assert [one["unit"] for one in file["gains"].values()][:3] == ["V", "V s/rad", "V s^2/rad"]
    assert file["gains"]["kA"]["ci95"][0] < gains["kA"] < file["gains"]["kA"]["ci95"][1]
    motor = KnownMotor(motor_of(run_in(folder)))
    for v_rad_s, y_rad, a_rad_s2 in [(2.0, 0.0, 0.0), (1.0, 0.7, 20.0), (-3.0, -0.4, -10.0)]:
        ours = motor.drive_V(motor.moved(motor.at_rest(0.0), v_rad_s, y_rad), a_rad_s2, v_rad_s)
        if "kG" in gains:
            arm = ArmFeedforward(gains["kS"], gains["kG"], gains["kV"], 0.0)  # with kA it looks a step ahead
            angle = y_rad + file["angle_offset_rad"]["value"]
            theirs = arm.calculate(angle, v_rad_s) + gains["kA"] * a_rad_s2
        else:
            simple = SimpleMotorFeedforwardRadians(gains["kS"], gains["kV"], gains["kA"])
            theirs = simple.calculate(v_rad_s) + gains["kA"] * a_rad_s2
        assert theirs + file["constant_V"]["value"] == pytest.approx(ours, abs=1e-9)


def test_rig_tune_gives_the_gains_that_wpilib_gets(exported: Callable[..., Path]) -> None:
    """Its kS left the dead band out."""
    folder = exported("wpilib", "dead_band")
    gains = json.loads((folder / "motor_wpilib.json").read_text())["gains"]
    forward = tune_run(run_in(folder), Asked("position", None, None, 45.0, 6.0), 39).result().feedforward
    found = (forward.kS_V, forward.kV_V_s_rad, forward.kA_V_s2_rad)
    assert found == pytest.approx([gains[name]["value"] for name in ("kS", "kV", "kA")])


@pytest.mark.evidence
def test_octave_simulates_it_as_rig_moves_it_and_lays_it_over_the_recording(exported: Callable[..., Path]) -> None:
    """One process for all: an export after the other, and the recorded strokes of the first."""
    u_V = drive(150)
    orders, folders = [], []
    for laws in (MANY, OTHERS, WITH_BRISTLES):
        folders.append(folder := exported("matlab", *laws))
        np.savetxt(folder / "u.txt", u_V)
        orders.append(f"cd('{folder}'); clear motor_simulate; u = load('u.txt'); t = (0:numel(u)-1)' * {PERIOD_S};")
        orders.append("out = motor_simulate(t, u, 0, 0); save('-v7', 'out.mat', 'out');")
    orders.append(
        f"cd('{exported('matlab')}'); clear motor_simulate; r = motor_simulate('breakaway'); printf('%.9f', r.rms_rad);"
    )
    command = ["octave-cli", "--quiet", "--no-init-file", "--no-history", "--eval", " ".join(orders)]
    said = subprocess.run(command, check=True, capture_output=True, text=True)
    assert said.stderr == ""
    for folder in folders:
        readings, _ = own_motion(motor_of(run_in(folder)), u_V)
        out = loadmat(folder / "out.mat", simplify_cells=True)["out"]
        np.testing.assert_allclose(out["y_rad"], readings, rtol=0.0, atol=2e-6)
    assert 0.002 < float(said.stdout) < 0.05  # the sensor's noise at least; the strokes end in the static friction


def test_each_model_says_where_it_comes_from_and_how_certain_it_is(exported: Callable[..., Path]) -> None:
    laws = ("drift", "dead_band")
    for tool in IN_VOLTS:
        folder = exported(tool, *laws)
    run = run_in(folder)
    digest = hashlib.sha256((run / "samples.csv").read_bytes()).hexdigest()
    documents: list[dict[str, Any]] = [
        module(folder / "motor_control.py").MODEL,
        module(folder / "motor_mujoco.py").MODEL,
        json.loads((folder / "motor_wpilib.json").read_text(encoding="utf-8"))["motor"],
    ]
    for document in documents:
        assert (document["run"], document["record_sha256"], document["verdict"]) == (run.name, digest, "ok")
        tau, dead_band = document["numbers"]["tau_s"], document["numbers"]["dead_band_V"]
        assert (tau["unit"], tau["ci95"], tau["u95"]) == ("s", [PLAIN["tau_s"] - 0.001, PLAIN["tau_s"] + 0.001], 0.002)
        assert (dead_band["value"], dead_band["ci95"]) == (LAWS["dead_band"]["dead_band_V"], [0.0, 1.0])
        assert [law["name"] for law in document["laws"]] == list(laws)
        assert "drift" in document["lacks"]
    mat = loadmat(folder / "motor.mat", simplify_cells=True)
    assert (mat["motor"]["record_sha256"], mat["motor"]["numbers"]["tau_s"]["unit"]) == (digest, "s")
    assert mat["motor"]["numbers"]["tau_s"]["ci95"].tolist() == documents[0]["numbers"]["tau_s"]["ci95"]
    header, xml = ((folder / name).read_text(encoding="utf-8") for name in ("rig_motor.h", "motor.xml"))
    for text in (header, xml):
        assert digest in text
        assert "95 % 0.169 to 0.171" in text
        assert "LACKS drift 0.1" in text
    assert f'#define RIG_MOTOR_RUN "{run.name}"' in header


def test_a_run_that_anothers_models_drove_names_that_one(tmp_path: Path) -> None:
    """Its motor was said to be its own, identified from its samples."""
    run = run_with(tmp_path)
    result = json.loads((run / "result.json").read_text(encoding="utf-8"))
    (run / "result.json").write_text(json.dumps(result | {"models_from": "runs/measured"}), encoding="utf-8")
    (file,) = export_model(run, "wpilib", tmp_path).files
    motor = json.loads(file.read_text(encoding="utf-8"))["motor"]
    assert (motor["run"], motor["record_sha256"]) == ("measured", None)


def test_without_a_bridge_that_is_free_between_its_pulses_a_model_is_slower_and_stops_sooner(tmp_path: Path) -> None:
    motor = motor_of(run_with(tmp_path, "free_between"))
    model = replace(motor, motor=motor.motor._replace(free_between=0.0))
    (y_rad, v_rad_s), (model_rad, model_rad_s) = (own_motion(one, np.repeat([1.3, 0.0], 50)) for one in (motor, model))
    assert v_rad_s[50] > 1.5 * model_rad_s[50] and y_rad[-1] - y_rad[50] > 1.5 * (model_rad[-1] - model_rad[50])
    assert IN_NONE["free_between"].endswith("at small drives the motor is faster and coasts farther than the model")


def test_the_command_names_what_it_wrote_and_what_is_lacking(
    exported: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = run_in(exported("c", "backlash"))
    monkeypatch.chdir(tmp_path)
    said = rig("export", run, "--to", "c")
    files = ["rig_motor.h", "rig_controller.h", "rig_controller.c", "real_motor.h", "real_motor.c"]
    lacks = "LACKS backlash 0.01 V, 95 % 0 to 1: the sensor follows the motor without play"
    assert said.stdout.splitlines() == [lacks, *files]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(files)
    again = rig("export", run, "--to", "c")
    assert (again.exit_code, again.stderr.splitlines()[0]) == (2, "rig: rig_motor.h: is there already")
    forced = rig("export", run, "--to", "c", "--force", "--json")
    assert json.loads(forced.stdout) == {
        "ok": True, "tool": "c", "files": files, "notes": [],
        "laws": [{"name": "backlash", "value": 0.01, "unit": "V", "ci95": [0.0, 1.0]}],
        "lacks": {"backlash": "the sensor follows the motor without play"},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        (["--to", "mujoco", "--stage", "relay-1"], "--to mujoco takes the model of the whole run"),
        (["--to", "a.mat", "--into", "none"], "--into is for a tool, and 'a.mat' is none"),
        (["--to", "simulink"], "simulink: ends in none of .mat, .npz, .csv, .json, and is no tool"),
    ],
)
def test_what_cannot_be_is_refused(
    exported: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], cause: str
) -> None:
    run = run_in(exported("wpilib"))
    monkeypatch.chdir(tmp_path)
    said = rig("export", run, *arguments)
    assert (said.exit_code, len(said.stderr.splitlines())) == (2, 2)
    assert cause in said.stderr.splitlines()[0]
    assert list(tmp_path.iterdir()) == []


def test_a_model_that_was_refused_is_not_exported_and_a_doubtful_one_says_why_and_where_it_holds(
    tmp_path: Path,
) -> None:
    doubtful = run_with(tmp_path, verdict="doubtful")
    result = json.loads((doubtful / "result.json").read_text(encoding="utf-8"))
    holds = {"drive_V": [0.5, 0.9], "speed_rad_s": [0.2, 2.4], "ways": "both"}
    result["answer"] = {**result["estimates"]["sampled-data"], "method": "sampled-data", "law": [], "holds": holds}
    (doubtful / "result.json").write_text(json.dumps(result), encoding="utf-8")
    for tool in IN_VOLTS:  # its reason tries to end the comments that it stands in
        export_model(doubtful, tool, tmp_path / tool)  # it makes the folder
    assert module(tmp_path / "control" / "motor_control.py").MODEL["reasons"] == ["why */ it is --> so"]
    assert "It holds between 0.5 and 0.9 V, 0.2 and 2.4 rad/s, both ways." in (
        tmp_path / "c" / "rig_motor.h"
    ).read_text(encoding="utf-8")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "mujoco" / "motor.xml")).njnt == 1
    command = ["cc", "-fsyntax-only", "-std=c99", str(tmp_path / "c" / "rig_controller.c")]
    assert subprocess.run(command, check=False).returncode == 0

    result["answer"]["verdict"] = result["estimates"]["sampled-data"]["verdict"] = "refused"
    (doubtful / "result.json").write_text(json.dumps(result), encoding="utf-8")
    said = rig("export", doubtful, "--to", "mujoco", "--into", tmp_path)
    assert (said.exit_code, len(said.stderr.splitlines())) == (2, 2)
    assert "holds no motor that was not refused" in said.stderr


def test_the_page_says_which_laws_each_export_carries() -> None:
    """By the table of docs/export.md; `in kS` is a law that is there in part, and is named as lacking, too."""
    page = (Path(__file__).resolve().parents[2] / "docs" / "export.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"^\| law \|.*\n\|---.*\n((?:\|.*\n)+)", page, re.MULTILINE)
    titles = {"bristles": "bristle", "curvature of the sensor": "linearity", "resistance of the supply": "source"}
    listed: list[str] = []
    for row in table.splitlines():
        laws, *cells = (cell.strip() for cell in row.strip("|").split("|"))
        columns = dict(zip(("control", "mujoco", "wpilib", "c"), cells, strict=True)) | {"matlab": cells[0]}
        for law in laws.split(", "):
            part = titles.get(law, law.lower().replace(" ", "_"))
            listed.append(part)
            for tool, cell in columns.items():
                assert (cell in ("no", "in kS")) == (part in TOOLS[tool].lacks), (tool, law)
    assert sorted(listed) == sorted(PARTS)
