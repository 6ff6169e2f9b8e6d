"""A record that was changed by hand: the replay names the first row that does not follow from the samples before it."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from evidence import evidence
from run_copy import GOLDEN, RunCopy

from rig import config
from rig.control.loop.recorded import RecordedDriver
from rig.control.loop.replayed_rows import ReplayedRows
from rig.control.loop.stop_request import StopRequest
from rig.core.calibration import DriveMap
from rig.core.faults import Fault
from rig.core.signals import FLAG_GUARD_BRAKED, FLAG_SATURATED, FLAG_SKIPPED
from rig.run_folder.recording.reader import read_run
from rig.run_folder.results.event import Decided
from rig.running.preflight.room_to_stop import guard_settings_of
from rig.running.replay import _advice, replay

RELAYS = {"simulated": "relay-2", "host-board": "relay-1", "chip": "relay-1", "modbus": "relay-1"}


def copy_of(name: str, tmp_path: Path) -> RunCopy:
    return RunCopy(GOLDEN / name, tmp_path / name)


def unit_V(run: RunCopy) -> float:
    return 12.0 / int(run.meta["drive_units"])


def test_each_sample_tells_the_drive_of_the_row_before_it_from_the_second_row_on() -> None:
    recording = read_run(GOLDEN / "simulated-jog")
    rows = recording.rows()
    replayed = ReplayedRows(recording, 0.01, None, True, StopRequest())
    driver = RecordedDriver(replayed, "sample_first", DriveMap(12.0), 1.0, None)
    assert math.isnan(driver.read().t_u_s)
    for replayed.next in (1, 2, len(rows) - 1):
        sample, before = driver.read(), rows[replayed.next - 1]
        assert sample.y_counts == rows[replayed.next].y_counts
        assert (sample.t_u_s, sample.u_V) == (before.t_u_s, before.u_V)


def test_a_guards_fault_must_come_again_unless_the_last_drive_had_gone_out_and_no_reading_followed(
    tmp_path: Path,
) -> None:
    run = copy_of("simulated-jog", tmp_path)
    fault = Fault("SENSOR_STUCK", "")
    for told, must in ((run.rows[-1]["t_u_s"], True), ("", False)):
        run.rows[-1] |= {"t_u_s": told, "u_V": "1.0"}
        rows = ReplayedRows(read_run(run.write()), 0.01, fault, True, StopRequest())
        assert rows.must_come_again is must


def test_a_drive_that_is_a_unit_off_is_named_wherever_it_is(tmp_path: Path) -> None:
    run = copy_of("simulated-jog", tmp_path)
    for k in range(0, len(run.rows), 6):
        row = run.rows[k]
        found = run.changed(partial(row.update, u_V=repr(float(row["u_V"]) + unit_V(run))), k).difference
        assert found is not None and found.tick == run.tick(k) and found.line == k + 2
        assert found.by == ("guard" if int(row["flags"]) else "law")
        assert found.recorded_V is not None
        assert found.replayed_V == pytest.approx(found.recorded_V - unit_V(run))


def test_a_drive_without_steps_may_differ_by_less_than_a_microvolt(tmp_path: Path) -> None:
    run = copy_of("simulated-jog", tmp_path)
    run.meta["drive_units"] = None
    for row in run.rows:
        if float(row["u_V"]) != 0.0:
            row.update(u_V=repr(run.meta["script"]["u_V"]))
    k = run.number_of("jog", 3)
    row = run.rows[k]
    for by_V, is_same in ((1e-3, False), (1e-9, True)):
        done = run.changed(partial(row.update, u_V=repr(float(row["u_V"]) + by_V)), k)
        assert (done.difference is None) == is_same


def test_a_missing_row_is_named_wherever_it_was(tmp_path: Path) -> None:
    run = copy_of("simulated-jog", tmp_path)
    for k in range(1, len(run.rows) - 1, 6):
        found = run.without(k).difference
        assert found is not None and found.tick == run.tick(k + 1) and found.by == "record"
        assert found.replayed == "rows are missing before it"
    found = run.without(len(run.rows) - 1).difference
    assert found is not None and found.line is None and found.recorded == "the recording ends here, the run did not"


@pytest.mark.parametrize("name", ["chip", "modbus", *evidence("host-board", "simulated")])
def test_one_unit_in_any_stage(name: str, tmp_path: Path) -> None:
    run = copy_of(name, tmp_path)
    tracked = next(row["stage"] for row in run.rows if row["stage"].startswith("track:"))
    for stage, nth in (("breakaway", 100), (RELAYS[name], 0), (RELAYS[name], -1), (tracked, 57)):
        k = run.number_of(stage, nth)
        row = run.rows[k]
        done = run.changed(partial(row.update, u_V=repr(float(row["u_V"]) - unit_V(run))), k)
        assert done.difference is not None and done.replayed == k
        assert (done.difference.tick, done.difference.stage) == (run.tick(k), stage)
        assert str(done.difference).startswith(f"tick {run.tick(k)}, t = ")


def test_a_tick_of_the_relay_in_the_device(tmp_path: Path) -> None:
    run = copy_of("chip-relay-in-device", tmp_path)
    k = run.number_of("relay-1", 1500)
    row = run.rows[k]
    found = run.changed(lambda: row.update(u_V=repr(-float(row["u_V"]))), k).difference
    assert found is not None and found.line == k + 2 and found.by == "law"
    assert found.replayed.startswith("DEVICE_RELAY") and found.asked_V == pytest.approx(float(run.rows[k]["u_V"]))
    found = run.without(k).difference
    assert found is not None and found.line == k + 2 and found.by == "record"
    assert found.recorded == "no ticks were skipped before this row"


def test_a_tick_of_the_loop_amid_those_of_the_relay_in_the_device(tmp_path: Path) -> None:
    run = copy_of("chip-relay-in-device", tmp_path)
    k = run.number_of("relay-1", 1500)
    found = run.changed(lambda: run.rows[k].update(late_us="10", io_us="900"), k).difference
    assert found is not None and found.line == k + 2


def test_a_relay_in_the_device_that_ended_its_run(tmp_path: Path) -> None:
    """By deciding otherwise than the law, which must come out again; or by a link that lost its blocks."""
    run = copy_of("chip-relay-in-device", tmp_path)
    k = run.number_of("relay-1", 1500)
    del run.rows[k + 1 :]
    right_V, wrong_V = run.rows[k]["u_V"], repr(-float(run.rows[k]["u_V"]))
    t_s = float(run.rows[k]["t_s"])
    run.events = [e for e in run.events if e["t_s"] <= t_s]
    fault = {"t_s": t_s, "kind": "fault", "code": "DEVICE_RELAY", "detail": ""}
    run.events += [fault, {"t_s": t_s, "kind": "end"}]
    run.rows[k]["u_V"] = wrong_V
    assert run.replay().is_same
    run.rows[k]["u_V"] = right_V
    found = run.replay().difference
    assert found is not None and found.line == k + 2 and "DEVICE_RELAY" in found.recorded

    fault["code"] = "LINK_GAP"
    done = run.replay()
    assert done.is_same and done.fault is not None and done.fault.code == "LINK_GAP"
    run.rows[k]["u_V"] = wrong_V
    found = run.replay().difference
    assert found is not None and found.line == k + 2 and "LINK_GAP" in found.recorded

    # what came before the device had stopped, too, is in the record: nobody decided on it
    run.rows[k]["u_V"] = right_V
    later = {name: repr(float(run.rows[k][name]) + 0.001) for name in ("t_s", "t_u_s")}
    run.rows.append(run.rows[k] | later | {"stage": "stopping", "z_rad_s": "", "u_V": "0.0"})
    assert run.replay().is_same
    fault["code"] = "DEVICE_RELAY"
    run.rows[k]["u_V"] = wrong_V
    assert run.replay().is_same


def test_a_sample_at_which_the_guard_would_have_braked(tmp_path: Path) -> None:
    """Within limits that leave the run just enough room, one reading 0.06 rad farther out where it needs most."""
    run = copy_of("simulated", tmp_path)
    e = config.load(run.folder / "config.yaml")
    settings = guard_settings_of(e)
    t_s = np.array([float(row["t_s"]) for row in run.rows])
    y_rad = np.array([float(row["y_rad"]) for row in run.rows])
    stop_rad = np.full(len(run.rows), np.nan)
    for k in range(4, len(run.rows)):
        velocity = np.polyfit(t_s[k - 4 : k + 1], y_rad[k - 4 : k + 1], 1)[0]
        stop_rad[k] = y_rad[k] + velocity * (settings.reaction_s + settings.coast_tau_s)
    k = int(np.nanargmax(stop_rad))
    room_rad = max(stop_rad[k], -np.nanmin(stop_rad)) + 0.05
    limits = e.limits.model_copy(update={"hard_rad": (-room_rad, room_rad)})
    narrower = config.dump(e.model_copy(update={"limits": limits}))
    (run.folder / "config.yaml").write_text(narrower, encoding="utf-8")
    assert run.replay().is_same

    row = run.rows[k]
    found = run.changed(lambda: row.update(y_rad=repr(float(y_rad[k]) + 0.06)), k).difference
    assert found is not None and found.line == k + 2 and found.by == "guard"
    assert (found.recorded, found.replayed) == ("the guard let the law's drive out", "the guard braked")
    assert found.recorded_V == float(run.rows[k]["u_V"])


def test_a_sample_that_the_guard_would_not_have_believed(tmp_path: Path) -> None:
    run = copy_of("host-board", tmp_path)
    k = run.number_of("relay-1", 200)
    row = run.rows[k]
    found = run.changed(lambda: row.update(y_rad=repr(float(row["y_rad"]) + 0.5)), k).difference
    assert found is not None and found.line == k + 2 and found.by == "guard"
    assert found.replayed.startswith("SENSOR_JUMP")


def test_a_guard_that_is_said_to_have_braked(tmp_path: Path) -> None:
    run = copy_of("chip", tmp_path)
    k = run.number_of("relay-1", 100)
    found = run.changed(lambda: run.rows[k].update(flags=str(FLAG_GUARD_BRAKED)), k).difference
    assert found is not None and found.tick == run.tick(k) and found.by == "guard"


def test_ticks_that_are_said_to_have_been_skipped(tmp_path: Path) -> None:
    run = copy_of("chip", tmp_path)
    k = run.number_of("relay-1", 100)
    found = run.changed(lambda: run.rows[k].update(flags=str(FLAG_SKIPPED)), k).difference
    assert found is not None and found.tick == run.tick(k) and found.by == "record"


def test_the_integral_and_the_reference_are_held_to_the_record_too(tmp_path: Path) -> None:
    run = copy_of("modbus", tmp_path)
    tracked = next(row["stage"] for row in run.rows if row["stage"].startswith("track:"))
    for stage, column in (("relay-1", "z_rad_s"), (tracked, "yd_rad")):
        k = run.number_of(stage, 30)
        row = run.rows[k]
        found = run.changed(partial(row.update, {column: repr(float(row[column]) + 1e-6)}), k).difference
        assert found is not None and found.tick == run.tick(k) and found.by == "law"


def test_another_model_or_another_gain_shows_in_the_first_drive_that_it_changes(tmp_path: Path) -> None:
    run = copy_of("chip", tmp_path)
    model = next(event for event in run.events if event["kind"] == "model")
    model["tau_s"] *= 1.2
    found = run.replay().difference
    assert found is not None and found.stage == "track:triple-relay" and found.by == "law"
    assert found.tick <= run.tick(run.number_of("track:triple-relay", 20))

    settings = yaml.safe_load((run.folder / "config.yaml").read_text(encoding="utf-8"))
    settings["relay"]["gains"][0]["h1_V"] += unit_V(run)
    (run.folder / "config.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    found = run.replay().difference
    assert found is not None and found.line == run.number_of("relay-1") + 2


def test_the_fault_at_the_end_comes_out_again_or_is_missed(tmp_path: Path) -> None:
    run = copy_of("simulated-fault", tmp_path)
    done = run.replay()
    assert done.is_same and done.ending == "a fault" and done.fault is not None and done.fault.code == "OVERSPEED"

    last = len(run.rows) - 1
    still = run.rows[last - 1]["y_rad"]
    found = run.changed(lambda: run.rows[last].update(y_rad=still), last).difference
    assert found is not None and found.line == last + 2 and found.recorded_V == 0.0

    found = run.without(last).difference
    assert found is not None and "OVERSPEED" in found.recorded and found.replayed == "no fault"

    next(event for event in run.events if event["kind"] == "fault")["code"] = "SENSOR_RAIL"
    found = run.replay().difference
    assert found is not None and found.line == last + 2 and found.by == "guard"
    assert "SENSOR_RAIL" in found.recorded and found.replayed.startswith("OVERSPEED")


def test_a_drive_that_was_lost_on_the_way_has_nothing_to_be_compared_with(tmp_path: Path) -> None:
    run = copy_of("chip", tmp_path)
    k = run.number_of("relay-1", 100)
    before, row = run.rows[k - 1], run.rows[k]
    done = run.changed(lambda: row.update(t_u_s=before["t_u_s"], u_V=before["u_V"]), k)
    assert done.is_same and done.lost == 1 and done.compared == done.rows - 1


def test_a_drive_that_the_device_cut_short_likewise(tmp_path: Path) -> None:
    run = copy_of("chip", tmp_path)
    k = run.number_of("relay-1", 100)
    row = run.rows[k]
    done = run.changed(lambda: row.update(flags=str(FLAG_SATURATED), u_V=repr(0.5 * float(row["u_V"]))), k)
    assert done.is_same and done.limited == 1 and done.compared == done.rows - 1


def test_a_killed_run_is_replayed_to_its_last_row(tmp_path: Path) -> None:
    run = copy_of("simulated", tmp_path)
    k = run.number_of("search", 700)
    del run.rows[k:]
    run.rows[-1]["t_u_s"] = ""  # the device had not told of it yet
    run.events = [e for e in run.events if e["t_s"] < 4.0] + [{"t_s": float(run.rows[-1]["t_s"]), "kind": "loop_died"}]
    done = run.replay()
    assert done.is_same and done.ending == "no end" and done.replayed == done.rows == k


def test_a_torn_last_line_is_left_out_and_said(tmp_path: Path) -> None:
    run = copy_of("chip", tmp_path)
    samples = run.write() / "samples.csv"
    text = samples.read_text(encoding="ascii")
    samples.write_text(text[: text.rindex("\n", 0, -1) + 12], encoding="ascii")
    done = replay(run.folder)
    assert done.is_same and done.ending == "no end" and done.rows == len(run.rows) - 1
    assert len(done.notes) == 1 and "torn" in done.notes[0]


def test_a_rest_that_the_advisers_asked_for_is_replayed_as_their_advice() -> None:
    decided = Decided.model_validate({"row": 7, "by": "advice", "what": "rest", "why": "noise", "rest_s": 2.0})
    advice = _advice(decided, ())
    assert advice.rest_s == 2.0 and advice.stop is None and advice.design is None
    with pytest.raises(ValueError, match="rest"):  # an event that lacks the number
        _advice(decided.model_copy(update={"rest_s": None}), ())
