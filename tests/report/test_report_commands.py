"""Every command that a report names is run here as it stands there."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from html import unescape
from pathlib import Path

import pytest
import yaml
from command_line import rig

from rig.output.report import write_report

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """Gains of two amplitudes, few cycles, one short tracking check; in a folder whose name a shell takes apart."""
    changed = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    changed["relay"] = {"gains": [{"h1_V": 0.42, "h2_V": 0.85}, {"h1_V": 0.3, "h2_V": 0.76}], "cycles": 8}
    changed["tracking"] |= {"duration_s": 2.0, "methods": ["sampled-data"]}
    (tmp_path / "my bench").mkdir()
    path = tmp_path / "my bench" / "quick.yaml"
    path.write_text(yaml.safe_dump(changed), encoding="utf-8")
    return path


def folder_of(*arguments: object) -> Path:
    """The run folder that this command makes."""
    done = rig(*arguments, "--json")
    return Path(json.loads(done.stdout)["folder"])


def named(folder: Path) -> list[list[str]]:
    """The commands in a run's report, as a shell would take them."""
    page = (folder / "report.html").read_text(encoding="utf-8")
    head = page[page.index("<body>") : page.index('id="estimates"')]
    codes = [unescape(code) for code in re.findall(r"<code[^>]*>(.*?)</code>", head)]
    return [shlex.split(code) for code in codes if code.startswith("rig ")]


@pytest.mark.evidence
@pytest.mark.usefixtures("plain_motor")
def test_what_to_do_next_can_be_typed(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a relay test: track; after the tracking: nothing; after a jog, and a run that was killed: run."""
    monkeypatch.chdir(config.parent)  # where runs are made
    identified = folder_of("relay", config)
    (track,) = named(identified)
    assert track[:2] == ["rig", "track"]
    tracked = folder_of(*track[1:])
    result = json.loads((tracked / "result.json").read_text())
    assert "rms_rad" in result["tracking"]["sampled-data"]
    assert named(tracked) == []

    jogged = folder_of("jog", config, "--u-V", 0.8)
    ((*again,),) = named(jogged)
    assert again == ["rig", "run", str(jogged / "config.yaml")]

    killed = Path(shutil.copytree(jogged, config.parent / "killed"))
    (killed / "result.json").unlink()
    (killed / "meta.json").unlink()
    write_report(killed)
    ((*once_more,),) = named(killed)
    assert once_more == ["rig", "run", str(killed / "config.yaml")]
    assert rig(*once_more[1:]).exit_code == 0


@pytest.mark.usefixtures("plain_motor")
def test_no_command_is_named_where_none_would_help(config: Path, tmp_path: Path) -> None:
    """A fault that is not cured, and a config without the section that a command needs."""
    changed = yaml.safe_load(config.read_text(encoding="utf-8"))
    without = tmp_path / "without.yaml"
    without.write_text(yaml.safe_dump({k: v for k, v in changed.items() if k != "tracking"}), encoding="utf-8")
    assert named(folder_of("relay", without, "--out", tmp_path / "runs")) == []
    changed["emulated"]["wiring"] = {"drive": "reversed"}
    config.write_text(yaml.safe_dump(changed), encoding="utf-8")
    faulty = folder_of("run", config, "--out", tmp_path / "faulty")
    assert named(faulty) == []
    page = (faulty / "report.html").read_text(encoding="utf-8")
    assert "Fault POLARITY" in page
    assert "Why" not in page[page.index("<body>") : page.index('id="estimates"')]
