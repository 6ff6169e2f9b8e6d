"""Anything but a run or a recording, given in its place: what it is, and what to type."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from rig.cli import main
from rig.run_folder.recording.path_kind import is_run, no_recording, no_run, require_distinct

ROOT = Path(__file__).resolve().parents[2]
RUN = ROOT / "tests/golden/simulated-fault"
COMMANDS = (("identify",), ("replay",), ("report",), ("track", str(ROOT / "config/demo.yaml"), "--model"))


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder with all that is given by mistake."""
    runs = tmp_path / "my runs"
    for number, name in enumerate(("b", "a", "c"), 1):
        shutil.copytree(RUN, runs / name)
        os.utime(runs / name / "samples.csv", (1e9 * (name == "a") + number, 1e9 * (name == "a") + number))
    campaign = tmp_path / "campaign"
    campaign.mkdir()
    for name in ("results.csv", "meta.json", "config.yaml"):
        (campaign / name).write_text("{}", encoding="ascii")
    (tmp_path / "empty").mkdir()
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun/meta.json").write_text("{}", encoding="ascii")
    (tmp_path / "log.csv").write_text("t_s,u_V,y_rad\n0,1,0\n0.01,1,0\n0.02,1,0\n", encoding="ascii")
    (tmp_path / "notes.txt").write_text("hello\n", encoding="ascii")
    shutil.copyfile(ROOT / "config/demo.yaml", tmp_path / "demo.yaml")
    shutil.copyfile(ROOT / "config/campaign.yaml", tmp_path / "grid.yaml")
    return tmp_path


WORDS = {
    "my runs": ("holds 3 runs but is not a run itself", "the newest is '{}/my runs/a'"),
    "campaign": ("is the folder of a campaign", "rig campaign {}/campaign/config.yaml --resume {}/campaign"),
    "empty": ("is a folder without a run", "`rig run`"),
    "demo.yaml": ("is a config, not a recording", "`rig run {}/demo.yaml` runs it"),
    "grid.yaml": ("is the config of a campaign", "`rig campaign {}/grid.yaml` runs it"),
    "my runs/a/meta.json": ("is one file of a run", "'{}/my runs/a'"),
    "my runs/a/config.yaml": ("is one file of a run", "'{}/my runs/a'"),
    "demo.yml": ("is not there", "did you mean {}/demo.yaml?"),
    "nothing/of/it": ("is not there", "check the path"),
}
NOT_FOR_IDENTIFY = {
    "my runs/a/samples.csv": ("is one file of a run", "'{}/my runs/a'"),
    "log.csv": ("is a CSV file, not a run folder", "this takes a run of rig's; `rig identify {}/log.csv` reads it"),
    "notes.txt": ("is a file, not a run folder", "`rig run`"),
}


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
def test_every_command_says_what_it_was_given_and_what_to_type(place: Path, command: tuple[str, ...]) -> None:
    for name, (cause, cure) in (WORDS if command == ("identify",) else WORDS | NOT_FOR_IDENTIFY).items():
        result = CliRunner().invoke(main, [*command, str(place / name)])
        assert result.exit_code == 2, (name, result.output)
        said = result.stderr.splitlines()
        assert len(said) == 2, (name, said)
        assert said[0].startswith(f"rig: {place / name}: {cause}"), said
        assert cure.replace("{}", str(place)) in said[1], said


def test_a_recording_given_twice_is_refused(place: Path) -> None:
    """Its rows would count twice, and the intervals be too narrow by the square root of two."""
    once = place / "my runs/a"
    (place / "link").symlink_to(once)
    for again in (once, place / "my runs/../my runs/a", once / "samples.csv", place / "link"):
        result = CliRunner().invoke(main, ["identify", str(once), str(again)])
        assert result.exit_code == 2
        cause, cure = result.stderr.splitlines()
        assert cause == f"rig: {again}: is given twice: the same rows would count twice"
        assert cure.strip() == "name it once"
    require_distinct([once, place / "my runs/b", place / "log.csv"])


def test_a_run_that_has_only_begun_has_a_report_and_nothing_else(place: Path) -> None:
    assert is_run(place / "begun")
    assert no_run(place / "begun").cause == "has no samples.csv: nothing was recorded in this run"
    assert CliRunner().invoke(main, ["replay", str(place / "begun")]).exit_code == 2


def test_what_can_be_read_is_left_to_the_reader(place: Path) -> None:
    for name in ("log.csv", "notes.txt", "my runs/a", "my runs/a/samples.csv"):
        assert no_recording(place / name) is None


def test_a_path_that_no_file_can_have_is_refused_in_words(tmp_path: Path) -> None:
    for command in ("identify", "replay", "report"):
        result = CliRunner().invoke(main, [command, str(tmp_path / ("x" * 300))])
        assert (result.exit_code, len(result.stderr.splitlines())) == (2, 2), result.output
