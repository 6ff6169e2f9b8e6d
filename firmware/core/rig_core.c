#include "rig_core.h"

#include <stddef.h>

#define US_PER_MS 1000UL
#define SETUP_LENGTH 30u
#define ARM_LENGTH 4u
#define ACK_LENGTH 1u
#define DRIVE_LENGTH 2u
#define RELAY_LENGTH 18u
#define STROKES_LENGTH 56u /* room for STROKES_MAX strokes */
#define ZERO_LENGTH 4u
#define LOOPBACK_LENGTH 1u
#define PULSE_LENGTH 4u

/* Recovered means farther inside than this, so that noise on the limit does not latch a fault at once. */
#define RECOVERED_COUNTS 3u
/* Under inward drive the shaft may lie this part of the hard range farther out before it counts as polarity. */
#define POLARITY_DIVISOR 32u

/* ---- the tick may be an interrupt, which what it shares is kept from ---- */

static void hold(const rig_core *core)
{
    if (core->board->hold_tick != NULL) {
        core->board->hold_tick(core->board->context);
    }
}

static void release(const rig_core *core)
{
    if (core->board->release_tick != NULL) {
        core->board->release_tick(core->board->context);
    }
}

/* ---- little-endian fields ---- */

static uint16_t get_u16(const uint8_t *at)
{
    return (uint16_t)(at[0] | ((uint16_t)at[1] << 8));
}

/* Two's complement without the implementation-defined cast. */
static int16_t get_i16(const uint8_t *at)
{
    const int32_t raw = (int32_t)get_u16(at);
    return (int16_t)(raw < 0x8000L ? raw : raw - 0x10000L);
}

static uint32_t get_u32(const uint8_t *at)
{
    return get_u16(at) | ((uint32_t)get_u16(&at[2]) << 16);
}

/* Two's complement without the implementation-defined cast. */
static int32_t get_i32(const uint8_t *at)
{
    const uint32_t raw = get_u32(at);
    const uint32_t below = ~raw; /* how far below -1 */
    return raw < 0x80000000UL ? (int32_t)raw : -1 - (int32_t)below;
}

/* -1, 0 or 1; 0 for any other byte. */
static int8_t get_sign(uint8_t byte)
{
    if (byte == 0xFFu) {
        return -1;
    }
    return byte == 1u ? 1 : 0;
}

/* ---- replies: a packet is made while the tick is held, and encoded and sent after that, which takes long ---- */

typedef struct {
    uint8_t n; /* bytes so far; 0: nothing to say */
    uint8_t content[FRAME_CONTENT_MAX];
} packet;

static void put_u8(packet *out, uint8_t value)
{
    out->content[out->n] = value;
    out->n++;
}

static void put_u16(packet *out, uint16_t value)
{
    put_u8(out, (uint8_t)(value & 0xFFu));
    put_u8(out, (uint8_t)(value >> 8));
}

static void put_u32(packet *out, uint32_t value)
{
    put_u16(out, (uint16_t)(value & 0xFFFFu));
    put_u16(out, (uint16_t)(value >> 16));
}

static void head(packet *out, uint8_t type, uint16_t seq)
{
    out->n = 0;
    put_u8(out, RIG_PROTOCOL);
    put_u8(out, type);
    put_u16(out, seq);
}

static void send(const rig_core *core, const packet *out)
{
    uint8_t wire[FRAME_WIRE_MAX];
    const uint8_t length = frame_encode(out->content, out->n, wire);
    core->board->transmit(core->board->context, wire, length);
}

static void refuse(packet *out, uint8_t type, uint16_t seq, enum rig_code code)
{
    head(out, RIG_NACK, seq);
    put_u8(out, (uint8_t)code);
    put_u8(out, type);
}

static void put_hello(packet *out, const rig_core *core)
{
    const rig_board *board = core->board;
    put_u8(out, board->board_id);
    put_u8(out, core->reset_cause);
    put_u8(out, board->bridge);
    put_u8(out, (uint8_t)(board->features | (unsigned)RIG_FEATURE_STROKES | (unsigned)RIG_FEATURE_PULSE |
                          (board->loopback != NULL ? (unsigned)RIG_FEATURE_LOOPBACK : 0u)));
    put_u32(out, (uint32_t)board->counts_max);
    put_u16(out, board->drive_full);
    put_u32(out, board->micros(board->context));
    put_u8(out, board->supply != NULL ? board->supply(board->context) : 0u);
    const char *text = board->build;
    for (uint8_t i = 0; i < RIG_BUILD_LENGTH; i++) {
        put_u8(out, (uint8_t)*text);
        if (*text != '\0') {
            text++;
        }
    }
}

static void put_setup(packet *out, const rig_setup *setup)
{
    put_u32(out, setup->session);
    put_u32(out, (uint32_t)setup->hard_lo);
    put_u32(out, (uint32_t)setup->hard_hi);
    put_u32(out, (uint32_t)setup->rail_lo);
    put_u32(out, (uint32_t)setup->rail_hi);
    put_u32(out, (uint32_t)setup->centre);
    put_u16(out, setup->max_drive);
    put_u16(out, setup->watchdog_ms);
    put_u8(out, (uint8_t)setup->polarity);
    put_u8(out, setup->homing);
}

static uint8_t status_of(const rig_core *core)
{
    return (uint8_t)((core->armed ? (unsigned)RIG_STATUS_ARMED : 0u) |
                     (core->latched != 0u ? (unsigned)RIG_STATUS_FAULT : 0u) |
                     (core->recovering != 0 ? (unsigned)RIG_STATUS_RECOVERING : 0u) |
                     (core->running ? (unsigned)RIG_STATUS_LAW : 0u) |
                     (core->has_zero ? (unsigned)RIG_STATUS_ZERO : 0u) |
                     (core->estop_tried ? (unsigned)RIG_STATUS_ESTOP_TRIED : 0u) |
                     (core->loopback ? (unsigned)RIG_STATUS_LOOPBACK : 0u));
}

static void put_state(packet *out, const rig_core *core)
{
    put_u32(out, core->t_sample_us);
    put_u32(out, (uint32_t)core->counts);
    put_u16(out, core->tach);
    put_u32(out, core->t_drive_us);
    put_u16(out, (uint16_t)core->drive);
    put_u16(out, core->drive_seq);
    put_u8(out, status_of(core));
    put_u8(out, (uint8_t)core->fault);
    put_u32(out, core->setup.session);
}

/* ---- drive and faults ---- */

static void act(rig_core *core, int16_t units)
{
    core->board->set_drive(core->board->context, units);
    core->drive = units;
    core->t_drive_us = core->board->micros(core->board->context);
}

static void disarm(rig_core *core)
{
    act(core, 0);
    core->armed = false;
    core->recovering = 0;
    core->pulsing = false;
}

static uint32_t bit_of(enum rig_code code)
{
    return (uint32_t)1u << (uint8_t)code;
}

/* P7: the armed flag goes with the drive. The first fault is the one that is told; none is forgotten. */
static void latch(rig_core *core, enum rig_code code)
{
    if (core->armed) {
        disarm(core);
    }
    if (core->latched == 0u) {
        core->fault = code;
    }
    core->latched |= bit_of(code);
}

static void unlatch(rig_core *core, enum rig_code code)
{
    core->latched &= ~bit_of(code);
    if (core->fault == code) {
        uint8_t next = (uint8_t)RIG_OK;
        uint32_t bit = 1u;
        for (uint8_t other = 1; other <= (uint8_t)RIG_E_ESTOP_UNTRIED; other++) {
            bit <<= 1;
            if (next == (uint8_t)RIG_OK && (core->latched & bit) != 0u) {
                next = other;
            }
        }
        core->fault = (enum rig_code)next;
    }
}

/* A refusal that has been told. What has latched stays. */
static void forget_refusal(rig_core *core)
{
    if (core->latched == 0u) {
        core->fault = RIG_OK;
    }
}

/* ---- sensor ---- */

static void read_sensors(rig_core *core)
{
    const rig_board *board = core->board;
    core->counts = board->position(board->context, &core->t_sample_us);
    core->tach = board->tach_counts(board->context);
    core->inputs = board->inputs != NULL ? board->inputs(board->context) : 0u;
    if (core->loopback) { /* there is no sensor, and no end switch */
        core->counts = core->setup.centre;
        core->inputs = (uint8_t)(core->inputs & (unsigned)RIG_INPUT_ESTOP);
    }
}

static bool has_encoder(const rig_board *board)
{
    return board->set_position != NULL;
}

static bool is_endless(const rig_setup *setup)
{
    return setup->hard_lo == INT32_MIN && setup->hard_hi == INT32_MAX;
}

static bool is_set(const rig_core *core, enum rig_input contact)
{
    return (core->inputs & (unsigned)contact) != 0u;
}

static bool at_rail(const rig_core *core)
{
    if (has_encoder(core->board)) {
        return false;
    }
    return core->counts <= core->setup.rail_lo || core->counts >= core->setup.rail_hi;
}

/* Past the hard limit there, or on its end switch. */
static bool is_high(const rig_core *core)
{
    return core->counts > core->setup.hard_hi || is_set(core, RIG_INPUT_END_HIGH);
}

static bool is_low(const rig_core *core)
{
    return core->counts < core->setup.hard_lo || is_set(core, RIG_INPUT_END_LOW);
}

/* Where the shaft is: 0 inside, +1 at the high end, -1 at the low end. */
static int8_t side(const rig_core *core)
{
    if (is_high(core)) {
        return 1;
    }
    return is_low(core) ? -1 : 0;
}

/* Whether this forbids any drive now, wherever the shaft is. */
static bool is_in_the_way(const rig_core *core, enum rig_code code)
{
    switch (code) {
    case RIG_E_ESTOP:
        return is_set(core, RIG_INPUT_ESTOP); /* P9 */
    case RIG_E_SENSOR:
        return core->has_setup && at_rail(core); /* P5 */
    case RIG_E_END_SWITCH:
        /* P9: no shaft is at both ends. A wire is broken, or the switches are swapped, and no way is inward. */
        return core->has_setup && is_high(core) && is_low(core);
    default:
        return false;
    }
}

/* P13: whichever it is, the count is no longer the position. */
static void latch_encoder(rig_core *core, enum rig_code code)
{
    core->has_zero = false;
    latch(core, code);
}

/* One of its faults that is latched, or RIG_OK. */
static enum rig_code encoder_fault(const rig_core *core)
{
    for (uint8_t code = (uint8_t)RIG_E_ENCODER_LOST; code <= (uint8_t)RIG_E_ENCODER_STILL; code++) {
        if ((core->latched & bit_of((enum rig_code)code)) != 0u) {
            return (enum rig_code)code;
        }
    }
    return RIG_OK;
}

static void sense_encoder(rig_core *core)
{
    const unsigned troubles = core->board->encoder_troubles(core->board->context);
    if ((troubles & (unsigned)RIG_ENCODER_RATE) != 0u) {
        latch_encoder(core, RIG_E_ENCODER_RATE);
    }
    if ((troubles & (unsigned)RIG_ENCODER_LOST) != 0u) {
        latch_encoder(core, RIG_E_ENCODER_LOST);
    }
    if ((troubles & (unsigned)RIG_ENCODER_STILL) != 0u) {
        latch_encoder(core, RIG_E_ENCODER_STILL); /* or a shaft at rest trembles on an edge: it looks the same */
    }
    if (is_in_the_way(core, RIG_E_ESTOP)) {
        core->estop_tried = true; /* P14 */
    }
}

/* Reads all that the board senses. What must not be forgotten latches with it, armed or not: P10. Nothing else reads the
 * contacts, since a board may tell of a short opening only once. */
static void sense(rig_core *core)
{
    static const enum rig_code ALWAYS[] = {RIG_E_ESTOP, RIG_E_SENSOR, RIG_E_END_SWITCH};
    read_sensors(core);
    for (uint8_t i = 0; i < 3u; i++) {
        if (is_in_the_way(core, ALWAYS[i])) {
            latch(core, ALWAYS[i]);
        }
    }
    if (has_encoder(core->board)) {
        sense_encoder(core);
    }
}

static uint32_t difference(int32_t greater, int32_t less)
{
    return (uint32_t)greater - (uint32_t)less;
}

static bool exceeds(int32_t greater, int32_t less, uint32_t by)
{
    return greater > less && difference(greater, less) > by;
}

static bool is_recovered(const rig_core *core)
{
    if (side(core) != 0) {
        return false;
    }
    return core->recovering > 0 ? exceeds(core->setup.hard_hi, core->counts, RECOVERED_COUNTS)
                                : exceeds(core->counts, core->setup.hard_lo, RECOVERED_COUNTS);
}

/* While recovering under inward drive: does the shaft move outward instead? */
static bool moves_outward(rig_core *core)
{
    if (core->drive == 0) {
        core->farthest = core->counts; /* it may still coast outward from before */
        return false;
    }
    const uint32_t allowed = difference(core->setup.hard_hi, core->setup.hard_lo) / POLARITY_DIVISOR;
    return core->recovering > 0 ? exceeds(core->counts, core->farthest, allowed)
                                : exceeds(core->farthest, core->counts, allowed);
}

static void sample(rig_core *core)
{
    sense(core);
    if (!core->armed) {
        return;
    }
    if (core->recovering != 0 && side(core) != -core->recovering) {
        if (!is_recovered(core)) {
            if (moves_outward(core)) {
                latch(core, RIG_E_POLARITY);
            }
            return;
        }
        core->recovering = 0;
    }
    if (side(core) != 0) {
        const bool by_switch = is_set(core, RIG_INPUT_END_LOW) || is_set(core, RIG_INPUT_END_HIGH);
        latch(core, by_switch ? RIG_E_END_SWITCH : RIG_E_TRAVEL); /* P9, P4 */
    }
}

/* ---- the law that runs in the device: relay or strokes ---- */

static void close_block(rig_core *core)
{
    block *now = blocks_filling(&core->blocks);
    now->status = status_of(core);
    now->fault = (uint8_t)core->fault;
    now->delay_us = core->delay_us;
    now->session = core->setup.session;
    blocks_close(&core->blocks);
}

static bool is_near(const rig_core *core, int32_t counts)
{
    return !exceeds(counts, core->setup.centre, STROKES_REACH_MAX) &&
           !exceeds(core->setup.centre, counts, STROKES_REACH_MAX);
}

/* Hard limits bound what a law has to count. Without them the shaft may turn farther. */
static bool strokes_reach(const rig_core *core, int32_t counts)
{
    return !is_endless(&core->setup) || is_near(core, counts);
}

static bool law_reaches(const rig_core *core)
{
    return core->stroking ? strokes_reach(core, core->counts) : relay_reaches(&core->relay.setup, core->counts);
}

/* One tick of the law: its drive, unless the tick has already disarmed, and its row. */
static void law_tick(rig_core *core)
{
    if (core->armed && !law_reaches(core)) {
        latch(core, RIG_E_TRAVEL);
    }
    if (core->armed) {
        const int16_t units =
            core->stroking ? strokes_step(&core->strokes, core->counts) : relay_step(&core->relay, core->counts);
        if (units != core->drive || !core->law_acted) {
            act(core, units);
            core->law_acted = true;
            core->delay_us = (uint16_t)(core->t_drive_us - core->t_sample_us);
        }
    }
    if (blocks_breaks_off(&core->blocks, core->t_sample_us, core->counts)) {
        close_block(core);
    }
    const bool full = blocks_add(&core->blocks, core->t_sample_us, core->counts, core->drive);
    core->running = core->armed; /* or it ends with this row */
    if (full || !core->armed) {
        close_block(core);
    }
}

/* Ends the law between two ticks, after the drive has been set: the rows so far go out with the last block. */
static void end_law(rig_core *core)
{
    core->running = false;
    close_block(core);
}

/* ---- requests ---- */

static bool fits_sensor(const rig_setup *setup, const rig_board *board)
{
    if (has_encoder(board)) {
        return setup->rail_lo == 0 && setup->rail_hi == 0 && setup->homing <= 1u &&
               !(setup->homing == 1u && is_endless(setup));
    }
    return setup->rail_lo < setup->rail_hi && setup->rail_lo >= 0 &&
           setup->rail_hi <= board->counts_max && /* a rail out of reach would void P5 */
           setup->homing == 0u;
}

static bool is_valid(const rig_setup *setup, const rig_board *board)
{
    return setup->hard_lo < setup->hard_hi && fits_sensor(setup, board) &&
           setup->session != 0u &&
           setup->watchdog_ms >= 1u && setup->watchdog_ms <= RIG_WATCHDOG_MAX_MS &&
           setup->max_drive >= 1u && setup->max_drive <= board->drive_full &&
           (setup->polarity == 1 || setup->polarity == -1);
}

static void on_setup(rig_core *core, uint16_t seq, const uint8_t *body, packet *out)
{
    rig_setup wanted;
    wanted.session = get_u32(body);
    wanted.hard_lo = get_i32(&body[4]);
    wanted.hard_hi = get_i32(&body[8]);
    wanted.rail_lo = get_i32(&body[12]);
    wanted.rail_hi = get_i32(&body[16]);
    wanted.centre = get_i32(&body[20]);
    wanted.max_drive = get_u16(&body[24]);
    wanted.watchdog_ms = get_u16(&body[26]);
    wanted.polarity = get_sign(body[28]);
    wanted.homing = body[29];
    if (core->loopback && wanted.max_drive > core->board->drive_full / RIG_LOOPBACK_PART) {
        refuse(out, RIG_SETUP, seq, RIG_E_SETUP); /* P15 */
        return;
    }
    if (core->armed || !is_valid(&wanted, core->board)) {
        refuse(out, RIG_SETUP, seq, RIG_E_SETUP); /* limits never change under drive */
        return;
    }
    core->setup = wanted;
    core->has_setup = true;
    if (wanted.homing != 0u) {
        core->has_zero = false; /* P13: whatever becomes of the homing */
    }
    head(out, RIG_SETUP | RIG_REPLY, seq);
    put_setup(out, &core->setup);
}

/* The host's voice, P3. What it said may have waited for the core. */
static void heard(rig_core *core)
{
    const rig_board *board = core->board;
    core->t_heard_us = board->arrived_us != NULL ? board->arrived_us(board->context) : board->micros(board->context);
}

/* The drive of a state in which both relays push inward must not push outward. */
static bool is_inward(const rig_core *core, const relay_setup *wanted)
{
    const bool lowers = core->setup.polarity == wanted->direction; /* does negative drive lower the position? */
    const int16_t above = wanted->drive[RELAY_ABOVE_POSITIVE];
    const int16_t below = wanted->drive[RELAY_BELOW_NEGATIVE];
    return lowers ? above <= 0 && below >= 0 : above >= 0 && below <= 0;
}

/* Wherever the shaft may be; without travel limits each tick looks. */
static bool relay_reaches_all(const rig_core *core, const relay_setup *wanted)
{
    if (is_endless(&core->setup)) {
        return relay_reaches(wanted, core->counts);
    }
    return relay_reaches(wanted, core->setup.hard_lo) && relay_reaches(wanted, core->setup.hard_hi);
}

/* Whether a law may start, of whatever it is made. */
static enum rig_code may_start(const rig_core *core, uint8_t rows)
{
    if (!core->armed) {
        return core->latched != 0u ? core->fault : RIG_E_NOT_ARMED; /* P1, P7 */
    }
    if (core->recovering != 0) {
        return RIG_E_TRAVEL; /* P6: its drive would go either way */
    }
    if (core->running || rows < 1u || rows > BLOCK_ROWS_MAX || core->setup.homing != 0u || core->loopback) {
        return RIG_E_SETUP; /* what runs does not change: DRIVE ends it first */
    }
    return RIG_OK;
}

/* From the next tick on. */
static void start_law(rig_core *core, bool stroking, uint8_t rows)
{
    blocks_init(&core->blocks, rows, RIG_TICK_US);
    core->law_acted = false;
    core->delay_us = 0;
    core->stroking = stroking;
    core->pulsing = false;
    core->running = true;
    heard(core);
}

static bool is_too_much(const rig_core *core, int16_t units)
{
    const int16_t most = (int16_t)core->setup.max_drive;
    return units > most || units < -most;
}

static enum rig_code start_relay(rig_core *core, const relay_setup *wanted, uint8_t rows)
{
    const enum rig_code code = may_start(core, rows);
    if (code != RIG_OK) {
        return code;
    }
    if (!relay_is_valid(wanted) || !relay_reaches_all(core, wanted)) {
        return RIG_E_SETUP;
    }
    for (uint8_t i = 0; i < 4u; i++) {
        if (is_too_much(core, wanted->drive[i])) {
            return RIG_E_DRIVE_RANGE; /* P2 */
        }
    }
    if (!is_inward(core, wanted)) {
        return RIG_E_POLARITY;
    }
    relay_init(&core->relay, wanted);
    start_law(core, false, rows);
    return RIG_OK;
}

static void on_relay(rig_core *core, uint16_t seq, const uint8_t *body, packet *out)
{
    relay_setup wanted;
    for (uint8_t i = 0; i < 4u; i++) {
        wanted.drive[i] = get_i16(&body[2u * i]);
    }
    wanted.centre = get_i32(&body[8]);
    wanted.z_bound = get_i32(&body[12]);
    wanted.direction = get_sign(body[16]);
    const enum rig_code code = start_relay(core, &wanted, body[17]);
    if (code != RIG_OK) {
        refuse(out, RIG_RELAY, seq, code);
        return;
    }
    head(out, RIG_RELAY | RIG_REPLY, seq);
    for (uint8_t i = 0; i < RELAY_LENGTH; i++) {
        put_u8(out, body[i]); /* in range, so stored as it came */
    }
}

/* Nothing runs: the plan may be written where it will run from. */
static void take_plan(rig_core *core, const uint8_t *body)
{
    strokes_setup *wanted = &core->strokes.setup;
    wanted->n = body[0];
    wanted->stroke_ticks = get_u16(&body[2]);
    wanted->still_ticks = get_u16(&body[4]);
    wanted->still_counts = get_u16(&body[6]);
    wanted->centre = core->setup.centre;
    wanted->polarity = core->setup.polarity;
    for (uint8_t i = 0; i < STROKES_MAX; i++) {
        const uint8_t *at = &body[8u + 6u * i];
        wanted->plan[i].drive = get_i16(at);
        wanted->plan[i].turn = get_i32(&at[2]);
    }
}

static enum rig_code start_strokes(rig_core *core, const uint8_t *body)
{
    const uint8_t rows = body[1];
    const enum rig_code code = may_start(core, rows);
    if (code != RIG_OK) {
        return code;
    }
    take_plan(core, body);
    const strokes_setup *wanted = &core->strokes.setup;
    if (!strokes_are_valid(wanted) || !strokes_reach(core, core->counts)) {
        return RIG_E_SETUP;
    }
    for (uint8_t i = 0; i < wanted->n; i++) {
        const stroke *one = &wanted->plan[i];
        if (is_too_much(core, one->drive)) {
            return RIG_E_DRIVE_RANGE; /* P2 */
        }
        if (one->turn < core->setup.hard_lo || one->turn > core->setup.hard_hi || !strokes_reach(core, one->turn)) {
            return RIG_E_SETUP; /* it would end at the limit, never at its turning point */
        }
    }
    strokes_begin(&core->strokes);
    start_law(core, true, rows);
    return RIG_OK;
}

static void on_strokes(rig_core *core, uint16_t seq, const uint8_t *body, packet *out)
{
    const enum rig_code code = start_strokes(core, body);
    if (code != RIG_OK) {
        refuse(out, RIG_STROKES, seq, code);
        return;
    }
    head(out, RIG_STROKES | RIG_REPLY, seq);
    for (uint8_t i = 0; i < STROKES_LENGTH; i++) {
        put_u8(out, body[i]);
    }
}

static enum rig_code arm(rig_core *core, uint32_t session)
{
    disarm(core); /* arming starts from drive 0, also when already armed */
    if (core->running) {
        end_law(core);
    }
    sense(core);
    forget_refusal(core);
    if (core->latched != 0u) {
        return core->fault; /* P7, P10 */
    }
    if (!core->has_setup) {
        return RIG_E_NO_SETUP; /* P1 */
    }
    if (session != core->setup.session) {
        return RIG_E_SESSION; /* P11 */
    }
    if (has_encoder(core->board) && !core->has_zero && core->setup.homing == 0u) {
        return RIG_E_ZERO; /* P13 */
    }
    if (has_encoder(core->board) && is_endless(&core->setup) && !core->estop_tried) {
        return RIG_E_ESTOP_UNTRIED; /* P14 */
    }
    core->recovering = side(core); /* P6 */
    core->farthest = core->counts;
    heard(core);
    core->armed = true;
    return RIG_OK;
}

/* Whether a drive may reach the pin; what it has done wrong is said, or latched. */
static bool may_drive(rig_core *core, int16_t units)
{
    if (core->latched != 0u) {
        return false; /* P7 */
    }
    if (!core->armed) {
        core->fault = RIG_E_NOT_ARMED; /* P1 */
        return false;
    }
    if (is_too_much(core, units)) {
        latch(core, RIG_E_DRIVE_RANGE); /* P2 */
        return false;
    }
    const bool raises = (units > 0) == (core->setup.polarity > 0);
    const bool is_above = core->recovering > 0;
    if (core->recovering != 0 && units != 0 && raises == is_above) {
        latch(core, RIG_E_TRAVEL); /* P6 */
        return false;
    }
    return true;
}

static void take_drive(rig_core *core, uint16_t seq, int16_t units)
{
    act(core, units);
    core->drive_seq = seq;
    if (core->running) {
        end_law(core); /* the host takes over, without a gap in the drive */
    }
}

static void on_drive(rig_core *core, uint16_t seq, int16_t units)
{
    if (!may_drive(core, units)) {
        return;
    }
    if (core->pulsing && core->drive == 0 && units == 0) {
        core->drive_seq = seq; /* the pulse has ended before: the state goes on telling when */
    } else {
        take_drive(core, seq, units);
    }
    core->pulsing = false;
}

static bool is_pulse_over(const rig_core *core)
{
    return core->board->micros(core->board->context) - core->t_pulse_us >= core->pulse_ms * US_PER_MS;
}

/* P16: once over it stays over, though the clock wraps. */
static void end_pulse(rig_core *core)
{
    if (core->pulsing && is_pulse_over(core)) {
        core->pulse_ms = 0;
        if (core->drive != 0) {
            act(core, 0);
        }
    }
}

/* P16: the pulse's time counts from its first frame, so that no late frame makes it longer. */
static void on_pulse(rig_core *core, uint16_t seq, int16_t units, uint16_t longest_ms)
{
    if (!may_drive(core, units)) {
        return;
    }
    if (core->pulsing && is_pulse_over(core)) {
        core->drive_seq = seq; /* it has come, but it drives nothing */
        return;
    }
    take_drive(core, seq, units);
    if (!core->pulsing) {
        core->pulsing = true;
        core->t_pulse_us = core->t_drive_us;
        core->pulse_ms = longest_ms;
    }
}

static void on_stop(rig_core *core, uint16_t seq, packet *out)
{
    disarm(core);
    sense(core);
    head(out, RIG_STOP | RIG_REPLY, seq);
    put_state(out, core); /* a refusal is told once more */
    forget_refusal(core);
}

/* P13: the host says where an encoder stands, at rest and disarmed. */
static void on_zero(rig_core *core, uint16_t seq, int32_t counts, packet *out)
{
    if (!has_encoder(core->board)) {
        refuse(out, RIG_ZERO, seq, RIG_E_TYPE);
        return;
    }
    if (core->armed) {
        refuse(out, RIG_ZERO, seq, RIG_E_SETUP); /* positions never change under drive */
        return;
    }
    sense(core);
    const enum rig_code trouble = encoder_fault(core);
    if (trouble != RIG_OK) {
        refuse(out, RIG_ZERO, seq, trouble); /* the host may have worked it out from counts that are wrong */
        return;
    }
    core->board->set_position(core->board->context, counts);
    core->counts = counts;
    core->has_zero = true;
    head(out, RIG_ZERO | RIG_REPLY, seq);
    put_state(out, core);
}

/* P7: somebody has seen this fault. Naming one that has not latched changes nothing: a reply may have got lost. */
static void on_ack(rig_core *core, uint16_t seq, uint8_t named, packet *out)
{
    const enum rig_code code = named <= (uint8_t)RIG_E_ESTOP_UNTRIED ? (enum rig_code)named : RIG_OK;
    sense(core);
    if (code == RIG_OK) {
        refuse(out, RIG_ACK, seq, RIG_E_SETUP);
        return;
    }
    if (is_in_the_way(core, code)) {
        refuse(out, RIG_ACK, seq, code);
        return;
    }
    unlatch(core, code);
    head(out, RIG_ACK | RIG_REPLY, seq);
    put_state(out, core);
}

/* ---- loop-back: a bare board looks at its own outputs ---- */

/* Nothing of what was said in it, or before, holds any longer. */
static void forget_bench(rig_core *core, bool loopback)
{
    disarm(core);
    core->loopback = loopback;
    core->has_setup = false;
    core->setup.session = 0;
    core->has_zero = false;
    core->estop_tried = false; /* P14: it was the board's own pin */
}

static enum rig_code begin_loopback(rig_core *core)
{
    if (core->armed) {
        return RIG_E_SETUP;
    }
    if (!core->board->loopback->begin()) {
        core->board->loopback->end();
        return RIG_E_LOOPBACK; /* P15 */
    }
    forget_bench(core, true);
    return RIG_OK;
}

static void end_loopback(rig_core *core)
{
    if (core->loopback) {
        forget_bench(core, false);
        core->board->loopback->end();
    }
}

static enum rig_code act_in_loopback(rig_core *core, uint8_t wanted)
{
    const rig_loopback_board *board = core->board->loopback;
    if (board == NULL || wanted > (uint8_t)RIG_LOOPBACK_HANG) {
        return RIG_E_TYPE;
    }
    if (wanted == (uint8_t)RIG_LOOPBACK_BEGIN) {
        return begin_loopback(core);
    }
    if (!core->loopback) {
        return RIG_E_LOOPBACK;
    }
    if (wanted == (uint8_t)RIG_LOOPBACK_OPEN || wanted == (uint8_t)RIG_LOOPBACK_CLOSE) {
        board->open_estop(wanted == (uint8_t)RIG_LOOPBACK_OPEN);
    }
    core->hangs = wanted == (uint8_t)RIG_LOOPBACK_HANG;
    return RIG_OK;
}

static void put_loopback(packet *out, const rig_core *core, bool share)
{
    rig_loopback_view view = {0, 0, 0, {{0, 0, 0, 0}, {0, 0, 0, 0}}};
    core->board->loopback->look(&view, share);
    put_u32(out, core->board->micros(core->board->context));
    put_u32(out, core->ticks);
    put_u32(out, view.estop_us);
    put_u16(out, view.looks);
    put_u8(out, view.high);
    for (uint8_t i = 0; i < 2u; i++) {
        put_u16(out, view.wire[i].wire_highs);
        put_u16(out, view.wire[i].pin_highs);
        put_u16(out, view.wire[i].rises);
        put_u32(out, view.wire[i].last_us);
    }
}

static void on_loopback(rig_core *core, uint16_t seq, uint8_t wanted, packet *out)
{
    const enum rig_code code = act_in_loopback(core, wanted);
    if (code != RIG_OK) {
        refuse(out, RIG_LOOPBACK, seq, code);
        return;
    }
    head(out, RIG_LOOPBACK | RIG_REPLY, seq);
    put_loopback(out, core, wanted == (uint8_t)RIG_LOOPBACK_SHARE);
    if (wanted == (uint8_t)RIG_LOOPBACK_END) {
        end_loopback(core);
    }
}

/* Length of the body of a request, or -1 for an unknown type. */
static int8_t body_length(uint8_t type)
{
    switch (type) {
    case RIG_HELLO:
    case RIG_READ:
    case RIG_STOP:
    case RIG_KEEP:
        return 0;
    case RIG_RELAY:
        return (int8_t)RELAY_LENGTH;
    case RIG_STROKES:
        return (int8_t)STROKES_LENGTH;
    case RIG_SETUP:
        return (int8_t)SETUP_LENGTH;
    case RIG_ARM:
        return (int8_t)ARM_LENGTH;
    case RIG_ACK:
        return (int8_t)ACK_LENGTH;
    case RIG_ZERO:
        return (int8_t)ZERO_LENGTH;
    case RIG_DRIVE:
        return (int8_t)DRIVE_LENGTH;
    case RIG_LOOPBACK:
        return (int8_t)LOOPBACK_LENGTH;
    case RIG_PULSE:
        return (int8_t)PULSE_LENGTH;
    default:
        return -1;
    }
}

/* A request that is whole and known. It acts as a whole, too: the tick is held. */
static void act_on(rig_core *core, uint8_t type, uint16_t seq, const uint8_t *body, packet *out)
{
    switch (type) {
    case RIG_SETUP:
        on_setup(core, seq, body, out);
        break;
    case RIG_ARM: {
        const uint8_t code = (uint8_t)arm(core, get_u32(body));
        head(out, RIG_ARM | RIG_REPLY, seq);
        put_u8(out, code);
        break;
    }
    case RIG_READ:
        if (core->drive == 0 && !core->running) {
            heard(core); /* P3: what drives is kept up by DRIVE and PULSE alone: one that got lost must not stay on */
        }
        sample(core);
        head(out, RIG_READ | RIG_REPLY, seq);
        put_state(out, core);
        break;
    case RIG_DRIVE:
        heard(core);
        on_drive(core, seq, get_i16(body));
        break;
    case RIG_PULSE:
        heard(core);
        on_pulse(core, seq, get_i16(body), get_u16(&body[2]));
        break;
    case RIG_RELAY:
        on_relay(core, seq, body, out);
        break;
    case RIG_STROKES:
        on_strokes(core, seq, body, out);
        break;
    case RIG_KEEP:
        if (core->running) {
            heard(core); /* P3: it keeps nothing else alive */
        }
        break;
    case RIG_ACK:
        on_ack(core, seq, body[0], out);
        break;
    case RIG_ZERO:
        on_zero(core, seq, get_i32(body), out);
        break;
    case RIG_LOOPBACK:
        on_loopback(core, seq, body[0], out);
        break;
    default: /* RIG_STOP: body_length knows no other but HELLO */
        on_stop(core, seq, out);
        break;
    }
    if (core->running && !core->armed) {
        end_law(core); /* STOP, or what a READ has seen */
    }
}

static void on_request(rig_core *core, const uint8_t *content, uint8_t n)
{
    const uint8_t type = content[1];
    const uint16_t seq = get_u16(&content[2]);
    const int8_t expected = body_length(type);
    packet out;
    out.n = 0;
    if (content[0] != RIG_PROTOCOL) {
        core->rx.dropped++;
        refuse(&out, type, seq, RIG_E_VERSION);
    } else if (expected < 0) {
        refuse(&out, type, seq, RIG_E_TYPE);
    } else if (n != FRAME_HEADER + (uint8_t)expected) {
        refuse(&out, type, seq, RIG_E_LENGTH);
    } else if (type == (uint8_t)RIG_HELLO) {
        hold(core);
        end_loopback(core); /* whoever asks who this is may have a motor */
        release(core);
        head(&out, RIG_HELLO | RIG_REPLY, seq);
        put_hello(&out, core);
    } else {
        rig_stream(core); /* room for the block that ends the law */
        hold(core);
        act_on(core, type, seq, &content[FRAME_HEADER], &out);
        release(core);
    }
    if (out.n != 0u) {
        send(core, &out);
    }
    if (core->hangs) {
        core->board->loopback->hang_up();
    }
}

/* ---- what the board calls ---- */

void rig_init(rig_core *core, const rig_board *board, uint8_t reset_cause)
{
    const rig_setup none = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0};
    core->board = board;
    frame_receiver_init(&core->rx);
    core->setup = none;
    core->has_setup = false;
    core->reset_cause = reset_cause;
    core->drive_seq = 0;
    core->farthest = 0;
    core->has_zero = false; /* P13 */
    core->estop_tried = false; /* P14 */
    core->loopback = false;
    core->hangs = false;
    core->ticks = 0;
    core->running = false;
    core->law_acted = false;
    core->stroking = false;
    core->pulsing = false;
    core->t_pulse_us = 0;
    core->pulse_ms = 0;
    core->delay_us = 0;
    blocks_init(&core->blocks, BLOCK_ROWS_MAX, RIG_TICK_US);
    disarm(core); /* P1 */
    core->latched = 0;
    latch(core, RIG_E_RESET); /* P10 */
    core->t_heard_us = core->t_drive_us;
    sense(core);
}

void rig_byte(rig_core *core, uint8_t byte)
{
    const uint8_t n = frame_receive(&core->rx, byte); /* P8 */
    if (n != 0u) {
        on_request(core, core->rx.buffer, n);
    }
}

void rig_tick(rig_core *core)
{
    core->ticks++;
    sample(core); /* P4, P5 */
    if (core->armed) {
        const uint32_t silent_us = core->board->micros(core->board->context) - core->t_heard_us;
        if (silent_us >= core->setup.watchdog_ms * US_PER_MS) {
            latch(core, RIG_E_WATCHDOG); /* P3 */
        }
    }
    end_pulse(core);
    if (core->running) {
        law_tick(core);
    }
}

void rig_stream(rig_core *core)
{
    hold(core);
    const block *full = blocks_waiting(&core->blocks);
    release(core);
    if (full == NULL) {
        return;
    }
    packet out;
    head(&out, RIG_BLOCK, full->number);
    put_u32(&out, full->t_first_us);
    put_u16(&out, RIG_TICK_US);
    put_u16(&out, full->delay_us);
    put_u8(&out, full->status);
    put_u8(&out, full->fault);
    put_u32(&out, full->session);
    put_u32(&out, (uint32_t)full->first);
    for (uint8_t i = 0; i < full->n; i++) {
        put_u16(&out, (uint16_t)full->from_first[i]);
        put_u16(&out, (uint16_t)full->drive[i]);
    }
    hold(core);
    blocks_sent(&core->blocks); /* all of it is in the packet */
    release(core);
    send(core, &out);
}
