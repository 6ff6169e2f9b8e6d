"""The Python API: what a notebook calls, on files, on lists, on arrays, and on what a simulation gives."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import rig
from rig.backends.emulated.errors import EmulationError
from rig.backends.serial.flash import FlashError
from rig.campaign.random_motors import CampaignError
from rig.config import ConfigError
from rig.config.ready import UnknownConfigError
from rig.core.plug_ins import PlugInError
from rig.identification import IdentifyError
from rig.run_folder.recording.errors import RecordingError

pytestmark = [pytest.mark.drawn, pytest.mark.laws]

MOTOR = rig.Motor(0.17, 6.5, rig.coulomb(0.48))
SAMPLING = rig.Sampling(noise_rad=0.003, resolution_rad=0.004)


@pytest.fixture(scope="module")
def swing() -> rig.Run:
    return rig.simulate(MOTOR, rig.relay(0.39, 0.87), 12.0, SAMPLING)


@pytest.fixture(scope="module")
def found(swing: rig.Run) -> rig.Found:
    return rig.identify([swing, rig.simulate(MOTOR, rig.relay(0.3, 0.76), 12.0, SAMPLING)])


def test_what_is_simulated_is_identified(found: rig.Found) -> None:
    best = found.best
    assert best is not None and best.method == "sampled-data" and best.verdict == "ok"
    for name, truth in {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_V": 0.48}.items():
        assert getattr(best, name) == pytest.approx(truth, rel=0.03)
    assert "sampled-data" in found.summary() and "± " in found.summary() and "triple-relay: " in found.summary()
    with pytest.raises(KeyError, match="there are: sampled-data"):
        found["magic"]


@pytest.mark.usefixtures("plain_motor")
def test_a_file_lists_and_arrays_give_the_same(tmp_path: Path, swing: rig.Run) -> None:
    columns = {"t_s": swing.t_s, "u_V": swing.u_V, "y_rad": swing.y_rad}
    path = tmp_path / "any.csv"
    lines = [",".join(columns), *(",".join(map(repr, map(float, row))) for row in zip(*columns.values(), strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    t, u, y = columns.values()
    same = [
        rig.identify(path),
        rig.identify(str(path)),
        rig.identify(rig.read(path)),
        rig.identify([rig.read(str(path))]),
        rig.identify(t, u, y),
        rig.identify(t.tolist(), u=u.tolist(), y=tuple(y)),
    ]
    estimates = [one.best for one in same]
    assert all(estimate is not None for estimate in estimates)
    assert len({estimate.tau_s for estimate in estimates if estimate is not None}) == 1
    assert list(rig.identify(t, u, y, swing.t_u_s, methods=["sampled-data"]).estimates) == ["sampled-data"]


@pytest.mark.parametrize(
    ("t", "u", "y", "why"),
    [
        ([0, 1, 2], [0, 1], [0, 1, 2], r"u has the shape \(2,\), and t \(3,\)"),
        ([0, 1, 2], [0, 1, 2], [[0, 1, 2]], "y has the shape"),
        ([0, 1, 2], [0, 1, float("nan")], [0, 1, 2], r"u\[2\] is nan"),
        ([0, 1], [0, 1], [0, 1], "there are 2 samples"),
        ([0, 2, 1], [0, 1, 2], [0, 1, 2], "t, u, y"),
    ],
)
def test_columns_that_cannot_be_are_refused_in_words(t: list[float], u: list[float], y: list[float], why: str) -> None:
    with pytest.raises(rig.RigError, match=why):
        rig.identify(t, u, y)


def test_an_answer_predicts_a_record_that_it_has_not_seen(found: rig.Found) -> None:
    later = rig.simulate(MOTOR, lambda t_s: 1.1 * np.sin(3.0 * t_s), 8.0, rig.Sampling(start_rad=0.4))
    said = found.predict(later.t_s, later.u_V, later.y_rad)
    assert said.fit_percent > 95.0 and said.y_rad.shape == later.y_rad.shape
    assert said.residual_rad == pytest.approx(later.y_rad - said.y_rad)
    assert said.plot().axes
    assert "beyond" not in repr(said)
    assert (
        "a drive of 11 V, and the answer holds up to" in found.predict(later.t_s, 10.0 * later.u_V, later.y_rad).beyond
    )
    with pytest.raises(TypeError, match="t, u and y"):
        found.predict(later.t_s, later.u_V)
    with pytest.raises(ValueError, match="2 records"):
        found.predict([later, later])


def test_half_of_the_columns_is_a_mistake_of_the_call() -> None:
    with pytest.raises(TypeError, match="t, u and y"):
        rig.identify([0, 1, 2], [0, 1, 2])  # type: ignore[call-overload]


@pytest.mark.parametrize("drive", [1.2, lambda t_s: 1.2, [1.2] * 100, np.full(100, 1.2)])
def test_any_drive_can_be_simulated(drive: object) -> None:
    run = rig.simulate(MOTOR, drive, 1.0)  # type: ignore[arg-type]
    assert len(run) == 100 and set(run.u_V) == {1.2}
    # tau y' + y = K (u - fc) t, from rest, once the drive acts
    t_s = run.t_s[-1] - 0.001
    exact_rad = 6.5 * (1.2 - 0.48) * (t_s - 0.17 * (1.0 - np.exp(-t_s / 0.17)))
    assert run.y_rad[-1] == pytest.approx(exact_rad, rel=1e-9)


def test_a_simulation_that_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="too few"):
        rig.simulate(MOTOR, 1.0, 0.02)
    with pytest.raises(ValueError, match="no number of volts"):
        rig.simulate(MOTOR, float("nan"), 1.0)
    with pytest.raises(ValueError, match="delay_s"):
        rig.Sampling(delay_s=0.01)


def test_prediction_is_that_of_the_command() -> None:
    expected = rig.predict(tau_s=0.17, K_rad_s_V=6.5, fc_V=0.48, h1_V=0.39, h2_V=0.87)
    assert expected["stable"] and expected["period_s"] == pytest.approx(0.954, abs=0.001)
    with pytest.raises(ValueError, match="tau"):
        rig.predict(tau_s=1e9, K_rad_s_V=6.5, fc_V=0.48, h1_V=0.39, h2_V=0.87)


def test_figures_need_no_display_and_are_not_shown(swing: rig.Run, found: rig.Found) -> None:
    for figure, panels in ((swing.plot(), 2), (found.plot(), 2 * len(found.tests)), (found.plot_methods(), 3)):
        assert len(figure.axes) == panels
        assert figure._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]
    assert "matplotlib.pyplot" not in sys.modules or not sys.modules["matplotlib.pyplot"].get_fignums()


def test_one_estimate_shows_itself(found: rig.Found) -> None:
    best = found.best
    assert best is not None and best.tau_s == found["sampled-data"].tau_s
    assert found.answer is not None and best.answer == found.answer and best.u95 == found.answer.u95
    lines = best.summary().splitlines()
    assert lines[0] == "sampled-data: ok" and lines[1].split("  ")[0] == "parameter"
    assert any(line.startswith("Coulomb friction") and " to " in line for line in lines)
    assert repr(best) == best.summary() and "velocity time constant, s" in best._repr_html_()
    figure = best.plot()
    assert len(figure.axes) == 3
    assert figure._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]
    assert best.judged("refused", "why").summary() == "sampled-data: refused\nwhy"
    silent = replace(best, residual_rad=np.empty(0), residual_t_s=np.empty(0))
    with pytest.raises(ValueError, match="sampled-data estimate has no residual"):
        silent.plot()


def test_what_was_found_goes_to_python_control_by_its_best_estimate(found: rig.Found) -> None:
    best = found.best
    assert best is not None
    assert found.to_control()(3j) == best.to_control()(3j)
    nothing = replace(found, estimates={})
    with pytest.raises(ValueError, match="the answer is no motor"):
        nothing.to_control()


def test_what_a_notebook_shows_is_escaped_html(tmp_path: Path, swing: rig.Run, found: rig.Found) -> None:
    path = tmp_path / "<b>.csv"
    path.write_text("t_s,u_V,y_rad\n0,0,0\n1,0,0\n2,0,0\n", encoding="utf-8")
    assert "&lt;b&gt;.csv" in rig.read(path)._repr_html_()
    assert "sampled-data" in found._repr_html_() and "<table>" in found._repr_html_()
    assert "1200 in" in repr(swing)


def test_a_dataframe_has_the_columns_and_their_units(swing: rig.Run) -> None:
    frame = swing.to_dataframe()
    assert list(frame.columns) == ["t_s", "t_u_s", "y_rad", "u_V"] and frame.attrs["units"]["y_rad"] == "rad"
    assert np.array_equal(frame["y_rad"], swing.y_rad)


def test_the_linear_part_for_python_control(found: rig.Found) -> None:
    best = found.best
    assert best is not None
    plant = best.to_control()
    w = 3.0
    assert plant(1j * w) == pytest.approx(best.K_rad_s_V / (1j * w * (1.0 + 1j * w * best.tau_s)))


@pytest.mark.parametrize(("package", "call"), [("pandas", "to_dataframe"), ("control", "to_control")])
def test_a_package_that_is_missing_is_named(
    monkeypatch: pytest.MonkeyPatch, swing: rig.Run, found: rig.Found, package: str, call: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"{call}\(\) needs the package {package}.*pip install"):
        getattr(swing if package == "pandas" else found.best, call)()


def test_one_error_is_above_all() -> None:
    errors = (
        CampaignError, ConfigError, EmulationError, FlashError, IdentifyError, PlugInError, RecordingError,
        UnknownConfigError, rig.Fault,
    )  # fmt: skip
    assert all(issubclass(error, rig.RigError) for error in errors)
    with pytest.raises(rig.RigError, match="no_such"):
        rig.read("no_such.csv")
    with pytest.raises(rig.RigError, match="did you mean simulated"):
        rig.ready("simulatet")


@pytest.mark.usefixtures("plain_motor", "figureless")
def test_a_config_may_be_a_mapping_and_names_its_keys(tmp_path: Path) -> None:
    config = yaml.safe_load(rig.ready("simulated").read_text(encoding="utf-8"))
    del config["tracking"]
    config["relay"] = {"gains": [{"h1_V": 0.42, "h2_V": 0.85}], "cycles": 4}
    run = rig.run(config, out=tmp_path)
    assert run.failure == "" and run.result is not None and run.folder.parent == tmp_path
    assert set(run["relay-1"].stage) == {"relay-1"}
    again = rig.read(run.folder)
    assert again.result == run.result and rig.replay(again).is_same
    assert rig.identify(run.folder).best is not None
    config["drive"]["max_V"] = "much"
    with pytest.raises(rig.RigError, match=r"^config: drive\.max_V: "):
        rig.run(config, out=tmp_path)
    with pytest.raises(rig.RigError, match="holds a value that no file can hold"):
        rig.run(config | {"name": Path()}, out=tmp_path)


@pytest.mark.usefixtures("figureless")
def test_a_run_that_fails_says_why_and_keeps_its_record(tmp_path: Path) -> None:
    config = yaml.safe_load(rig.ready("simulated").read_text(encoding="utf-8"))
    config["emulated"]["wiring"] = {"drive": "reversed"}
    run = rig.run(config, out=tmp_path)
    assert run.failure.startswith("POLARITY") and len(run) > 10
    assert rig.read(run.folder).failure == run.failure


def test_importing_rig_loads_nothing_that_is_slow_and_what_drives_no_matplotlib() -> None:
    code = """
import sys, rig
print([m for m in ("numpy", "scipy", "matplotlib", "pydantic") if m in sys.modules])
import rig.running.experiment.script
print([m for m in ("numpy", "scipy.optimize", "matplotlib") if m in sys.modules])
"""
    said = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert said.stdout.splitlines() == ["[]", "['numpy']"]


@pytest.mark.evidence
def test_a_function_stays_one_whatever_was_imported_before() -> None:
    """In one process, which forgets rig, and nothing else, before each."""
    code = """
import importlib, sys
for first in ("rig.identification.cycles", "rig.running.replay", "rig.api"):
    for name in [name for name in sys.modules if name.partition(".")[0] == "rig"]:
        del sys.modules[name]
    rig = importlib.import_module("rig")
    importlib.import_module(first)
    from rig.identification import METHODS
    print(callable(rig.identify), callable(rig.replay))
"""
    said = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert said.stdout.splitlines() == 3 * ["True True"]


def test_every_name_of_the_api_is_there() -> None:
    assert all(getattr(rig, name) is not None for name in rig.__all__)
    assert set(rig.__all__) <= set(dir(rig))
    with pytest.raises(AttributeError, match="no_such_name"):
        rig.no_such_name  # noqa: B018


def test_a_motor_with_parts_is_simulated() -> None:
    parts = rig.RealMotor(0.17, 6.5, 0.48, backlash_rad=0.05)
    drive = [1.0] * 40 + [-1.0] * 40
    plain, played = (rig.simulate(motor, drive, 0.8).to_dataframe()["y_rad"] for motor in (MOTOR, parts))
    assert float(played.max()) == pytest.approx(float(plain.max()) - 0.025, abs=1e-3)
    with pytest.raises(ValueError, match="delay_s must be 0"):
        rig.simulate(parts._replace(delay_s=0.001), drive, 0.8)


@pytest.mark.parametrize("given", [3, None, {"t": [0.0]}])
def test_what_is_no_recording_is_named(given: object) -> None:
    with pytest.raises(TypeError, match="takes one run, a path, a list of them, or t, u and y"):
        rig.identify(given)  # type: ignore[call-overload]
