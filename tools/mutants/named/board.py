"""Defects of the board layers: the Uno's on its emulated chip, and the emulated board's own."""

from __future__ import annotations

from mutants.named.writing import in_file, of


def _safety(*names: str) -> tuple[str, ...]:
    return in_file("tests/hil/test_hil_chip_safety.py", *names)


def _tick(*names: str) -> tuple[str, ...]:
    return in_file("tests/hil/test_hil_chip_tick.py", *names)


def _link(*names: str) -> tuple[str, ...]:
    return in_file("tests/hil/test_hil_chip_link.py", *names)


_ESTOP = _safety("test_the_e_stop_means_0_V_within_a_tick_and_before_that_in_its_interrupt")
_HANGS = _safety("test_a_hung_program_is_reset_by_the_hardware_watchdog")
_BRIDGES = _link("test_the_bridge_gives_what_was_asked_for_both_ways")

INPUTS = of(
    "firmware/boards/uno/inputs.c",
    ("the e-stop's interrupt leaves the bridge on", "PCINT2_vect", "        bridge_drive(0);\n", "", _ESTOP),
    (
        "a short opening of the e-stop is forgotten",
        "inputs_take",
        "if (stopped || estop_is_open()) {",
        "if (estop_is_open()) {",
        _safety("test_a_short_opening_of_the_e_stop_is_latched"),
    ),
    (
        "the e-stop's contact is read the wrong way",
        "estop_is_open",
        "(PIND & PIN_ESTOP) != 0u",
        "(PIND & PIN_ESTOP) == 0u",
        _ESTOP,
    ),
    ("the e-stop has no interrupt", "inputs_init", "    PCICR = BIT(PCIE2);\n", "", _ESTOP),
    (
        "the e-stop has no pull-up",
        "inputs_init",
        "(uint8_t)(PIN_ESTOP | (RIG_END_SWITCHES ?",
        "(uint8_t)((RIG_END_SWITCHES ?",
        _safety("test_the_e_stop_is_seen_if_it_was_open_from_the_start") + _ESTOP,
    ),
    (
        "the low end switch is the high one's",
        "inputs_take",
        "bits |= (uint8_t)RIG_INPUT_END_LOW;",
        "bits |= (uint8_t)RIG_INPUT_END_HIGH;",
        _safety("test_an_end_switch_means_0_V_within_two_ticks_and_only_inward_from_there"),
    ),
)

MAIN = of(
    "firmware/boards/uno/main.c",
    (
        "drive passes between the e-stop and its fault",
        "set_drive",
        "inputs_have_stopped() ? 0 : units",
        "units",
        _safety("test_no_drive_passes_between_the_e_stop_and_its_fault"),
    ),
    ("the hardware watchdog is not switched on", "main", "    wdt_enable(WDTO_120MS);\n", "", _HANGS),
    (
        "the tick feeds the hardware watchdog for the main loop",
        "tick",
        "    if (has_been_round) {\n        has_been_round = false;\n        wdt_reset();\n    }\n",
        "    has_been_round = false;\n    wdt_reset();\n",
        _HANGS,
    ),
    (
        "a tick without a fresh sample feeds the hardware watchdog",
        "tick",
        "    if (!adc_take_tick()) {\n        return;",
        "    if (!adc_take_tick()) {\n        wdt_reset();\n        return;",
        _HANGS,
    ),
    (
        "after its own reset the hardware watchdog bites on",
        "early",
        "    wdt_disable();\n",
        "",
        in_file("tests/hil/test_hil_registers.py", "test_a_broken_rule_is_named"),
    ),
    (
        "the cause of a reset is lost",
        "early",
        "    reset_flags = MCUSR;\n",
        "    reset_flags = 0;\n",
        _link("test_the_cause_of_a_reset_is_told_and_nothing_else_survives_it"),
    ),
    (
        "a tick enters itself",
        "TIMER2_COMPB_vect",
        "    if (in_tick) {\n        return;\n    }\n",
        "",
        _tick("test_a_tick_that_takes_too_long_is_never_entered_again"),
    ),
    (
        "the tick keeps all interrupts out",
        "TIMER2_COMPB_vect",
        "    sei();\n    tick();",
        "    tick();",
        _link("test_no_byte_is_lost_however_dense_the_requests"),
    ),
    (
        "the tick takes any sample",
        "position",
        "in_tick ? adc_tick_sample() : adc_newest_sample()",
        "adc_newest_sample()",
        _tick("test_a_tick_that_takes_too_long_is_never_entered_again"),
    ),
    (
        "the host's voice counts from when the main loop came to it",
        "arrived_us",
        "return clock_us_of(begin);",
        "return clock_us() + 0u * clock_us_of(begin);",
        _safety("test_a_drive_that_waits_behind_garbage_is_of_the_tick_in_which_it_arrived"),
    ),
    (
        "HELLO names another bridge",
        "BOARD",
        ".bridge = (uint8_t)RIG_BRIDGE,",
        ".bridge = (uint8_t)(3 - RIG_BRIDGE),",
        _link("test_it_introduces_itself"),
    ),
    (
        "sending goes on within the tick",
        "TIMER2_COMPB_vect",
        "const uint8_t control = uart_pause_sending();",
        "const uint8_t control = UCSR0B;",
        _tick("test_a_blocks_one_delay_is_true_of_all_its_rows"),
    ),
)

_PULSES = in_file("tests/hil/test_hil_registers.py", "test_no_pulse_is_longer_than_its_share")
_RULES = in_file("tests/hil/test_hil_registers.py", "test_the_firmware_keeps_every_rule_that_the_emulator_knows")

BRIDGE = of(
    "firmware/boards/uno/bridge.c",
    (
        "at 0 the PWM goes on",
        "off",
        "    TCCR1A = 0; /* the pins' own level: 0 V at once */\n",
        "",
        _safety("test_a_silent_host_means_0_V_within_the_watchdog_time_and_a_tick"),
    ),
    ("the timer runs on at 0", "off", "    TCCR1B = 0; /* normal mode, and it stands still */\n", "", _PULSES + _RULES),
    (
        "ICR1 before the mode that uses it",
        "start_pwm",
        "    TCCR1B = PWM;\n    *compare = size; /* now its buffer, which comes into force with the next period */\n"
        "    ICR1 = BRIDGE_FULL;\n",
        "    ICR1 = BRIDGE_FULL;\n    TCCR1B = PWM;\n    *compare = size;\n",
        _RULES,
    ),
    (
        "the share is written in the mode that keeps it back",
        "start_pwm",
        "    *compare = size; /* in normal mode: in force at once */\n",
        "",
        _PULSES,
    ),
    ("the timer counts on from the drive before", "off", "    TCNT1 = 0;\n", "", _PULSES),
    ("the direction is never set", "drive", "        set_bits(&PORTB, PIN_DIRECTION);\n", "", _BRIDGES),
    ("the direction is never cleared", "drive", "        clear_bits(&PORTB, PIN_DIRECTION);\n", "", _BRIDGES),
    (
        "two inputs at rest let the motor coast",
        "bridge_init",
        "    set_bits(&PORTB, HIGH_AT_REST);\n",
        "",
        _BRIDGES,
    ),
    (
        "two inputs: forward and back are swapped",
        "drive",
        "        drive_by(OUTPUT_A, &OCR1A, size);\n    } else {\n        drive_by(OUTPUT_B, &OCR1B, size);\n",
        "        drive_by(OUTPUT_B, &OCR1B, size);\n    } else {\n        drive_by(OUTPUT_A, &OCR1A, size);\n",
        _BRIDGES,
    ),
    (
        "two inputs: the other way begins while one drives",
        "drive_by",
        "        off();\n",
        "",
        _BRIDGES + _PULSES,
    ),
    (
        "negative drive is as large as it can be",
        "bridge_drive",
        "units < 0 ? -units : units",
        "units < 0 ? (int16_t)BRIDGE_FULL : units",
        _BRIDGES,
    ),
)

CLOCK = of(
    "firmware/boards/uno/clock.c",
    (
        "the tick is not held while a request acts",
        "clock_hold_tick",
        "    TIMSK2 = BIT(OCIE2A);\n",
        "",
        in_file("tests/hil/test_hil_registers.py", "test_each_row_of_the_table_is_in_the_source_and_has_its_test"),
    ),
    (
        "the clock jumps back where a tick's interrupt waits",
        "clock_us",
        "            us += US_PER_TICK; /* this tick's interrupt still waits */\n",
        "",
        _link("test_the_devices_clock_never_jumps"),
    ),
)

ADC = of(
    "firmware/boards/uno/adc.c",
    (
        "a dead converter goes unnoticed",
        "adc_take_tick",
        "    is_fresh = false;\n",
        "",
        _HANGS,
    ),
    (
        "the tachometer is read as the position",
        "channel_of",
        "CHANNEL_TACHOMETER : CHANNEL_POSITION",
        "CHANNEL_POSITION : CHANNEL_POSITION",
        _link("test_a_tachometer_where_it_is_wired"),
    ),
)

UART = of(
    "firmware/boards/uno/uart.c",
    (
        "a reply that does not fit is sent in part",
        "uart_send",
        "if (n == 0u || n > free) {",
        "if (n == 0u || free == 0u) {",
        _link("test_more_replies_than_there_is_room_for_are_left_out_whole"),
    ),
    (
        "a full queue is overwritten",
        "USART_RX_vect",
        "if (next != received.out) {",
        "if (true) {",
        _link("test_bytes_that_find_no_room_are_lost_and_not_those_before_them"),
    ),
    (
        "the wire is at half its speed",
        "uart_init",
        "    UCSR0A = BIT(U2X0);\n",
        "    UCSR0A = 0;\n",
        _link("test_a_reply_takes_the_time_of_its_bits"),
    ),
)

HOST = of(
    "firmware/boards/host/device.c",
    (
        "the clock's error is left out",
        "clock_rate",
        "1.0 + 1e-6 * d->bench.p.clock_error_ppm",
        "1.0 + 0.0 * d->bench.p.clock_error_ppm",
        in_file("tests/hil/test_hil_driver.py", "test_the_devices_clock_is_found"),
    ),
)

VIRTUAL = of(
    "firmware/boards/host/virtual.c",
    (
        "a hung board is never reset",
        "virtual_run",
        "b->hung ? b->fed_ns + HARDWARE_WATCHDOG_NS : INT64_MAX",
        "b->hung ? INT64_MAX : INT64_MAX",
        in_file("tests/hil/test_hil_safety.py", "test_a_hung_firmware_is_reset_by_the_hardware_watchdog"),
    ),
)

MUTANTS = (*INPUTS, *MAIN, *BRIDGE, *CLOCK, *ADC, *UART, *HOST, *VIRTUAL)
