/* Any bytes, ticks, readings and contacts in any order into the whole core. A witness, which sees only what goes over
 * the wire and what the board measures, holds it to the promises of rig_core.h after every call.
 *
 * An input is the board's byte (see `power_on`), then steps: the lower three bits of a step's first byte say which of
 * `enum step`, the upper five are its `n`. tools/fuzz_corpus.py writes the same.
 */
#include "reference.h"
#include "request.h"
#include "rig_core.h"

enum step {
    STEP_TICKS,    /* n + 1 ticks of 1 ms */
    STEP_WAIT,     /* u8: 16 us each, no tick */
    STEP_READING,  /* i32 counts, cut to the board's range */
    STEP_CONTACTS, /* n: RIG_INPUT_* */
    STEP_FRAME,    /* u8 bytes of content; its CRC and stuffing are put in */
    STEP_DAMAGED,  /* u8 bytes, u8 where, u8 which bits change, then as STEP_FRAME */
    STEP_RAW,      /* n bytes as they are */
    STEP_BOARD     /* n & 1: the board has time to stream from now on; n & 2: it is reset; n >> 2: RIG_ENCODER_* found */
};

#define RECOVERED_COUNTS 3
#define LAG_US 500u
#define REACH 0x100000 /* counts from the centre, without limits */
#define ENCODER_FAULTS (1u << RIG_E_ENCODER_LOST | 1u << RIG_E_ENCODER_RATE | 1u << RIG_E_ENCODER_STILL)
#define OUTWARD_DIVISOR 32 /* of the hard range: so far out is a wrong polarity */

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static struct {
    uint32_t now_us;
    int32_t counts;
    uint8_t inputs;
    uint8_t troubles; /* of an encoder, that the core has not asked for yet */
    bool streams;
    int16_t pin;
    unsigned drives, replies, blocks; /* since the last call into the core */
    reference_line to_host, to_device;
    uint8_t reply[FRAME_CONTENT_MAX]; /* the last that was no block */
    size_t reply_length;
    bool held, in_tick;
} board;

/* What may be, from what the device was told and said. */
static struct {
    bool set_up;
    bool permitted;  /* armed, and nothing since that ends it */
    int recovering;  /* the end at which it was armed, +1 or -1, or 0 */
    int32_t outmost; /* counts, while recovering: as far out as it was without a drive */
    int32_t hard_lo, hard_hi, rail_lo, rail_hi, centre;
    bool homing;
    bool has_zero;    /* of an encoder */
    bool estop_tried; /* its board */
    uint16_t max_drive, law_max_drive, watchdog_ms;
    uint32_t session, law_session;
    unsigned latched; /* bits of what must not be forgotten until it is acknowledged */
    bool positive_raises;
    uint32_t t_voice_us; /* of the last frame that may keep up a drive */
    bool pulsing; /* P16 */
    uint32_t t_pulse_us;
    uint32_t pulse_us;
    struct {
        bool run; /* else the relay, about `relay_centre` */
        uint8_t body[56];        /* as they were confirmed */
        int way;                 /* of the drive at the last tick: +1, -1 or 0 */
        unsigned one_way;        /* ticks in a row that it drives this way */
        int32_t counts;          /* at the last tick */
        unsigned still;          /* ticks in a row in which the reading did not change and no stroke could turn */
    } strokes;
    int32_t relay_centre; /* counts */
} witness;

static rig_core core;
static rig_core seen; /* after the last tick or held section: what they share changes nowhere else */
static rig_board hardware;

static unsigned size_of(int units)
{
    return (unsigned)(units < 0 ? -units : units);
}

/* ---- the board ---- */

static uint32_t give_micros(void *context)
{
    (void)context;
    return board.now_us;
}

/* Frames of a board that lags have waited. */
static uint32_t give_arrival(void *context)
{
    return give_micros(context) - LAG_US;
}

static int32_t give_position(void *context, uint32_t *t_us)
{
    (void)context;
    REQUIRE(board.held || board.in_tick);
    *t_us = board.now_us - 60u;
    return board.counts;
}

static uint16_t give_tachometer(void *context)
{
    (void)context;
    return RIG_TACH_NONE;
}

static uint8_t give_inputs(void *context)
{
    (void)context;
    if ((board.inputs & RIG_INPUT_ESTOP) != 0u) {
        witness.estop_tried = true;
    }
    return board.inputs;
}

static bool counts_an_encoder(void)
{
    return hardware.set_position != NULL;
}

static void take_position(void *context, int32_t counts)
{
    (void)context;
    REQUIRE(board.held && !core.armed && board.pin == 0); /* positions never change under drive */
    board.counts = counts;
    witness.has_zero = true;
}

/* P13: what is found ends the zero and latches. */
static uint8_t give_troubles(void *context)
{
    const unsigned found = board.troubles;
    (void)context;
    board.troubles = 0;
    witness.latched |= (found & RIG_ENCODER_LOST) != 0u ? 1u << RIG_E_ENCODER_LOST : 0u;
    witness.latched |= (found & RIG_ENCODER_RATE) != 0u ? 1u << RIG_E_ENCODER_RATE : 0u;
    witness.latched |= (found & RIG_ENCODER_STILL) != 0u ? 1u << RIG_E_ENCODER_STILL : 0u;
    witness.has_zero = witness.has_zero && found == 0u;
    return (uint8_t)found;
}

static uint8_t give_supply(void *context)
{
    (void)context;
    return 153;
}

static void take_drive(void *context, int16_t units)
{
    (void)context;
    REQUIRE(board.held || board.in_tick);
    REQUIRE(size_of(units) <= hardware.drive_full);
    board.pin = units;
    board.drives++;
}

static void require_unchanged(void)
{
    REQUIRE(!board.held && !board.in_tick);
    memcpy(&seen.rx, &core.rx, sizeof core.rx); /* the main loop's own */
    REQUIRE(memcmp(&seen, &core, sizeof core) == 0);
}

static void hold_tick(void *context)
{
    (void)context;
    require_unchanged();
    board.held = true;
}

static void release_tick(void *context)
{
    (void)context;
    REQUIRE(board.held);
    board.held = false;
    memcpy(&seen, &core, sizeof core);
}

/* A block's rows tell drives that were allowed. */
static void look_at_block(const uint8_t *content, size_t n)
{
    REQUIRE(n >= FRAME_HEADER + 18u && (n - FRAME_HEADER - 18u) % 4u == 0u);
    REQUIRE(u32(content + FRAME_HEADER + 10u) == witness.law_session); /* its last one may wait until after a SETUP */
    for (size_t at = FRAME_HEADER + 18u; at < n; at += 4u) {
        REQUIRE(size_of((int16_t)u16(content + at + 2)) <= witness.law_max_drive);
    }
    board.blocks++;
}

static void take_bytes(void *context, const uint8_t *bytes, uint8_t n)
{
    uint8_t content[FRAME_CONTENT_MAX];
    (void)context;
    REQUIRE(n > 0u && n <= FRAME_WIRE_MAX);
    for (uint8_t i = 0; i < n; i++) {
        const size_t length = reference_receive(&board.to_host, bytes[i], content);
        REQUIRE((length != 0u) == (i + 1u == n)); /* one whole frame a call */
        if (length != 0u && content[1] == RIG_BLOCK) {
            look_at_block(content, length);
        } else if (length != 0u) {
            memcpy(board.reply, content, length);
            board.reply_length = length;
            board.replies++;
        }
    }
}

/* ---- the promises ---- */

static bool is_high(void)
{
    return board.counts > witness.hard_hi || (board.inputs & RIG_INPUT_END_HIGH) != 0u;
}

static bool is_low(void)
{
    return board.counts < witness.hard_lo || (board.inputs & RIG_INPUT_END_LOW) != 0u;
}

static int end(void)
{
    if (is_high()) {
        return 1;
    }
    return is_low() ? -1 : 0;
}

/* A sample was taken: without a drive the shaft may still coast outward. */
static void note_sample(void)
{
    const bool out = witness.recovering > 0 ? board.counts > witness.outmost : board.counts < witness.outmost;
    if (board.pin == 0 && out) {
        witness.outmost = board.counts;
    }
}

static bool is_in_the_way(unsigned code)
{
    switch (code) {
    case RIG_E_ESTOP:
        return (board.inputs & RIG_INPUT_ESTOP) != 0u;
    case RIG_E_SENSOR:
        return witness.set_up && !counts_an_encoder() &&
               (board.counts <= witness.rail_lo || board.counts >= witness.rail_hi);
    case RIG_E_END_SWITCH:
        return witness.set_up && is_high() && is_low();
    default:
        return false;
    }
}

/* P10: the contacts and the sensor were looked at. */
static void note_look(void)
{
    for (unsigned code = RIG_E_ESTOP; code <= RIG_E_END_SWITCH; code++) {
        witness.latched |= is_in_the_way(code) ? 1u << code : 0u;
    }
    witness.latched |= is_in_the_way(RIG_E_SENSOR) ? 1u << RIG_E_SENSOR : 0u;
}

static bool is_endless(void)
{
    return witness.hard_lo == INT32_MIN && witness.hard_hi == INT32_MAX;
}

/* As far as a law can count. */
static bool is_within_reach(int32_t centre, int32_t counts)
{
    const int64_t away = (int64_t)counts - (int64_t)centre;
    return away < REACH && away > -REACH;
}

/* After any call. */
static void hold(void)
{
    if (core.latched != 0u) {
        witness.permitted = false; /* P7: until ACK and ARM */
    }
    REQUIRE((witness.latched & ~(unsigned)core.latched) == 0u); /* P10 */
    witness.latched = core.latched;
    REQUIRE((core.latched == 0u) || (core.latched & (1u << core.fault)) != 0u); /* one of them is told */
    REQUIRE(core.setup.session == witness.session);                             /* P11 */
    REQUIRE(board.pin == core.drive);
    REQUIRE(!core.armed || witness.permitted);
    REQUIRE(!core.running || core.armed);
    if (board.pin != 0) {
        REQUIRE(witness.set_up && witness.permitted && core.armed); /* P1, P7 */
        REQUIRE(size_of(board.pin) <= witness.max_drive);           /* P2 */
    }
    if (core.running) {
        REQUIRE(core.relay.z <= core.relay.setup.z_bound && core.relay.z >= -core.relay.setup.z_bound);
        REQUIRE(core.blocks.ring[core.blocks.in].n < core.blocks.rows && core.blocks.rows <= BLOCK_ROWS_MAX);
    }
}

/* After a tick: what it has sampled ends a drive that it forbids. */
static void hold_after_tick(void)
{
    note_look();
    hold();
    if (end() == 0 && (int64_t)board.counts > (int64_t)witness.hard_lo + RECOVERED_COUNTS &&
        (int64_t)board.counts + RECOVERED_COUNTS < (int64_t)witness.hard_hi) {
        witness.recovering = 0;
    }
    note_sample();
    if (board.pin == 0) {
        return;
    }
    REQUIRE(board.now_us - witness.t_voice_us < witness.watchdog_ms * 1000u);                  /* P3 */
    REQUIRE(!witness.pulsing || board.now_us - witness.t_pulse_us < witness.pulse_us);         /* P16 */
    REQUIRE(!is_in_the_way(RIG_E_SENSOR));                                                     /* P5 */
    REQUIRE((board.inputs & RIG_INPUT_ESTOP) == 0u);                                           /* P9 */
    REQUIRE(end() == witness.recovering || end() == 0);                                        /* P4, P9 */
    REQUIRE(witness.has_zero || witness.homing || !counts_an_encoder());                       /* P13 */
    REQUIRE(witness.estop_tried || !is_endless() || !counts_an_encoder());                     /* P14 */
    if (core.running && is_endless()) {
        REQUIRE(is_within_reach(witness.strokes.run ? witness.centre : witness.relay_centre, board.counts));
    }
    const bool raises = (board.pin > 0) == witness.positive_raises;
    REQUIRE(raises ? !is_high() : !is_low()); /* P6: never further out, nor does the shaft go there */
    if (witness.recovering != 0) {
        const int64_t outward = witness.recovering * ((int64_t)board.counts - (int64_t)witness.outmost);
        REQUIRE(outward <= ((int64_t)witness.hard_hi - (int64_t)witness.hard_lo) / OUTWARD_DIVISOR);
    }
}

static int stroke_drive(unsigned i)
{
    return (int16_t)u16(witness.strokes.body + 8 + 6 * i);
}

static int32_t stroke_turn(unsigned i)
{
    return (int32_t)u32(witness.strokes.body + 10 + 6 * i);
}

static bool may_turn_at(int32_t counts)
{
    for (unsigned i = 0; i < witness.strokes.body[0]; i++) {
        const bool rises = (stroke_drive(i) > 0) == witness.positive_raises;
        if (rises ? counts >= stroke_turn(i) : counts <= stroke_turn(i)) {
            return true;
        }
    }
    return false;
}

static bool is_of_a_stroke(int units)
{
    for (unsigned i = 0; i < witness.strokes.body[0]; i++) {
        if (units == stroke_drive(i)) {
            return true;
        }
    }
    return units == 0;
}

/* P12, after a tick. */
static void hold_strokes(void)
{
    if (!core.running || !witness.strokes.run) {
        return;
    }
    const int way = (board.pin > 0) - (board.pin < 0);
    REQUIRE(is_of_a_stroke(board.pin));
    witness.strokes.one_way = way == witness.strokes.way ? witness.strokes.one_way + 1u : 1u;
    REQUIRE(way == 0 || witness.strokes.one_way <= u16(witness.strokes.body + 2) + 1u);
    const bool is_still = board.counts == witness.strokes.counts && !may_turn_at(board.counts);
    witness.strokes.still = is_still ? witness.strokes.still + 1u : 0u;
    REQUIRE(way == 0 || witness.strokes.still <= 2u * (u16(witness.strokes.body + 4) + 2u));
    witness.strokes.way = way;
    witness.strokes.counts = board.counts;
}

/* ---- requests and their answers ---- */

static void note_setup(const uint8_t *body)
{
    witness.set_up = true;
    witness.session = u32(body);
    witness.hard_lo = (int32_t)u32(body + 4);
    witness.hard_hi = (int32_t)u32(body + 8);
    witness.rail_lo = (int32_t)u32(body + 12);
    witness.rail_hi = (int32_t)u32(body + 16);
    witness.centre = (int32_t)u32(body + 20);
    witness.max_drive = u16(body + 24);
    witness.watchdog_ms = u16(body + 26);
    witness.positive_raises = body[28] == 1u;
    witness.homing = body[29] == 1u;
    witness.has_zero = witness.has_zero && !witness.homing; /* P13 */
    REQUIRE(memcmp(board.reply + FRAME_HEADER, body, 30) == 0); /* what is stored is what was sent */
    REQUIRE(witness.hard_lo < witness.hard_hi && witness.rail_lo >= 0 && witness.rail_hi <= hardware.counts_max);
    REQUIRE(body[29] <= (counts_an_encoder() ? 1u : 0u) && !(witness.homing && is_endless()));
    REQUIRE(witness.session != 0u);
    REQUIRE(witness.max_drive >= 1u && witness.max_drive <= hardware.drive_full);
    REQUIRE(witness.watchdog_ms >= 1u && witness.watchdog_ms <= RIG_WATCHDOG_MAX_MS);
}

static void note_strokes(const uint8_t *body)
{
    REQUIRE(memcmp(board.reply + FRAME_HEADER, body, sizeof witness.strokes.body) == 0); /* what runs is what was sent */
    memcpy(witness.strokes.body, body, sizeof witness.strokes.body);
    REQUIRE(body[0] >= 2u && body[0] <= STROKES_MAX);
    for (unsigned i = 0; i < body[0]; i++) {
        REQUIRE(size_of(stroke_drive(i)) <= witness.max_drive); /* P2 */
        REQUIRE(stroke_drive(i) != 0 && ((stroke_drive(i) > 0) == (stroke_drive(0) > 0)) == (i % 2u == 0u));
        REQUIRE(stroke_turn(i) >= witness.hard_lo && stroke_turn(i) <= witness.hard_hi);
        REQUIRE(!is_endless() || is_within_reach(witness.centre, stroke_turn(i)));
    }
    witness.strokes.run = true;
    witness.strokes.way = 0;
    witness.strokes.one_way = 0;
    witness.strokes.still = 0;
    witness.strokes.counts = board.counts;
}

static void note_state(void)
{
    const uint8_t *body = board.reply + FRAME_HEADER;
    REQUIRE(board.reply_length == FRAME_HEADER + 24u);
    REQUIRE((int32_t)u32(body + 4) == board.counts && (int16_t)u16(body + 14) == board.pin);
    REQUIRE(((body[18] & RIG_STATUS_ARMED) != 0u) == core.armed);
    REQUIRE(u32(body + 20) == witness.session);
    REQUIRE(((body[18] & RIG_STATUS_ZERO) != 0u) == witness.has_zero);
    REQUIRE(((body[18] & RIG_STATUS_ESTOP_TRIED) != 0u) == (witness.estop_tried && counts_an_encoder()));
}

static uint32_t arrival(void)
{
    return hardware.arrived_us != NULL ? board.now_us - LAG_US : board.now_us;
}

/* The time of a pulse counts from the first PULSE after a DRIVE: P16. */
static void note_pulse(bool pulse, const uint8_t *body)
{
    const bool begins = pulse && !witness.pulsing && core.armed;
    witness.pulsing = pulse && (witness.pulsing || begins);
    if (begins) {
        witness.t_pulse_us = board.now_us;
        witness.pulse_us = u16(body + 2) * 1000u;
    }
}

/* A valid frame went in: what it was, what came back, and what that permits. */
static void note_request(const uint8_t *content, size_t n, bool was_armed, bool was_running)
{
    const uint8_t type = content[1];
    const bool whole = content[0] == RIG_PROTOCOL;
    const bool drives = (type == RIG_DRIVE && n == FRAME_HEADER + 2u) || (type == RIG_PULSE && n == FRAME_HEADER + 4u);
    const bool is_silent = whole && (drives || (type == RIG_KEEP && n == FRAME_HEADER));
    REQUIRE(board.replies == (is_silent ? 0u : 1u));
    if (is_silent) {
        if (drives || was_running) {
            witness.t_voice_us = arrival();
        }
        if (drives) {
            note_pulse(type == RIG_PULSE, content + FRAME_HEADER);
        }
        return;
    }
    REQUIRE(memcmp(board.reply + 2, content + 2, 2) == 0); /* its seq */
    switch (board.reply[1]) {
    case RIG_NACK:
        REQUIRE(board.reply[FRAME_HEADER + 1u] == type && (board.drives == 0u || type == RIG_ACK));
        return;
    case RIG_SETUP | RIG_REPLY:
        REQUIRE(!was_armed);
        note_setup(content + FRAME_HEADER);
        break;
    case RIG_ARM | RIG_REPLY:
        note_look();
        witness.permitted = board.reply[FRAME_HEADER] == RIG_OK;
        REQUIRE(!witness.permitted || (witness.set_up && witness.latched == 0u)); /* P1, P7, P10 */
        REQUIRE(!witness.permitted || u32(content + FRAME_HEADER) == witness.session); /* P11 */
        REQUIRE(!witness.permitted || !counts_an_encoder() || witness.has_zero || witness.homing); /* P13 */
        REQUIRE(!witness.permitted || !counts_an_encoder() || witness.estop_tried || !is_endless()); /* P14 */
        witness.recovering = end();
        witness.outmost = board.counts;
        witness.t_voice_us = arrival();
        witness.pulsing = false;
        REQUIRE(board.pin == 0);
        break;
    case RIG_RELAY | RIG_REPLY:
    case RIG_STROKES | RIG_REPLY:
        REQUIRE(was_armed && !was_running && core.running && !witness.homing);
        witness.law_session = witness.session;
        witness.law_max_drive = witness.max_drive;
        witness.relay_centre = (int32_t)u32(content + FRAME_HEADER + 8u) / 16;
        witness.t_voice_us = arrival();
        witness.strokes.run = false;
        witness.pulsing = false;
        if (type == RIG_STROKES) {
            note_strokes(content + FRAME_HEADER);
        }
        break;
    case RIG_ACK | RIG_REPLY:
        REQUIRE(!is_in_the_way(content[FRAME_HEADER]));
        witness.latched &= ~(1u << content[FRAME_HEADER]);
        note_state();
        note_look();
        break;
    case RIG_ZERO | RIG_REPLY:
        REQUIRE(counts_an_encoder() && !was_armed && board.counts == (int32_t)u32(content + FRAME_HEADER));
        REQUIRE((witness.latched & ENCODER_FAULTS) == 0u); /* P13 */
        note_state(); /* it has looked at the count before; the next look is at the one that it was told */
        break;
    case RIG_STOP | RIG_REPLY:
        witness.permitted = false;
        witness.pulsing = false;
        REQUIRE(board.pin == 0);
        note_state();
        note_look();
        break;
    case RIG_READ | RIG_REPLY:
        note_state();
        note_look();
        note_sample();
        break;
    default:
        REQUIRE(board.reply[1] == (RIG_HELLO | RIG_REPLY));
        break;
    }
    REQUIRE(whole && board.reply[1] == (type | RIG_REPLY));
}

/* ---- steps ---- */

static void before_call(void)
{
    board.drives = 0;
    board.replies = 0;
    board.blocks = 0;
}

static void let_stream(void)
{
    if (board.streams) {
        before_call();
        rig_stream(&core);
        REQUIRE(board.drives == 0u && board.replies == 0u && board.blocks <= 1u);
    }
}

static void send_byte(uint8_t byte)
{
    static rig_core before;
    uint8_t content[FRAME_CONTENT_MAX];
    memcpy(&before, &core, sizeof core);
    before_call();
    const size_t n = reference_receive(&board.to_device, byte, content);
    rig_byte(&core, byte);
    if (n != 0u) {
        note_request(content, n, before.armed, before.running);
    } else {
        memcpy(&before.rx, &core.rx, sizeof core.rx);
        REQUIRE(memcmp(&before, &core, sizeof core) == 0); /* P8 */
        REQUIRE(board.drives == 0u && board.replies == 0u && board.blocks == 0u);
    }
    hold();
    let_stream();
}

static void send_frame(const uint8_t *content, size_t n, size_t damage_at, uint8_t damage)
{
    uint8_t wire[FRAME_WIRE_MAX];
    const uint8_t length = frame_encode(content, (uint8_t)n, wire);
    if (length == 0u) {
        return;
    }
    wire[damage_at % length] ^= damage;
    for (uint8_t i = 0; i < length; i++) {
        send_byte(wire[i]);
    }
}

static void tick(void)
{
    board.now_us += RIG_TICK_US;
    before_call();
    require_unchanged();
    board.in_tick = true;
    rig_tick(&core);
    board.in_tick = false;
    memcpy(&seen, &core, sizeof core);
    REQUIRE(board.replies == 0u && board.blocks == 0u);
    hold_after_tick();
    hold_strokes();
    let_stream();
}

static void reset(void)
{
    memset(&witness, 0, sizeof witness);
    witness.latched = 1u << RIG_E_RESET;
    board.pin = 77; /* whatever the pin was */
    board.to_device.n = 0;
    board.held = true; /* no tick before it is done */
    rig_init(&core, &hardware, RIG_RESET_EXTERNAL);
    board.held = false;
    memcpy(&seen, &core, sizeof core);
    REQUIRE(board.pin == 0); /* P1 */
    hold();
}

static void power_on(uint8_t choice)
{
    static const int32_t counts_max[4] = {1023, 4095, 0x7FFFFFFF, 255};
    static const uint16_t drive_full[2] = {799, 32767};
    memset(&board, 0, sizeof board);
    memset(&core, 0, sizeof core); /* so that padding compares */
    hardware.micros = give_micros;
    hardware.position = give_position;
    hardware.tach_counts = give_tachometer;
    hardware.set_drive = take_drive;
    hardware.transmit = take_bytes;
    hardware.hold_tick = hold_tick;
    hardware.release_tick = release_tick;
    hardware.build = "fuzz";
    hardware.board_id = RIG_BOARD_HOST;
    hardware.counts_max = counts_max[choice & 3u];
    hardware.inputs = (choice & 4u) != 0u ? give_inputs : NULL;
    hardware.supply = (choice & 8u) != 0u ? give_supply : NULL;
    board.now_us = (choice & 16u) != 0u ? 0xFFFFFFFFu - 20000u : 5000u;
    hardware.arrived_us = (choice & 32u) != 0u ? give_arrival : NULL;
    hardware.drive_full = drive_full[(choice >> 6) & 1u];
    hardware.set_position = NULL;
    hardware.encoder_troubles = NULL;
    if ((choice & 128u) != 0u) {
        hardware.counts_max = 0; /* it counts in 32 bits */
        hardware.set_position = take_position;
        hardware.encoder_troubles = give_troubles;
    }
    board.counts = hardware.counts_max / 2;
    board.streams = true;
    reset();
}

/* The next `n` bytes of the input, or as many as are left; `*data` goes behind them. */
static size_t take(const uint8_t **data, size_t *left, size_t n, const uint8_t **taken)
{
    const size_t got = n < *left ? n : *left;
    *taken = *data;
    *data += got;
    *left -= got;
    return got;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static const uint8_t arguments[] = {0, 1, 4, 0, 1, 3, 0, 0}; /* bytes after the first, by step */
    const uint8_t *first, *argument, *bytes;
    if (take(&data, &size, 1, &first) == 0u) {
        return 0;
    }
    power_on(*first);
    while (take(&data, &size, 1, &first) == 1u) {
        const unsigned step = *first & 7u;
        const unsigned n = (unsigned)*first >> 3;
        size_t length;
        if (take(&data, &size, arguments[step], &argument) < arguments[step]) {
            return 0;
        }
        switch (step) {
        case STEP_TICKS:
            for (unsigned i = 0; i <= n; i++) {
                tick();
            }
            break;
        case STEP_WAIT:
            board.now_us += 16u * argument[0];
            break;
        case STEP_READING:
            board.counts = (int32_t)(u32(argument) & (counts_an_encoder() ? UINT32_MAX : (uint32_t)hardware.counts_max));
            break;
        case STEP_CONTACTS:
            board.inputs = hardware.inputs != NULL ? (uint8_t)n : 0u;
            break;
        case STEP_FRAME:
        case STEP_DAMAGED:
            length = take(&data, &size, argument[0], &bytes);
            send_frame(bytes, length, step == STEP_DAMAGED ? argument[1] : 0u, step == STEP_DAMAGED ? argument[2] : 0u);
            break;
        case STEP_RAW:
            length = take(&data, &size, n, &bytes);
            for (size_t i = 0; i < length; i++) {
                send_byte(bytes[i]);
            }
            break;
        default: /* STEP_BOARD */
            board.streams = (n & 1u) != 0u;
            board.troubles |= counts_an_encoder() ? (uint8_t)(n >> 2) : 0u;
            if ((n & 2u) != 0u) {
                reset();
            }
            break;
        }
    }
    return 0;
}
