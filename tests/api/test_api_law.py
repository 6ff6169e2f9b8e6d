"""A new law is added by one file: run from Python and from YAML, recorded under its own stage, replayed."""

from __future__ import annotations

import json
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import rig as command
from own_laws import Spring, Stumbles

import rig
from rig.control import law
from rig.core.signals import FLAG_GUARD_CLIPPED, Sample


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The laws of own_laws.py, as a package would offer them."""
    values = {"spring": "own_laws:Spring", "stumbles": "own_laws:Stumbles", "holds": "own_laws:Holds"}
    values |= {"no-law": "own_laws:NO_LAW", "gone": "x:Y"}
    entries = [EntryPoint(name, value, law.GROUP) for name, value in values.items()]
    monkeypatch.setattr(law, "entry_points", lambda group: [e for e in entries if e.group == group])


def with_law(folder: Path, **law: object) -> Path:
    """config/quick.yaml with a section `law`."""
    config = yaml.safe_load(rig.ready("simulated").read_text(encoding="utf-8"))
    path = folder / "own.yaml"
    path.write_text(yaml.safe_dump(config | {"law": law}, sort_keys=False), encoding="utf-8")
    return path


def test_from_python(tmp_path: Path) -> None:
    run = rig.run(rig.ready("simulated"), law=Spring(), duration_s=1.5, out=tmp_path)
    assert run.failure == "" and run.stages() == ["rest", "breakaway", "law"]
    rows = run["law"]
    assert rows.t_s[-1] - rows.t_s[0] == pytest.approx(1.5) and set(rows.yd_rad) == {0.3}
    assert np.abs(rows.u_V[1:]).max() > 0.5 and rows.y_rad[-1] > 0.15
    replayed = rig.replay(run, law=Spring())
    assert replayed.is_same and replayed.compared == len(run)
    other = rig.replay(run.folder, law=Spring(to_rad=0.2))
    assert other.difference is not None and other.difference.stage == "law"
    with pytest.raises(rig.RigError, match=r"'Spring' was an object of a program.*rig\.replay\(run, law=MyLaw\(\)\)"):
        rig.replay(run)


def test_from_yaml_at_the_command_line(tmp_path: Path) -> None:
    path = with_law(tmp_path, name="spring", duration_s=1.5, options={"to_rad": -0.3})
    checked = command("check", path)
    assert checked.exit_code == 0 and "spring" in checked.stdout
    result = command("run", path, "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 0, result.output
    folder = Path(json.loads(result.stdout)["folder"])
    run = rig.read(folder)
    assert run.meta.script is not None and (run.meta.script.name, run.meta.script.law) == ("law", "spring")
    assert run["law"].y_rad[-1] < -0.15
    assert "A law of your own ran: spring" in (folder / "report.html").read_text(encoding="utf-8")
    assert command("replay", folder).exit_code == 0
    assert rig.run(path, out=tmp_path / "again")["law"].u_V.tolist() == run["law"].u_V.tolist()


@pytest.mark.parametrize(
    ("law", "why"),
    [
        (
            {"name": "sprung"},
            "law.name: no law 'sprung'; installed: gone, holds, no-law, spring, stumbles, tuned; "
            "did you mean 'spring'?",
        ),
        ({"name": "no-law"}, "law.name: law 'no-law' (own_laws:NO_LAW) has no method step(sample) that returns volts"),
        ({"name": "gone"}, "law.name: law 'gone' (x:Y) cannot be imported: ModuleNotFoundError"),
        (
            {"name": "spring", "options": {"to_rad": 0.1, "stiffness": 1.0}},
            "law.options.stiffness: law 'spring' (own_laws:Spring) takes no option 'stiffness'; it takes: to_rad, ",
        ),
        (
            {"name": "spring", "options": {"stiffness_V_rad": -1.0}},
            "law.options: law 'spring' (own_laws:Spring): stiffness_V_rad must be > 0, not -1",
        ),
        (
            {"name": "holds", "options": {}},
            "law.options: law 'holds' (own_laws:Holds): missing a required argument: 'to_rad'",
        ),
        ({"name": "spring", "duration_s": 0.0}, "law.duration_s: "),
    ],
)
def test_a_law_that_cannot_run_is_refused_with_line_and_key(tmp_path: Path, law: dict[str, object], why: str) -> None:
    path = with_law(tmp_path, **law)
    result = command("check", path)
    assert result.exit_code == 2
    place, key, *_ = result.stderr.split(": ")
    line = int(place.split(":")[-2])
    # the place is that of the value: of a section, its first line
    assert key.split(".")[-1] in "\n".join(path.read_text(encoding="utf-8").splitlines()[line - 2 : line])
    assert why in result.stderr


def test_an_exception_ends_the_run_with_the_drive_at_zero_and_its_traceback(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = rig.run(rig.ready("simulated"), law=Stumbles(), out=tmp_path)
    assert run.failure.startswith("LAW_FAILED") and "ZeroDivisionError" in run.failure
    assert "own_laws.py" in capsys.readouterr().err
    assert run.u_V[-1] == 0.0 and len(run["law"]) == 30
    assert any("own_laws.py" in str(event.detail.get("text")) for event in run.events if event.kind == "traceback")
    assert rig.replay(run, law=Stumbles()).is_same
    result = command("run", with_law(tmp_path, name="stumbles"), "--out", tmp_path)
    assert result.exit_code == 1
    assert "return 3.0 / self._left" in result.stderr and "LAW_FAILED" in result.stderr


class Pushes:
    """Asks for far more than the bench may get."""

    def step(self, sample: Sample) -> float:
        return 100.0


class Nothing:
    """Forgets to return its drive."""

    def step(self, sample: Sample) -> None:
        return None


def test_the_guard_has_the_last_word(tmp_path: Path) -> None:
    run = rig.run(rig.ready("simulated"), law=Pushes(), duration_s=1.0, out=tmp_path)
    rows = run["law"]
    assert np.abs(rows.u_V).max() <= 3.01 and (rows.flags & FLAG_GUARD_CLIPPED).any()
    assert np.abs(run.y_rad).max() < 1.95


def test_a_law_without_a_drive_or_without_a_step_is_refused(tmp_path: Path) -> None:
    assert "TypeError" in rig.run(rig.ready("simulated"), law=Nothing(), out=tmp_path).failure  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="no method step"):
        rig.run(rig.ready("simulated"), law=object(), out=tmp_path)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="duration"):
        rig.run(rig.ready("simulated"), law=Spring(), duration_s=0.0, out=tmp_path)


@pytest.mark.evidence
def test_runs_may_be_repeated_and_a_replay_needs_the_law(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = with_law(tmp_path, name="spring", duration_s=0.5)
    result = command("run", path, "--repeat", 2, "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 0, result.output
    folder = Path(json.loads(result.stdout)["runs"][1]["folder"])
    monkeypatch.setattr(law, "entry_points", lambda group: [])
    refused = command("replay", folder)
    assert refused.exit_code == 2
    assert "no law 'spring'" in refused.stderr and "install the package" in refused.stderr
