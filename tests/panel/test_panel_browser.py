"""The page in a browser, against the panel's server: what a user sees and does.

The run is in virtual time, so that it comes to an estimate on a busy machine too. The jogs are on an emulated board.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from compared_runs import Told, write_run, write_samples
from processes import PATIENCE_S, plain_runs

from rig.config import load
from rig.config.yaml12 import parse
from rig.run_folder.live.running import running
from rig.run_folder.live.stop_flag import request_stop

pytestmark = [pytest.mark.realtime, pytest.mark.long]

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PERIOD_S = 0.01
LEASE_TICKS = round(0.15 / PERIOD_S)
PASSWORD = "correct horse battery"
NOT_CONNECTED = "Not connected: use the e-stop"


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """What the page showed, step by step, from opening it to the death of the panel's process."""
    folder = tmp_path_factory.mktemp("browser")
    runs = folder / "runs"
    config = folder / "bench.yaml"
    simulated = (ROOT / "config" / "quick.yaml").read_text(encoding="utf-8")
    # so much is asked for that the run goes on until it is stopped
    config.write_text(simulated.replace("interval_percent: 0.4", "interval_percent: 0.1"), encoding="utf-8")
    wrong = folder / "wrong.yaml"  # a bench that is not as the config says
    truth = "  potentiometer:\n    rad_per_count: 0.0043\n    centre_counts: 500\n"
    elsewhere = simulated.replace("  potentiometer:\n", truth, 1)
    wrong.write_text(re.sub(r"(?m)^emulated:.*\n", "emulated:\n  reversed: true\n", elsewhere), encoding="utf-8")
    # past runs to lay over the one that is started here
    shutil.copytree(ROOT / "tests" / "golden" / "host-board", runs / "20260101T000000Z-run-before")
    for day, motor in ((2, Told()), (3, Told(fc_V=0.5))):
        write_samples(write_run(runs / f"2026010{day}T000000Z-run-known", motor), seed=day)
    secret = folder / "password"
    secret.write_text(PASSWORD + "\n")
    secret.chmod(0o600)
    with (
        served(config, runs) as (panel, url),
        served(config, folder / "shared", "--password-file", secret) as (_, shared_url),
    ):
        asked = {
            "url": url, "panel_pid": panel.pid, "runs": str(runs), "config": str(config),
            "calibrate_config": str(wrong), "jog_config": str(ROOT / "config" / "demo.yaml"),
            "shared_url": shared_url, "password": PASSWORD, "shots": os.environ.get("RIG_SHOTS"),
            "patience_ms": 1e3 * PATIENCE_S,
        }  # fmt: skip
        told = subprocess.run(
            ["node", str(HERE / "browser" / "page.mjs"), json.dumps(asked)], stdout=subprocess.PIPE, check=True
        )
        yield json.loads(told.stdout)


@contextmanager
def served(config: Path, runs: Path, *more: object) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A panel as a process, and its address; what still runs at its end is stopped."""
    panel = subprocess.Popen(
        [sys.executable, "-m", "rig", "panel", str(config), "--out", str(runs), "--port", "0", *map(str, more)],
        stdout=subprocess.PIPE, text=True, start_new_session=True,
        env=plain_runs(config.parent, "rig jog", "rig.panel.calibrating"),  # the run's own report is opened
    )  # fmt: skip
    assert panel.stdout is not None
    try:
        found = re.search(r"http://\S+", panel.stdout.readline())
        assert found is not None
        yield panel, found[0]
    finally:
        panel.kill()
        panel.wait(PATIENCE_S)
        panel.stdout.close()
        for run in running(runs):
            request_stop(run.folder, by="the test")


def test_the_page_works_from_the_first_look_to_the_panels_death(seen: dict[str, Any]) -> None:
    assert "failed" not in seen, f"{seen['failed']}\n{seen['page']}"
    unreachable = ("net::ERR_", "WebSocket connection to")
    assert not [words for words in seen["complaints"] if not any(one in words for one in unreachable)]


def test_a_start_shows_what_will_happen_and_leaves_stop_in_reach(seen: dict[str, Any]) -> None:
    sheet = seen["sheet"]
    assert "token" not in sheet["address"]
    for words in ("Largest drive, V3.00", "Distance to stop, rad1.76", "Soft limits, rad−1.10 … 1.10", "−1.95 … 1.95"):
        assert words in sheet["plan"]
    assert sheet["lines"] > 5
    assert sheet["on_top_at_stop"] == "stop"


def test_a_run_is_live_and_nothing_jumps(seen: dict[str, Any]) -> None:
    live = seen["live"]
    assert live["moved"]
    assert "±" in live["estimate"]
    assert live["shifted"] == []
    assert live["live_regions"] == [None, None, "stage", "faults", "silence"], "numbers are not read aloud"


def test_without_token_and_uplot_a_narrow_page_still_shows_numbers_and_stop(seen: dict[str, Any]) -> None:
    watcher = seen["watcher"]
    assert "You watch. Stop works." in watcher["note"]
    assert (watcher["start"], watcher["stop"], watcher["too_wide_px"]) == (False, True, 0)


def test_stop_is_one_key_anywhere_but_in_text(seen: dict[str, Any]) -> None:
    stopped = seen["stopped"]
    assert stopped["zoomed"] == "false", "space pressed no button but Stop"
    assert stopped["state"] == "Stopped: the drive is at 0."
    assert "Do: start it again" in stopped["fault"]
    assert stopped["stops"] == 1
    assert seen["typed"]["stops"] == 0, "a space in a text is a space"
    assert seen["typed"]["stops_with_escape"] > 0, "Esc is Stop everywhere"


def test_past_runs_are_laid_over_each_other_and_reports_opened(seen: dict[str, Any]) -> None:
    assert "20260101T000000Z-run-before" in seen["overlay"]["table"]
    compared = seen["overlay"]["compared"]
    assert "Do they differ by more than their noise explains? Yes" in compared
    assert "Left out: 20260101T000000Z-run-before" in compared
    assert seen["report"]["title"].endswith("run-quick")
    assert (seen["report"]["sandbox"], seen["report"]["stop"]) == ("", True)


def test_a_bench_is_calibrated_by_keyboard_alone(seen: dict[str, Any]) -> None:
    wiring, done = seen["wiring"], seen["calibrated"]
    title = "swap these two wires at one end, with the motor's supply off"
    assert wiring == {"title": title, "wires": 4, "caption": title, "code": "0.5 rad"}
    assert "'4,5' is no angle" in done["said"]
    config = load(parse(done["config"], "config").data)
    assert config.drive.reversed
    assert config.sensor.straight[0] == pytest.approx(0.0043, rel=0.01)
    assert done["kept"]
    assert done["focus"] == "calibrate-end", "the next Tab goes on from there"
    in_sight = {"stop_below_bar": True, "question": True}
    assert seen["in_sight"] == {"1280": in_sight, "360": in_sight}


def test_whatever_a_screen_reader_finds_has_a_name(seen: dict[str, Any]) -> None:
    assert seen["unnamed"] == []
    heard = seen["heard"]
    assert set(heard) == {"bench", "sheet", "runs", "report", "wiring"}
    for view in heard.values():
        assert any(name.startswith("button Stop") for name in view)
    assert "dialog Before the motor moves" in heard["sheet"]
    assert "slider Drive" in " ".join(heard["bench"])
    assert any(
        name.endswith("swap these two wires at one end, with the motor's supply off") for name in heard["wiring"]
    )


def test_another_operator_takes_the_bench_and_the_first_one_watches(seen: dict[str, Any]) -> None:
    taken = seen["taken"]
    assert (taken["before"], taken["after"]) == ([True, False], [False, True])
    assert taken["words"] == taken["told"] == "Another page has the bench. You watch. Stop works."
    assert taken["stop"]


@pytest.mark.parametrize("loss", ["cut", "closed", "killed"])
def test_a_jog_ends_with_its_lease_however_the_page_loses_the_bench(seen: dict[str, Any], loss: str) -> None:
    lost = seen[loss]
    # rows until the loss was seen, the lease, and what a busy machine adds; a lease that never ended would be endless
    assert lost["driven_ticks"] <= 10 * LEASE_TICKS
    if loss != "closed":
        assert lost["words"] == NOT_CONNECTED
    if loss == "cut":
        assert lost["held"] == 0
        assert "Stop cannot work" in lost["stop"]
    if loss == "killed":
        assert lost["stop"] == "Stop did not get through. Use the e-stop."
