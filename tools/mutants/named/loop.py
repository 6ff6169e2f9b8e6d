"""Defects of the loop and of what stands between config and bench."""

from __future__ import annotations

from mutants.named.writing import in_file, of


def _runner(*names: str) -> tuple[str, ...]:
    return in_file("tests/loop/test_loop_runner.py", *names)


def _pause(*names: str) -> tuple[str, ...]:
    return in_file("tests/loop/test_loop_pause_watch.py", *names)


def _preflight(*names: str) -> tuple[str, ...]:
    return in_file("tests/preflight/test_preflight_rules.py", *names)


def _breakaway(*names: str) -> tuple[str, ...]:
    return in_file("tests/control/test_control_breakaway.py", *names)


def _several(*names: str) -> tuple[str, ...]:
    return in_file("tests/experiment/test_experiment_pause.py", *names)


def _in_device(*names: str) -> tuple[str, ...]:
    return in_file("tests/hil/test_hil_device_relay.py", *names)


RUNNER = of(
    "rig/loop/runner.py",
    (
        "safe_stop is not sent",
        "Loop._stop_confirmed",
        "stopped = self._driver.safe_stop()",
        "stopped = True",
        _runner("test_any_exception_of_a_law_ends_in_a_safe_stop"),
    ),
    (
        "a stop that is not confirmed is no fault",
        "Loop.armed",
        "if not stopped:",
        "if False:",
        in_file("tests/experiment/test_experiment_ends.py", "test_an_unconfirmed_stop_is_a_fault"),
    ),
    (
        "the law's drive goes out, not the guard's",
        "Loop._run_tick",
        "u_V, flags = self.guard.allow(sample, law.step(sample))",
        "u_V = law.step(sample)\n            _, flags = self.guard.allow(sample, u_V)",
        in_file("tests/hil/test_hil_loop.py", "test_full_drive_from_anywhere_inside_the_hard_limits_stays_inside_them"),
    ),
    (
        "the reading that ended the run is not recorded",
        "Loop._run_tick",
        "            self._record_tick(law, stage, sample, 0.0, late_us, io_us, 0)\n",
        "",
        _runner("test_the_reading_that_ended_the_run_is_the_records_last_row"),
    ),
    (
        "the last row never learns what its drive did",
        "Loop.armed",
        "            self._finish_row()\n",
        "",
        _runner("test_a_row_holds_the_drive_that_acts_from_its_effect_time_on"),
    ),
    (
        "signals are not looked at",
        "Loop._await_tick",
        "        self.check_stop()\n",
        "",
        _runner("test_signals_end_in_a_safe_stop_and_handlers_come_back"),
    ),
    (
        "a reading that goes back in time is recorded",
        "Loop._run_tick",
        "if sample.t_s < self._newest_t_s:",
        "if False:",
        _runner("test_a_clock_that_goes_back_is_a_reset"),
    ),
    (
        "the pause begins without its watcher",
        "Loop.armed",
        "        self.pause_watch.begin()\n",
        "",
        _pause("test_a_pause_begins_where_a_block_that_is_armed_has_ended"),
    ),
    (
        "late ticks are caught up",
        "Loop._end_tick",
        "self._tick += 1 + self._skipped",
        "self._tick += 1",
        _runner("test_ticks_lie_on_the_grid_and_late_ones_are_skipped_and_counted_never_caught_up"),
    ),
    (
        "a dead recorder is not noticed",
        "Loop._end_tick",
        "            self._record.check()\n",
        "            pass\n",
        _runner("test_a_dead_recorder_ends_the_run"),
    ),
    (
        "the guard keeps what it saw before a pause",
        "Loop.armed",
        "            self.guard.rearm()\n",
        "",
        _runner("test_a_stand_before_a_pause_is_none_after_it"),
    ),
    (
        "a drive that was clipped is not flagged",
        "Loop._complete_row",
        "FLAG_SATURATED if clipped else 0",
        "0",
        _runner("test_a_drive_that_acts_otherwise_than_asked_is_flagged_unless_it_was_lost"),
    ),
)

DEVICE_RELAY = of(
    "rig/loop/device_relay.py",
    (
        "a relay in the device that decides otherwise is believed",
        "DeviceRelay._take_row",
        "if row.u_V != decided_V:",
        "if False:",
        _in_device("test_a_device_that_decides_otherwise_is_found_out"),
    ),
    (
        "the guard's word on a relay in the device is ignored",
        "DeviceRelay._take_row",
        "if passed_V != row.u_V:",
        "if False:",
        _in_device("test_a_drive_that_the_guard_would_not_let_out_ends_the_run_though_nothing_is_too_fast"),
    ),
    (
        "the last rows of a relay in the device are dropped",
        "DeviceRelay.record_last_rows",
        "                self._untaken.extend(driver.read_rows())\n",
        "                pass\n",
        _in_device("test_whatever_ends_the_run_each_row_that_came_is_in_the_record"),
    ),
)

PAUSE = of(
    "rig/loop/pause_watch.py",
    (
        "nobody looks in the pause",
        "PauseWatch.begin",
        "if not self._needed or self._is_pause:",
        "if True:",
        _pause("test_in_virtual_time_it_is_read_each_period_of_a_pause"),
    ),
    (
        "what was seen in the pause is not raised",
        "PauseWatch.check",
        "if self._seen is not None:",
        "if False:",
        _pause("test_what_is_seen_in_real_time_is_raised_before_anything_arms"),
    ),
    (
        "the watcher of the pause goes on into the run",
        "PauseWatch.give_up",
        "            self._thread.join()\n",
        "            pass\n",
        _pause("test_nobody_else_uses_the_driver_after_the_pause"),
    ),
)

PRE_RUN = of(
    "rig/loop/pre_run.py",
    (
        "a pre-run simulation that leaves the soft limits passes",
        "pre_run",
        "if reached[0] < low or reached[1] > high:",
        "if False:",
        in_file("tests/loop/test_loop_pre_run.py", "test_one_that_leaves_the_soft_limits_must_not_drive_the_bench"),
    ),
    (
        "a pre-run simulation that asks for too much drive passes",
        "pre_run",
        "if tracking.largest_u_V > guard.limits.max_u_V:",
        "if False:",
        in_file("tests/loop/test_loop_pre_run.py", "test_one_that_asks_for_more_than_the_largest_drive_must_not"),
    ),
)

SIGNALS = of(
    "rig/loop/stop_request.py",
    (
        "SIGHUP kills the run",
        "",
        ', *((signal.SIGHUP,) if hasattr(signal, "SIGHUP") else ()))',
        ")",
        _runner("test_signals_end_in_a_safe_stop_and_handlers_come_back"),
    ),
)

BENCH = of(
    "rig/bench.py",
    (
        "the guard does not know the reaction time",
        "guard_settings_of",
        "reaction_s=known_reaction_s(experiment),",
        "reaction_s=0.0 * known_reaction_s(experiment),",
        _preflight("test_the_guard_reckons_with_every_term_of_the_stopping_sum"),
    ),
)

ROOM = of(
    "rig/preflight/room_to_stop.py",
    (
        "the guard is not told of the device's watchdog time",
        "known_reaction_s",
        " + (device_watchdog_s(experiment) or 0.0)",
        "",
        _preflight("test_the_guard_reckons_with_every_term_of_the_stopping_sum"),
    ),
    (
        "what the adapter keeps is not counted",
        "reaction_s",
        " + backend_of(experiment).reply_delay_s(experiment)",
        "",
        _preflight("test_the_guard_reckons_with_every_term_of_the_stopping_sum"),
    ),
    (
        "unseen travel in the breakaway check has no bound",
        "_strokes_up_to",
        "if longest.unseen_rad <= UNSEEN_RAD:",
        "if longest.unseen_rad <= 10.0 * UNSEEN_RAD:",
        _preflight("test_each_rule_refuses_with_one_line_at_its_key")
        + _breakaway("test_the_bound_holds_for_any_inertia_and_friction_that_differs_by_a_tenth"),
    ),
    (
        "a stroke whose last tick never comes is not counted",
        "_unseen_rad",
        "(level - low) * (stroke_s + late_s)",
        "(level - low) * stroke_s",
        _breakaway("test_the_bound_holds_for_any_inertia_and_friction_that_differs_by_a_tenth"),
    ),
    (
        "friction that differs between the ways is not counted",
        "_unseen_rad",
        "left_s += difference * stroke_s",
        "left_s += 0.0",
        _breakaway("test_the_bound_holds_for_any_inertia_and_friction_that_differs_by_a_tenth"),
    ),
)

PREFLIGHT = of(
    "rig/preflight/rules.py",
    (
        "a config whose unseen travel has no bound passes",
        "_unseen_travel",
        "    if strokes is None:\n",
        "    if False:\n",
        _preflight("test_each_rule_refuses_with_one_line_at_its_key"),
    ),
)

SERIAL_RULES = of(
    "rig/backends/serial/rules.py",
    (
        "a config of a real port that names no bridge passes",
        "_bridge",
        "    if e.drive.bridge is None:\n",
        "    if False:\n",
        _preflight("test_each_rule_refuses_with_one_line_at_its_key"),
    ),
)


def _ends(*names: str) -> tuple[str, ...]:
    return in_file("tests/experiment/test_experiment_ends.py", *names)


SESSION = of(
    "rig/session.py",
    (
        "a defect beyond the loop costs the result",
        "_measure_tracking",
        "except Exception as error:  # noqa: BLE001 - whatever it is, the run has its result",
        "except RecordingError as error:",
        _ends("test_a_defect_after_the_loop_costs_neither_record_nor_result"),
    ),
    (
        "a fault of the identification costs the result",
        "_conclude",
        "except Exception as error:  # noqa: BLE001 - the result that is written already stays, and says so",
        "except RecordingError as error:",
        _ends("test_a_defect_after_the_loop_costs_neither_record_nor_result"),
    ),
    (
        "the result waits for the report",
        "record",
        "        _write_result(session, outcome)\n",
        "",
        _ends("test_a_defect_after_the_loop_costs_neither_record_nor_result"),
    ),
    (
        "a script's defect ends without a result",
        "_run_script",
        "except Exception as error:  # noqa: BLE001 - whatever it is, the run ends with its record and a result",
        "except LookupError as error:",
        _ends("test_a_defect_of_the_program_is_a_fault_with_its_traceback_in_the_record"),
    ),
    (
        "nobody says that the e-stop was pressed since the last run",
        "_begin",
        "notes=first_notes)",
        "notes=[])",
        _ends("test_what_the_device_had_latched_since_the_last_run_is_said"),
    ),
    (
        "a result that cannot be made is none",
        "_write_result",
        "        outcome.result = _least_result(session, outcome)\n",
        "        raise\n",
        _ends("test_a_result_that_cannot_be_made_is_the_least_one"),
    ),
    (
        "a signal after the last drive is forgotten",
        "record",
        "if stop.reason is not None and fault is None:",
        "if False:",
        _several("test_a_signal_after_the_last_drive_ends_a_command_of_several_runs"),
    ),
)

COMMAND = of(
    "rig/experiment/script.py",
    (
        "each run of one command opens the bench anew",
        "repeated",
        "    elif backend_of(experiment).is_emulated(experiment):\n",
        "    elif True:\n",
        _several("test_one_command_of_several_runs_acknowledges_nothing_between_them"),
    ),
    (
        "the next run of a command begins after a failure",
        "repeated",
        " and not outcomes[-1].failures",
        "",
        _several("test_a_signal_after_the_last_drive_ends_a_command_of_several_runs"),
    ),
)

MUTANTS = (
    *RUNNER,
    *DEVICE_RELAY,
    *PAUSE,
    *SESSION,
    *COMMAND,
    *PRE_RUN,
    *SIGNALS,
    *BENCH,
    *ROOM,
    *PREFLIGHT,
    *SERIAL_RULES,
)
