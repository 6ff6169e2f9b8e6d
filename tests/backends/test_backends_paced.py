"""Virtual time that follows the clock: never ahead of it, standing where the machine stands, without a burst."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import rig
from evidence import evidence
from hypothesis import given
from hypothesis import strategies as st

from rig.backends.clock import STALL_S, PacedClock, VirtualClock

ROOT = Path(__file__).resolve().parents[2]
STEP_S = 0.01


class Wall:
    """The machine's clock, of which each sleep may end late, or early by a signal."""

    def __init__(self) -> None:
        self.t_s = 1000.0
        self.late_s = 0.0  # of the next sleep
        self.signal_after_s: float | None = None  # into the next sleep
        self.sleeps = 0

    def now_s(self) -> float:
        return self.t_s

    def sleep_until(self, t_s: float) -> float:
        if self.signal_after_s is not None:
            self.t_s, self.signal_after_s = min(t_s, self.t_s + self.signal_after_s), None
        else:
            self.t_s, self.late_s = max(t_s, self.t_s) + self.late_s, 0.0
            self.sleeps += 1
        return self.t_s


@given(
    pace=st.sampled_from([0.2, 1.0, 7.0]),
    ticks=st.lists(st.tuples(st.floats(0.0, 1.0), st.sampled_from([0.0, 0.004, 0.019, 0.05, 3.0])), max_size=60),
)
def test_it_never_runs_ahead_and_never_catches_up_by_a_burst(pace: float, ticks: list[tuple[float, float]]) -> None:
    """Each tick takes a share of its step for sums of the host, or a sleep ends late."""
    wall, inner = Wall(), VirtualClock()
    clock = PacedClock(inner, pace, wall)
    began_s = before_s = wall.t_s
    long: list[float] = []
    for number, (share, late_s) in enumerate(ticks, 1):
        wall.t_s += share * STEP_S / pace
        wall.late_s, sleeps = late_s, wall.sleeps
        assert clock.sleep_until(number * STEP_S) == inner.now_s() == number * STEP_S
        assert clock.now_s() * (1 - 1e-9) <= pace * (wall.t_s - began_s)
        assert wall.t_s - before_s >= STEP_S / pace - STALL_S - 1e-9
        before_s = wall.t_s
        long += [late_s] if late_s > STALL_S and wall.sleeps > sleeps else []
    assert clock.stalls >= len(long)
    assert clock.longest_stall_s >= max(long, default=0.0) - 1e-9


def test_what_takes_the_host_long_is_a_stall_and_is_not_made_up_for() -> None:
    wall = Wall()
    clock = PacedClock(VirtualClock(), 1.0, wall)
    clock.sleep_until(STEP_S)
    wall.t_s += 5.0
    assert clock.now_s() == STEP_S, "nothing passed meanwhile"
    clock.sleep_until(2 * STEP_S)
    assert wall.t_s == pytest.approx(1005.0 + 2 * STEP_S)
    assert clock.stalls == 1 and clock.longest_stall_s == pytest.approx(5.0)


def test_a_device_that_ran_on_by_itself_is_waited_for_before_its_time_is_told() -> None:
    """As where a reply takes time: the driver's reading has let it pass."""
    wall, inner = Wall(), VirtualClock()
    clock = PacedClock(inner, 1.0, wall)
    inner.sleep_until(0.3)
    assert clock.now_s() == 0.3 and wall.t_s == pytest.approx(1000.3)


def test_a_signal_ends_a_sleep_before_its_time_has_passed() -> None:
    """Its handler may ask for a stop; the device is then where the loop was."""
    wall = Wall()
    clock = PacedClock(VirtualClock(), 1e-3, wall)
    wall.signal_after_s = 2.0
    assert clock.sleep_until(STEP_S) == 0.0 and wall.t_s == 1002.0
    assert clock.sleep_until(STEP_S) == STEP_S and wall.t_s == pytest.approx(1010.0)


@pytest.mark.parametrize(("name", "pace"), [("modbus-tcp", 20.0), ("simulated", 7.0), *evidence(("demo", 3.0))])
def test_a_paced_run_records_the_same_and_says_how_it_was_paced(tmp_path: Path, name: str, pace: float) -> None:
    rows, times, notes = list[bytes](), list[dict[str, Any]](), list[list[str]]()
    for options in ((), ("--pace", pace)):
        out = tmp_path / str(len(rows))
        done = rig("jog", ROOT / f"config/{name}.yaml", "--u-V", 0.6, "--out", out, *options)
        assert done.exit_code == 0, done.output
        (folder,) = out.iterdir()
        outcome = json.loads((folder / "result.json").read_text())
        rows.append((folder / "samples.csv").read_bytes())
        times.append(json.loads((folder / "meta.json").read_text())["time"])
        notes.append([note for note in outcome["notes"] if "pace" in note])
        last_meta, last_result = ((folder / f"{file}.json").stat().st_mtime_ns for file in ("meta", "result"))
        assert last_meta <= last_result  # a folder with a result is whole, whatever ends rig in between
    assert rows[0] == rows[1]
    assert times[0] == {"kind": "virtual"} and notes[0] == []
    assert (times[1]["kind"], times[1]["pace"]) == ("virtual", pace)
    assert (times[1]["longest_stall_s"] > STALL_S) == (times[1]["stalls"] > 0)
    (note,) = notes[1]
    assert note.startswith(f"virtual time at pace {pace:g}: ")
    assert f"\ntime: {note}\nrun: " in done.stdout
    assert note in (folder / "report.html").read_text(encoding="utf-8")
    assert ("without a stall" in note) == (times[1]["stalls"] == 0)


@pytest.mark.parametrize("pace", ["0", "1e-9", "-1", "nan", "inf"])
def test_a_pace_that_is_none_is_refused(tmp_path: Path, pace: str) -> None:
    done = rig("jog", ROOT / "config/demo.yaml", "--u-V", 0.6, "--out", tmp_path, "--pace", pace)
    assert done.exit_code == 2 and "--pace" in done.stderr and not list(tmp_path.iterdir())


def test_real_time_has_the_pace_1_and_no_other(tmp_path: Path) -> None:
    config = tmp_path / "bench.yaml"
    text = (ROOT / "config/demo.yaml").read_text(encoding="utf-8")
    config.write_text(text.replace("port: emulated ", "port: emulated-realtime "), encoding="utf-8")
    refused = rig("jog", config, "--u-V", 0.1, "--out", tmp_path / "runs", "--pace", 2)
    assert refused.exit_code == 2 and "loop.pace" in refused.stderr and "whose pace is 1" in refused.stderr
    assert not (tmp_path / "runs").exists()
    done = rig("jog", config, "--u-V", 0.1, "--seconds", 0.05, "--out", tmp_path / "runs", "--pace", 1, "--json")
    folder = Path(json.loads(done.stdout)["folder"])
    assert json.loads((folder / "meta.json").read_text())["time"] == {"kind": "real"}
