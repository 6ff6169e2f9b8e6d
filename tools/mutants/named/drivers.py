"""Defects of the drivers: the serial link, Modbus, and what turns numbers into physics."""

from __future__ import annotations

from mutants.named.writing import in_file, of


def _serial(*names: str) -> tuple[str, ...]:
    return in_file("tests/backends/serial/test_serial_driver.py", *names)


def _frames(*names: str) -> tuple[str, ...]:
    return in_file("tests/backends/serial/test_serial_frames.py", *names)


def _modbus(*names: str) -> tuple[str, ...]:
    return in_file("tests/backends/modbus/test_modbus_driver.py", *names)


def _calibration(*names: str) -> tuple[str, ...]:
    return in_file("tests/calibration/test_calibration_units.py", *names)


def _in_device(*names: str) -> tuple[str, ...]:
    return in_file("tests/hil/test_hil_device_relay.py", *names)


SERIAL = of(
    "rig/backends/serial/driver.py",
    (
        "limits' read-back is not compared",
        "SerialDriver.arm",
        "if stored != setup:",
        "if False:",
        _serial("test_a_read_back_that_differs_in_any_field"),
    ),
    (
        "a refused arming is taken for armed",
        "SerialDriver.arm",
        "if code != Code.NONE:",
        "if False:",
        _serial("test_arming_refused"),
    ),
    (
        "a latched fault is not raised",
        "SerialDriver.read",
        "state.status & frames.STATUS_FAULT\n                or not state.status & frames.STATUS_ARMED\n",
        "not state.status & (frames.STATUS_ARMED | frames.STATUS_FAULT)\n",
        _serial("test_a_latched_fault_has_its_name_and_numbers"),
    ),
    (
        "a device that is no longer armed goes unnoticed",
        "SerialDriver.read",
        "                or not state.status & frames.STATUS_ARMED\n",
        "",
        _serial("test_a_device_that_is_no_longer_armed_has_restarted"),
    ),
    (
        "a drive that was never accepted counts as confirmed",
        "SerialDriver.read",
        "if state.drive_seq == self._unconfirmed:",
        "if True:",
        _serial("test_a_lost_drive_is_not_pretended"),
    ),
    (
        "lost drives are never too many",
        "SerialDriver.read",
        "if self._lost_in_a_row >= _LOST_DRIVES:",
        "if False:",
        _serial("test_three_lost_drives_in_a_row_end_the_run"),
    ),
    (
        "readings that must be asked for again are never too many",
        "SerialDriver._ask_state",
        "if self._again_in_a_row < _READ_AGAIN:",
        "if True:",
        _serial("test_three_readings_in_a_row_that_had_to_be_asked_for_again_end_the_run"),
    ),
    (
        "any answer confirms a stop",
        "SerialDriver._is_stopped",
        "if state.drive == 0 and not state.status & frames.STATUS_ARMED:",
        "if True:",
        _serial("test_a_stop_that_leaves_the_drive_on_or_the_device_armed_is_not_confirmed"),
    ),
    (
        "a stop is asked for once",
        "SerialDriver._is_stopped",
        "for _ in range(ATTEMPTS):",
        "for _ in range(1):",
        _serial("test_safe_stop_asks_three_times_and_says_so"),
    ),
    (
        "closing stops nothing",
        "SerialDriver.close",
        "            self.safe_stop()\n",
        "            pass\n",
        _serial("test_close_stops_what_is_armed"),
    ),
    (
        "a device that has lost the session drives on",
        "SerialDriver.read",
        "                or state.session != self._session\n",
        "",
        _serial("test_a_device_that_has_lost_the_session_was_reset"),
    ),
    (
        "a device that has lost the session is set up again",
        "SerialDriver.arm",
        "if setup != self._setup:",
        "if True:",
        _serial("test_arming_again_sends_no_setup_and_names_the_session"),
    ),
    (
        "what happened in a pause is not looked at",
        "SerialDriver._check_pause",
        "if state.status & frames.STATUS_FAULT or (self._setup is not None and state.session != self._session):",
        "if False:",
        _serial("test_an_e_stop_in_a_pause_is_told"),
    ),
    (
        "a fault whose cause lasts counts as cleared",
        "SerialDriver._is_cleared",
        "return packet.kind == Kind.ACK_REPLY",
        "return True",
        _serial("test_what_lasts_stays_latched"),
    ),
    (
        "what opening has cleared is not said",
        "SerialDriver._acknowledge",
        "for code in cleared if code != Code.RESET)",
        "for code in cleared if code != code)",
        _serial("test_opening_clears_what_was_latched_and_tells_of_it"),
    ),
    (
        "what latches after the opening's own reset is cleared",
        "SerialDriver._acknowledge",
        "if code == Code.RESET and was_reset_now:",
        "if False:",
        _serial("test_what_latches_while_a_device_is_opened_stays_latched"),
    ),
    (
        "what latches again while it is cleared is cleared again",
        "SerialDriver._acknowledge",
        " or code in cleared",
        "",
        _serial("test_what_latches_while_a_device_is_opened_stays_latched"),
    ),
    (
        "every driver has the same session",
        "SerialDriver.__init__",
        "secrets.randbelow(2**32 - 1) + 1 if session is None else session",
        "1 if session is None else session",
        _serial("test_each_driver_has_a_session_of_its_own"),
    ),
    (
        "the device is told ten times the watchdog time",
        "setup_for",
        "watchdog_ms = round(1000.0 * limits.watchdog_s)",
        "watchdog_ms = min(round(10000.0 * limits.watchdog_s), 1000)",
        _serial("test_arming_sends_stop_limits_and_arm_in_this_order"),
    ),
)

EXCHANGE = of(
    "rig/backends/serial/exchange.py",
    (
        "a stale reply is accepted",
        "Exchange.wait",
        "                    and packet.seq in seqs\n",
        "",
        _serial("test_late_replies_are_never_taken_for_the_next_ones"),
    ),
    (
        "a reply of another kind is accepted",
        "Exchange.wait",
        "                    and (packet.kind == kind or packet.kind == Kind.NACK)\n",
        "",
        _serial("test_foreign_replies_are_passed_over"),
    ),
    (
        "a reply of another version is accepted",
        "Exchange.wait",
        "                    and packet.version == frames.VERSION\n",
        "",
        _serial("test_foreign_replies_are_passed_over"),
    ),
)

FIT = of(
    "rig/backends/serial/fit.py",
    (
        "the tables of config and device are not compared",
        "check_fit",
        "if expected.board.counts_max is not None and hello.counts_max != expected.board.counts_max:",
        "if False:",
        _serial("test_a_config_that_does_not_fit_the_device"),
    ),
    (
        "the measured supply is not compared",
        "measured_supply_V",
        "if (max(off_V, 0.0) if at_least else abs(off_V)) > _SUPPLY_TOLERANCE * believed_V:",
        "if False:",
        in_file("tests/hil/test_hil_chip_link.py", "test_the_motor_supply_where_it_is_wired"),
    ),
    (
        "the bridge's variant is not compared",
        "check_fit",
        "    _check_bridge(hello, expected)\n",
        "",
        _serial("test_a_bridge_that_is_not_the_configs"),
    ),
    (
        "a bridge that the config does not name is driven",
        "_check_bridge",
        "(believed is None and emulated)",
        "believed is None",
        _serial("test_a_bridge_that_is_not_the_configs"),
    ),
    (
        "a board that does not say its bridge is driven",
        "_check_bridge",
        "(hello.bridge == 0 and emulated)",
        "hello.bridge == 0",
        _serial("test_a_bridge_that_is_not_the_configs"),
    ),
)

RELAY = of(
    "rig/backends/serial/device_relay.py",
    (
        "the relay's read-back is not compared",
        "RelayRun.start",
        "if RelaySetup.unpack(packet.body) != setup:",
        "if False:",
        _in_device("test_a_relay_that_was_stored_otherwise_is_refused"),
    ),
    (
        "blocks that stay away are not missed",
        "RelayRun.missed_s",
        "if silent_s > frames.BLOCK_ROWS * TICK_S + self._exchange.timeout_s:",
        "if False:",
        _in_device("test_a_reset_a_hang_and_a_cable_while_it_runs"),
    ),
)

FRAMES = of(
    "rig/backends/serial/frames.py",
    (
        "the host does not check the CRC",
        "_decode",
        ' or crc_hqx(packet[:-2], 0xFFFF) != int.from_bytes(packet[-2:], "little")',
        "",
        _frames("test_any_flipped_bit_of_a_packet_is_detected"),
    ),
    (
        "a body of the wrong length passes",
        "_decode",
        "if version == VERSION and not _may_be(kind, len(body)):",
        "if False:",
        _frames("test_a_wrong_body_length_with_a_right_crc_is_dropped"),
    ),
)

STREAM = of(
    "rig/backends/serial/relay_stream.py",
    (
        "a missing block is not missed",
        "RelayStream.take",
        "        if ahead:\n",
        "        if False:\n",
        _in_device("test_a_block_that_is_missing_is_a_fault"),
    ),
    (
        "a block of another session is taken",
        "RelayStream.take",
        "if block.session != self._session:",
        "if False:",
        _in_device("test_a_block_of_another_session_is_a_reset"),
    ),
    (
        "a block that comes twice is taken twice",
        "RelayStream.take",
        "if ahead >= 2**15:",
        "if False:",
        _in_device("test_a_block_that_comes_twice_is_taken_once"),
    ),
)

MEETING = of(
    "rig/backends/serial/introduction.py",
    (
        "a device of another version is taken",
        "await_introduction",
        "if packet.version != frames.VERSION:",
        "if False:",
        _serial("test_another_version_names_both"),
    ),
    (
        "what an earlier run left is believed",
        "await_introduction",
        "asked = 1 <= packet.seq <= seq",
        "asked = True",
        _serial("test_an_introduction_that_nobody_asked_for_is_not_believed"),
    ),
)

OPENING = of(
    "rig/backends/serial/introduction.py",
    (
        "the opening can be read as 'program page'",
        "_harmless_numbers",
        " if not _reads_program_page(frames.encode(Kind.HELLO, seq))",
        "",
        in_file(
            "tests/backends/serial/test_serial_boot_loader.py",
            "test_numbers_whose_frame_can_be_read_so_at_its_own_baud_rate_are_left_out",
        ),
    ),
    (
        "HELLO goes out in one piece",
        "_spell",
        "    for byte in frame:\n        transport.write(bytes((byte,)))\n",
        "    for byte in (frame,):\n        transport.write(byte)\n",
        in_file(
            "tests/backends/serial/test_serial_boot_loader.py",
            "test_no_boot_loader_reads_program_page_in_the_whole_opening",
        ),
    ),
)

CLOCK = of(
    "rig/backends/serial/device_clock.py",
    (
        "a restart while the clock is measured passes",
        "fit_device_clock",
        "if exchange is not first and not least_s <= step_us * 1e-6 <= most_s:",
        "if False:",
        in_file("tests/backends/serial/test_serial_device_clock.py", "test_a_restart_is_no_clock"),
    ),
)

CALIBRATION = of(
    "rig/calibration.py",
    (
        "the drive's sign is flipped",
        "DriveMap.sign",
        "return -1 if self.reversed else 1",
        "return 1 if self.reversed else -1",
        _calibration("test_a_bridge_by_hand"),
    ),
    (
        "a reversed bridge is not turned back",
        "DriveMap.sign",
        "return -1 if self.reversed else 1",
        "return 1",
        _calibration("test_a_reversed_bridge_keeps_the_dead_band_with_the_duty"),
    ),
    (
        "a drive beyond the bridge is not refused",
        "DriveMap.to_units",
        "if not size <= self.full_V:",
        "if False:",
        _calibration("test_no_clipping_without_a_word"),
    ),
    (
        "hard limits are rounded outward",
        "hard_limits_in_counts",
        "math.ceil(low - 1e-9), math.floor(high + 1e-9)",
        "math.floor(low - 1e-9), math.ceil(high + 1e-9)",
        _serial("test_counts_are_inside_exactly_if_the_position_is"),
    ),
    (
        "a hard limit beyond the rail is not refused",
        "hard_limits_in_counts",
        "if not 0 <= rail_lo < hard_lo <= hard_hi < rail_hi:",
        "if False:",
        _serial("test_limits_that_the_device_cannot_hold"),
    ),
    (
        "the device is told the wrong polarity",
        "polarity",
        "return calibration.direction * drive_map.sign",
        "return calibration.direction",
        _calibration("test_polarity_is_what_positive_units_do_to_counts"),
    ),
)

_MISFITS = _modbus("test_a_reply_that_is_not_the_reply_is_a_fault_and_the_motor_stops")
_TCP_MISFITS = in_file(
    "tests/backends/modbus/test_modbus_tcp.py", "test_a_reply_that_is_not_the_reply_is_a_fault_and_the_motor_stops"
)

MODBUS = of(
    "rig/backends/modbus/driver.py",
    (
        "a setting's read-back is not compared",
        "ModbusDriver._set",
        "if stored != words:",
        "if False:",
        _modbus("test_a_setting_that_the_device_changes_is_no_arming"),
    ),
    (
        "the block's status is not looked at",
        "ModbusDriver._check_status",
        'if status is None or values["status"] == ARMED:',
        "if True:",
        _modbus("test_the_devices_status_is_a_fault_by_name"),
    ),
    (
        "the status in a pause is not looked at",
        "ModbusDriver._check_pause",
        'if status is None or values["status"] == OFF:',
        "if True:",
        _modbus("test_whatever_a_device_says_in_a_pause_but_off_is_told"),
    ),
    (
        "settings that are gone are written anew",
        "ModbusDriver._check_settings",
        "if stored != words:",
        "if False:",
        _modbus("test_a_power_cycle_in_a_pause_is_found_when_it_is_armed_again"),
    ),
    (
        "the drive's echo is not compared",
        "ModbusDriver._check_echo",
        'if echo is not None and values["echo"] != self._sequence:',
        "if False:",
        _MISFITS,
    ),
    (
        "more drive than armed for goes out",
        "ModbusDriver.write",
        "if abs(units) > self._max_units:",
        "if False:",
        _modbus("test_beyond_what_was_armed_nothing_goes_out"),
    ),
    (
        "drive goes out before arming",
        "ModbusDriver.write",
        "if not self._armed:",
        "if False:",
        _modbus("test_before_arming_it_reads_and_drives_nothing"),
    ),
    (
        "a stop is confirmed by nobody",
        "ModbusDriver._is_stopped",
        "stopped = not driven and not self._is_armed_by(status)",
        "stopped = True",
        _modbus("test_a_block_that_goes_on_driving_does_not_confirm_the_stop"),
    ),
    (
        "late replies pass for the confirmation of the stop",
        "ModbusDriver._settle",
        "if not self._client.is_suspect:",
        "if True:",
        _modbus("test_a_late_reply_is_no_confirmation_of_the_stop"),
    ),
    (
        "stopping leaves the drive as it was",
        "ModbusDriver._write_stop",
        "            asked(_setting(self._map.drive, 0.0), timeout_s)\n",
        "            pass\n",
        _modbus("test_a_device_that_refuses_to_stop_is_driven_to_0_all_the_same"),
    ),
    (
        "arming does not begin with drive 0",
        "ModbusDriver.arm",
        "        self._client.patiently(self._writing_drive(0), self._unhurried_s)\n",
        "",
        _modbus("test_arming_sets_the_drive_to_0_before_it_arms"),
    ),
    (
        "a position that no sensor gives is believed",
        "ModbusDriver._check_range",
        "if self._counts_max is not None and not 0 <= counts <= self._counts_max:",
        "if False:",
        _modbus("test_a_position_that_no_sensor_gives_is_refused_by_name_before_anything_is_armed"),
    ),
)

MODBUS_CLIENT = of(
    "rig/backends/modbus/client.py",
    (
        "bytes that nobody asked for are no fault",
        "ModbusClient.in_tick",
        "if after_silence and unasked >= _UNASKED_BYTES:",
        "if False:",
        _MISFITS,
    ),
    (
        "two answers to one request are no fault",
        "ModbusClient._accepted",
        "if strict and extra >= _UNASKED_BYTES:",
        "if False:",
        _MISFITS,
    ),
    (
        "in the tick a damaged reply is waited over",
        "ModbusClient._await",
        "            if strict:\n                raise objection\n",
        "",
        _MISFITS,
    ),
)

MODBUS_REQUESTS = of(
    "rig/backends/modbus/requests.py",
    (
        "a reply to another request is accepted",
        "check",
        "if frame.number is not None and frame.number != number:",
        "if False:",
        _TCP_MISFITS,
    ),
    ("another unit's reply is accepted", "check", "if frame.unit != unit:", "if False:", _MISFITS),
    ("a refusal is taken for a reply", "check", "if is_exception(frame, asked):", "if False:", _MISFITS),
    (
        "a reply of another function is accepted",
        "check",
        "if frame.pdu[0] != asked.function_code:",
        "if False:",
        _MISFITS,
    ),
    (
        "a write's confirmation is not compared",
        "check",
        "elif expected is not None and frame.pdu != expected:",
        "elif False:",
        _modbus("test_a_write_that_is_confirmed_otherwise_is_a_fault"),
    ),
    (
        "the number of registers is not compared",
        "check",
        "if len(frame.pdu) != expected or frame.pdu[1] != expected - 2:",
        "if False:",
        _MISFITS,
    ),
)

MODBUS_FRAMES = of(
    "rig/backends/modbus/frames.py",
    (
        "Modbus's check sum is not checked",
        "RtuFraming.take",
        'if FramerRTU.compute_CRC(body) != int.from_bytes(data[length - 2 : length], "big"):',
        "if False:",
        in_file("tests/backends/modbus/test_modbus_registers.py", "test_rtu_takes_a_reply_only_whole_and_undamaged"),
    ),
)

MUTANTS = (
    *SERIAL,
    *EXCHANGE,
    *FIT,
    *RELAY,
    *FRAMES,
    *STREAM,
    *MEETING,
    *OPENING,
    *CLOCK,
    *CALIBRATION,
    *MODBUS,
    *MODBUS_CLIENT,
    *MODBUS_REQUESTS,
    *MODBUS_FRAMES,
)
