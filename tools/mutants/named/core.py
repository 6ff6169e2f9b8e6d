"""Defects of the firmware's core: each promise P1 to P9 broken, and the relay's."""

from __future__ import annotations

from mutants.named.writing import of, row

_CORE = ("firmware/tests/test_rig_core.c",)
_RELAY_CORE = ("firmware/tests/test_rig_relay.c",)
_FRAMES = ("firmware/tests/test_frames.c",)
_RELAY = ("firmware/tests/test_relay.c",)

CORE = of(
    "firmware/core/rig_core.c",
    ("P1: it arms without a set-up", "arm", "if (!core->has_setup) {", "if (false) {", _CORE),
    (
        "P1: arming keeps the drive",
        "arm",
        "    disarm(core); /* arming starts from drive 0, also when already armed */\n",
        "",
        _CORE,
    ),
    ("P1: it drives unarmed", "on_drive", "if (!core->armed) {", "if (false) {", _CORE),
    (
        "P2: more than the largest drive reaches the pin",
        "on_drive",
        "if (units > most || units < -most) {",
        "if (false && units > most) {",
        _CORE,
    ),
    (
        "P2: more negative drive than the largest reaches the pin",
        "on_drive",
        " || units < -most",
        "",
        _CORE,
    ),
    (
        "P3: watchdog off",
        "rig_tick",
        "if (silent_us >= core->setup.watchdog_ms * US_PER_MS) {",
        "if (false && silent_us != 0u) {",
        _CORE + row("host SIGKILL", "board"),
    ),
    (
        "P3: the watchdog takes twice its time",
        "rig_tick",
        "core->setup.watchdog_ms * US_PER_MS",
        "2u * core->setup.watchdog_ms * US_PER_MS",
        _CORE,
    ),
    (
        "P3: READ keeps a drive alive",
        "act_on",
        "if (core->drive == 0 && !core->relaying) {",
        "if (true) {",
        _CORE,
    ),
    ("P3: DRIVE keeps nothing alive", "act_on", "        heard(core);\n        on_drive(", "        on_drive(", _CORE),
    (
        "P3: KEEP keeps any drive alive",
        "act_on",
        "if (core->relaying) {\n            heard(core); /* P3: it keeps nothing else alive */",
        "if (true) {\n            heard(core); /* P3: it keeps nothing else alive */",
        _RELAY_CORE,
    ),
    (
        "P3: KEEP keeps no relay alive",
        "act_on",
        "            heard(core); /* P3: it keeps nothing else alive */\n",
        "",
        _RELAY_CORE,
    ),
    (
        "P3: the host's voice counts from when the core comes to it",
        "heard",
        "board->arrived_us != NULL ? board->arrived_us(board->context) : board->micros(board->context);",
        "board->micros(board->context);",
        _CORE,
    ),
    (
        "P4: limit rule off",
        "sample",
        "    if (side(core) != 0) {\n        const bool by_switch",
        "    if (false) {\n        const bool by_switch",
        _CORE,
    ),
    ("P4: limit of the high end off", "is_high", "core->counts > core->setup.hard_hi || ", "", _CORE),
    ("P4: limit of the low end off", "is_low", "core->counts < core->setup.hard_lo || ", "", _CORE),
    ("P4: limits only where somebody asks", "rig_tick", "    sample(core); /* P4, P5 */\n", "", _CORE),
    (
        "P5: rail off",
        "at_rail",
        "return core->counts <= core->setup.rail_lo || core->counts >= core->setup.rail_hi;",
        "return core->counts > core->board->adc_max;",
        _CORE,
    ),
    ("P5: low rail off", "at_rail", "core->counts <= core->setup.rail_lo || ", "", _CORE),
    (
        "P6: recovering, drive outward passes",
        "on_drive",
        "if (core->recovering != 0 && units != 0 && raises == is_above) {",
        "if (false && raises == is_above) {",
        _CORE,
    ),
    ("P6: recovering is forgotten", "arm", "core->recovering = side(core); /* P6 */", "core->recovering = 0;", _CORE),
    (
        "P6: recovering, motion outward passes",
        "sample",
        "if (moves_outward(core)) {",
        "if (moves_outward(core) && false) {",
        _CORE,
    ),
    (
        "P6: the relay starts beyond a limit",
        "start_relay",
        "if (core->recovering != 0) {",
        "if (false) {",
        _RELAY_CORE,
    ),
    ("P7: a fault does not latch", "latch", "    core->latched = true;\n", "", _CORE),
    ("P7: a fault leaves the drive on", "latch", "    disarm(core);\n", "    core->armed = false;\n", _CORE),
    ("P7: a fault leaves it armed", "disarm", "    core->armed = false;\n", "", _CORE),
    ("P8: an unknown version is obeyed", "on_request", "if (content[0] != RIG_PROTOCOL) {", "if (false) {", _CORE),
    (
        "P8: a body of the wrong length is obeyed",
        "on_request",
        "else if (n != FRAME_HEADER + (uint8_t)expected) {",
        "else if (n < FRAME_HEADER + (uint8_t)expected) {",
        _CORE,
    ),
    ("P9: e-stop off", "obstacle", "if (is_set(core, RIG_INPUT_ESTOP)) {", "if (false) {", _CORE),
    ("P9: end switch of the high end off", "is_high", " || is_set(core, RIG_INPUT_END_HIGH)", "", _CORE),
    ("P9: end switch of the low end off", "is_low", " || is_set(core, RIG_INPUT_END_LOW)", "", _CORE),
    (
        "P9: both end switches are no fault",
        "obstacle",
        "return is_high(core) && is_low(core) ? RIG_E_END_SWITCH : RIG_OK;",
        "return RIG_OK;",
        _CORE,
    ),
    (
        "limits change under drive",
        "on_setup",
        "if (core->armed || !is_valid(&wanted, core->board)) {",
        "if (!is_valid(&wanted, core->board)) {",
        _CORE,
    ),
    (
        "a set-up that voids a promise is taken",
        "on_setup",
        " || !is_valid(&wanted, core->board)",
        "",
        _CORE,
    ),
    ("STOP leaves the drive on", "on_stop", "    disarm(core);\n", "    core->armed = false;\n", _CORE),
    ("STOP leaves it armed", "on_stop", "    disarm(core);\n", "    act(core, 0);\n", _CORE),
    (
        "the state tells the drive before last",
        "act",
        "    core->drive = units;\n",
        "    core->drive = units != 0 ? units : core->drive;\n",
        _CORE,
    ),
    (
        "the relay's drives may be beyond the largest",
        "start_relay",
        "if (wanted->drive[i] > most || wanted->drive[i] < -most) {",
        "if (wanted->drive[i] > most + 1000) {",
        _RELAY_CORE,
    ),
    (
        "a relay may push outward",
        "start_relay",
        "if (!is_inward(core, wanted)) {",
        "if (!is_inward(core, wanted) && false) {",
        _RELAY_CORE,
    ),
    (
        "the relay starts unarmed",
        "start_relay",
        "    if (!core->armed) {\n",
        "    if (core->latched) {\n",
        _RELAY_CORE,
    ),
    (
        "the relay's gains change while it runs",
        "start_relay",
        "core->relaying || !relay_is_valid",
        "!relay_is_valid",
        _RELAY_CORE,
    ),
    (
        "the relay drives on after a fault",
        "relay_tick",
        "    if (core->armed) {\n",
        "    if (core->relaying) {\n",
        _RELAY_CORE,
    ),
    (
        "the relay goes on after DRIVE",
        "on_drive",
        "        end_relay(core); /* the host takes over, without a gap in the drive */\n",
        "",
        _RELAY_CORE,
    ),
    (
        "a block that breaks the grid goes on",
        "relay_tick",
        "if (blocks_breaks_grid(&core->blocks, core->t_sample_us)) {",
        "if (false) {",
        _RELAY_CORE,
    ),
    (
        "requests are not kept apart from the tick",
        "on_request",
        "        hold(core);\n        act_on(",
        "        act_on(",
        _RELAY_CORE,
    ),
)

FRAMES = of(
    "firmware/core/frames.c",
    (
        "P8: the CRC is not checked",
        "check",
        "return sent == frame_crc16(bytes, content) ? content : 0u;",
        "return sent == sent + 1u ? 0u : content;",
        _FRAMES + _CORE,
    ),
    (
        "P8: a frame that is too long is cut",
        "frame_receive",
        "            rx->overflow = true; /* longer than any frame: dropped when its end comes */\n",
        "            rx->length = 0;\n",
        _FRAMES,
    ),
    (
        "P8: a code that points past the end is followed",
        "cobs_decode",
        "if (code - 1u > (uint8_t)(n - in)) {",
        "if (code == 0u) {",
        _FRAMES,
    ),
)

RELAY = of(
    "firmware/core/relay.c",
    (
        "the relay forgets its sign at zero",
        "keep_sign",
        "return value < 0 ? (int8_t)-1 : before;",
        "return before == 2 ? before : (int8_t)-1;",
        _RELAY,
    ),
    (
        "the relay's integral has no bound",
        "integrate",
        "r->z = within(sum, r->setup.z_bound);",
        "r->z = within(sum, RELAY_Z_MAX);",
        _RELAY,
    ),
    (
        "a falling sensor is taken for a rising one",
        "relay_step",
        "r->setup.direction > 0 ? above : -above",
        "r->setup.direction != 0 ? above : -above",
        _RELAY,
    ),
    ("the integral is of rectangles", "integrate", "r->z + r->y + y", "r->z + y + y", _RELAY),
)

BLOCKS = of(
    "firmware/core/blocks.c",
    (
        "a full ring overwrites what was not sent",
        "blocks_close",
        "if (next != b->out) {",
        "if (true) {",
        _RELAY_CORE,
    ),
    (
        "a lost block is not counted",
        "blocks_close",
        "    begin(&b->ring[b->in], number);\n",
        "    begin(&b->ring[b->in], next != b->out ? number : (uint16_t)(number - 1u));\n",
        _RELAY_CORE,
    ),
)

MUTANTS = (*CORE, *FRAMES, *RELAY, *BLOCKS)
