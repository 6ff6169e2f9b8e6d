"""Defects of the guard, of what a driven shaft must do, and of the laws that run before any relay."""

from __future__ import annotations

from mutants.named.writing import in_file, of


def _guard(*names: str) -> tuple[str, ...]:
    return in_file("tests/control/test_control_guard.py", *names)


def _motion(*names: str) -> tuple[str, ...]:
    return in_file("tests/control/test_control_motion.py", *names)


def _breakaway(*names: str) -> tuple[str, ...]:
    return in_file("tests/control/test_control_breakaway.py", *names)


_FAULTS = _guard("test_sensor_and_travel_faults_have_their_code_and_latch")

GUARD = of(
    "rig/control/guard.py",
    ("hard limit off", "Guard._limit_travel", "if not inside and not self.recovering:", "if False:", _FAULTS),
    (
        "soft limit lets outward drive pass",
        "Guard._limit_travel",
        "if (y > soft_high and u_V > 0.0) or (y < soft_low and u_V < 0.0):",
        "if False:",
        _guard("test_between_soft_and_hard_only_inward_drive_passes"),
    ),
    (
        "soft limit of the low side off",
        "Guard._limit_travel",
        " or (y < soft_low and u_V < 0.0)",
        "",
        _guard("test_between_soft_and_hard_only_inward_drive_passes"),
    ),
    (
        "never brakes",
        "Guard._limit_travel",
        "outward = 1 if self.predicted_stop_rad > hard_high else -1 if self.predicted_stop_rad < hard_low else 0",
        "outward = 0",
        _guard("test_it_brakes_inward_on_the_predicted_stop_only_once_the_sign_is_proven"),
    ),
    (
        "brakes the wrong way",
        "Guard._limit_travel",
        "u_V = -outward * s.limits.max_u_V",
        "u_V = outward * s.limits.max_u_V",
        _guard("test_it_brakes_inward_on_the_predicted_stop_only_once_the_sign_is_proven"),
    ),
    (
        "brakes before the sign is proven",
        "Guard._limit_travel",
        " if self.sign_proven else 0.0",
        "",
        _guard("test_it_brakes_inward_on_the_predicted_stop_only_once_the_sign_is_proven"),
    ),
    (
        "predicted stop ignores the watchdog time",
        "Guard._limit_travel",
        "v * (s.reaction_s + s.coast_tau_s)",
        "v * s.coast_tau_s",
        _guard("test_the_predicted_stop_counts_the_reaction_watchdog_and_all_and_the_way_that_the_shaft_coasts"),
    ),
    (
        "predicted stop ignores how far the shaft coasts",
        "Guard._limit_travel",
        "v * (s.reaction_s + s.coast_tau_s)",
        "v * s.reaction_s",
        _guard("test_the_predicted_stop_counts_the_reaction_watchdog_and_all_and_the_way_that_the_shaft_coasts"),
    ),
    (
        "more than the largest drive passes",
        "Guard._limit_travel",
        "if abs(u_V) > s.limits.max_u_V:",
        "if False:",
        _guard("test_more_than_the_largest_drive_is_cut_and_flagged"),
    ),
    (
        "recovering never ends",
        "Guard._limit_travel",
        "self.recovering = False",
        "pass",
        _guard("test_recovering_ends_inside_the_soft_limits_where_the_hard_ones_hold_again"),
    ),
    ("sensor rail off", "Guard._check_sensor", "if not low < sample.y_counts < high:", "if False:", _FAULTS),
    ("sensor jump off", "Guard._check_sensor", "if step > allowed:", "if False:", _FAULTS),
    (
        "stale samples accepted",
        "Guard._check_sensor",
        "if self._same_instant >= _STALE_SAMPLES:",
        "if False:",
        _FAULTS,
    ),
    (
        "overspeed off",
        "Guard._check_sensor",
        "if abs(self.velocity_rad_s) > 1.2 * self.settings.max_speed_rad_s:",
        "if False:",
        _FAULTS,
    ),
    (
        "overspeed of falling positions off",
        "Guard._check_sensor",
        "if abs(self.velocity_rad_s) > 1.2",
        "if self.velocity_rad_s > 1.2",
        _FAULTS,
    ),
    (
        "polarity off",
        "Guard._check_polarity",
        "if sample.t_s - since_s > 0.08 and gained >",
        "if False and gained >",
        _guard("test_drive_outward_of_soft_that_persists_while_inward_is_commanded_is_a_polarity_fault"),
    ),
    (
        "a slow creep outward is not noticed",
        "Guard._check_creep",
        "if crept_rad > max(2.0 * self.settings.motion_rad, 12.0 * self.settings.noise_rad):",
        "if False:",
        _guard("test_a_recovery_that_creeps_outward_is_ended_by_its_distance"),
    ),
    (
        "a reading that stands while driven is no fault",
        "Guard._check_stuck",
        "if still_s >= min(max(stuck_s, 2.0 * self._standstill.longest_s), 4.0 * stuck_s):",
        "if False:",
        _guard("test_a_stuck_sensor_is_found_while_driven_and_not_while_at_rest"),
    ),
    (
        "speed that a lasting drive gave may get lost",
        "Guard._check_stuck",
        "if given_rad_s > self._clear_rad_s and",
        "if False and",
        _motion("test_the_guard_finds_a_reading_that_freezes_while_the_drive_speeds_the_shaft_up"),
    ),
    (
        "a fault does not latch",
        "Guard.allow",
        "            self.fault = fault\n",
        "",
        _FAULTS,
    ),
    (
        "a drive that is no number passes",
        "Guard.allow",
        "if not math.isfinite(asked_V):",
        "if False:",
        _guard("test_a_drive_that_is_no_number_is_the_laws_failure"),
    ),
    (
        "motion before a pause is remembered",
        "Guard.rearm",
        "        self._last = None\n",
        "",
        _guard("test_what_was_seen_before_a_pause_says_nothing_after_it"),
    ),
)

MOTION = of(
    "rig/control/motion.py",
    (
        "a cycle may stand for ever",
        "CycleWatch.step",
        "if still_s > self._granted_s:",
        "if False:",
        _motion("test_at_any_phase_of_the_cycle_it_is_found_and_the_shaft_stays_inside"),
    ),
    (
        "braking of the guard is taken for the relays'",
        "CycleWatch.step",
        "            self._last.clear()\n",
        "",
        _motion("test_a_cycle_that_others_drive_in_goes_on_when_it_has_shown_so_again"),
    ),
    (
        "a cycle may stand for as long as it likes where it never stood",
        "CycleWatch.end_period",
        "min(max(self.LONGER * self.longest_s, self.LEAST * period_s), self.MOST * period_s)",
        "max(self.LONGER * self.longest_s, self.MOST * period_s)",
        _motion("test_how_long_a_cycle_may_stand"),
    ),
    (
        "a cycle that dies away is judged",
        "CycleWatch.end_period",
        "            and cycle.amplitude_rad > self.KEEPS * before.amplitude_rad\n",
        "",
        _motion("test_how_long_a_cycle_may_stand"),
    ),
    (
        "any drive passes for the one asked for",
        "is_obeyed",
        "return abs(acting_V - asked_V) <= 0.05 + 0.005 * abs(asked_V)",
        "return True",
        _motion("test_a_cycle_that_others_drive_in_goes_on_when_it_has_shown_so_again"),
    ),
    (
        "speed of before the drive counts as given by it",
        "Gain.step",
        "along - self._before_rad_s",
        "along",
        _motion("test_a_drive_never_takes_back_a_quarter_of_the_speed_that_it_gave"),
    ),
)

_BENCHES = _breakaway("test_each_wrong_bench_is_named_and_left_at_zero")

BREAKAWAY = of(
    "rig/control/breakaway.py",
    ("a reversed motor passes", "BreakawayCheck._judge", "if against[way] > self.motion_rad:", "if False:", _BENCHES),
    (
        "a noisy sensor passes",
        "RestingCheck._stands",
        "if first and self.noise_rad > 0.33 * self.motion_rad:",
        "if False:",
        _BENCHES,
    ),
    (
        "a shaft that turns before the check passes",
        "RestingCheck._stands",
        "if self._turns(still):",
        "if False:",
        _breakaway("test_a_shaft_that_drifts_by_more_than_the_noise_explains_is_waited_for"),
    ),
    (
        "a stroke begins before the shaft stands again",
        "BreakawayCheck._pause",
        "if self._turns(still):",
        "if False:",
        _breakaway("test_a_shaft_that_coasts_after_a_stroke_is_waited_for"),
    ),
    (
        "strokes are not taken back",
        "BreakawayCheck._balance",
        "self._needed.append(_Stroke(-way, acted_s, takes_back=True))",
        "self._needed.append(_Stroke(way, acted_s, takes_back=True))",
        _breakaway("test_strokes_come_in_pairs_of_equal_level_and_opposite_sign"),
    ),
    (
        "each pair begins the same way",
        "BreakawayCheck._next_stroke",
        "_Stroke(1 if self._pair % 2 else -1, stroke_s, takes_back=False)",
        "_Stroke(1, stroke_s, takes_back=False)",
        _breakaway("test_strokes_come_in_pairs_of_equal_level_and_opposite_sign"),
    ),
    (
        "strokes go beyond the largest drive",
        "BreakawayCheck._stroke_V",
        "min((tick + 1) / ticks, 1.0), self.max_V)",
        "min((tick + 1) / ticks, 1.0), 2.0 * self.max_V)",
        _breakaway("test_strokes_come_in_pairs_of_equal_level_and_opposite_sign"),
    ),
    (
        "one way is enough",
        "BreakawayCheck._pause",
        "if not self._needed and len(self._found_V) == 2:",
        "if not self._needed and self._found_V:",
        _breakaway(
            "test_it_measures_both_levels_and_the_noise_and_hardly_moves_the_shaft",
            "test_random_motors_turn_little_unseen_and_are_seen_both_ways",
        ),
    ),
    (
        "a late stroke is taken back by one as long as it was meant",
        "BreakawayCheck._balance",
        "self._needed.append(_Stroke(-way, acted_s, takes_back=True))",
        "self._needed.append(_Stroke(-way, self._meant_s, takes_back=True))",
        _breakaway("test_what_a_late_tick_adds_to_a_stroke_is_taken_back"),
    ),
    (
        "late ticks add up without end",
        "BreakawayCheck._balance",
        "if self._longer_s > self._late_s:",
        "if False:",
        _breakaway("test_many_late_ticks_end_the_check_before_they_add_up"),
    ),
    (
        "noise adds up to motion",
        "BreakawayCheck._judge",
        "off_rad = 6.0 * variance / self.motion_rad",
        "off_rad = 0.0 * variance / self.motion_rad",
        _breakaway("test_noise_alone_never_gathers_to_motion"),
    ),
)

EXCITATION = of(
    "rig/control/excitation.py",
    (
        "the gain search does not retreat from the limit",
        "GainSearch.step",
        'self._retreat(sample.t_s, f"|y| above {self.reach_rad:.2f} rad")',
        "pass",
        in_file(
            "tests/control/test_control_excitation_search.py",
            "test_a_cycle_that_leaves_its_reach_gets_less_h2_at_once_and_more_h1",
        ),
    ),
    (
        "the gain search does not retreat from its speed",
        "GainSearch.step",
        "elif speed > self.top_speed_rad_s:",
        "elif False:",
        in_file("tests/control/test_control_excitation_search.py", "test_a_cycle_beyond_the_top_speed_gets_less_h2"),
    ),
    (
        "the gain search goes on for ever",
        "GainSearch.step",
        "if sample.t_s - self._start_s > self.search.timeout_s:",
        "if False:",
        in_file("tests/control/test_control_excitation_search.py", "test_the_search_ends_at_its_time_out"),
    ),
    (
        "the relay test does not look whether the cycle stands",
        "RelayTest.step",
        "        self.watch.step(sample, u_V)\n",
        "",
        _motion("test_at_any_phase_of_the_cycle_it_is_found_and_the_shaft_stays_inside"),
    ),
)

MUTANTS = (*GUARD, *MOTION, *BREAKAWAY, *EXCITATION)
