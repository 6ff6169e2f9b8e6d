/* A board whose tick is an interrupt, which may come at any point of the main loop, and a host that keeps what it is told:
 * for the tests of the laws that run in the device. */
#ifndef RIG_LAW_BOARD_H
#define RIG_LAW_BOARD_H

#include <string.h>

#include "check.h"
#include "request.h"
#include "rig_core.h"

#define LIMIT_LO 100
#define LIMIT_HI 900
#define MOST 200
#define WATCHDOG_TICKS 100
#define SESSION 77

typedef struct {
    uint16_t number, delay_us, period_us;
    uint32_t t_us, session;
    uint8_t status, fault, n;
    int32_t counts[BLOCK_ROWS_MAX];
    int16_t drive[BLOCK_ROWS_MAX];
} told_block;

static struct {
    uint32_t now_us;
    int32_t counts;
    uint8_t inputs;
    int16_t pin;
    frame_receiver host;
    uint8_t reply[FRAME_CONTENT_MAX]; /* last frame that was no block */
    uint8_t reply_length;
    told_block block[64];
    unsigned blocks;
    bool held, in_tick;
    unsigned points, tick_at; /* where the main loop can be interrupted: so many so far; a tick comes at this one */
} board;

static rig_core core;
static rig_core seen; /* after the last tick or held section */
static uint16_t seq;

/* ---- the tick as an interrupt: nothing that it shares may change behind its back ---- */

static void interrupt(void)
{
    CHECK(!board.held && !board.in_tick);
    seen.rx = core.rx; /* the main loop's own */
    CHECK(memcmp(&seen, &core, sizeof core) == 0);
    board.in_tick = true;
    rig_tick(&core);
    board.in_tick = false;
    memcpy(&seen, &core, sizeof core);
}

/* A point of the main loop at which the tick may come. */
static void point(void)
{
    if (!board.held && !board.in_tick && ++board.points == board.tick_at) {
        board.now_us += RIG_TICK_US - board.now_us % RIG_TICK_US;
        interrupt();
    }
}

static void fake_hold(void *context)
{
    (void)context;
    point();
    CHECK(!board.held && !board.in_tick);
    seen.rx = core.rx;
    CHECK(memcmp(&seen, &core, sizeof core) == 0);
    board.held = true;
}

static void fake_release(void *context)
{
    (void)context;
    CHECK(board.held);
    board.held = false;
    memcpy(&seen, &core, sizeof core);
    point();
}

static uint32_t fake_micros(void *context)
{
    (void)context;
    return board.now_us;
}

static int32_t fake_position(void *context, uint32_t *t_us)
{
    (void)context;
    *t_us = board.now_us;
    CHECK(board.held || board.in_tick);
    return board.counts;
}

static uint16_t fake_tach(void *context)
{
    (void)context;
    return RIG_TACH_NONE;
}

static void fake_drive(void *context, int16_t units)
{
    (void)context;
    board.now_us += 7; /* it takes a while */
    CHECK(board.held || board.in_tick);
    board.pin = units;
}

static uint8_t fake_inputs(void *context)
{
    (void)context;
    return board.inputs;
}

static void keep_block(const uint8_t *content, uint8_t length)
{
    told_block *b = &board.block[board.blocks++ % 64u];
    const uint8_t *body = content + FRAME_HEADER;
    b->number = u16(content + 2);
    b->t_us = u32(body);
    b->period_us = u16(body + 4);
    b->delay_us = u16(body + 6);
    b->status = body[8];
    b->fault = body[9];
    b->session = u32(body + 10);
    b->n = (uint8_t)((length - FRAME_HEADER - 18u) / 4u);
    CHECK(length == FRAME_HEADER + 18u + 4u * b->n && b->n <= BLOCK_ROWS_MAX);
    for (uint8_t i = 0; i < b->n; i++) {
        b->counts[i] = (int32_t)u32(body + 14) + (int16_t)u16(body + 18 + 4 * i);
        b->drive[i] = (int16_t)u16(body + 20 + 4 * i);
    }
}

static void fake_transmit(void *context, const uint8_t *bytes, uint8_t n)
{
    (void)context;
    for (uint8_t i = 0; i < n; i++) {
        const uint8_t length = frame_receive(&board.host, bytes[i]);
        if (length != 0u && board.host.buffer[1] == RIG_BLOCK) {
            keep_block(board.host.buffer, length);
        } else if (length != 0u) {
            memcpy(board.reply, board.host.buffer, length);
            board.reply_length = length;
        }
    }
    point();
}

static const rig_board BOARD = {.micros = fake_micros,
                                .position = fake_position,
                                .tach_counts = fake_tach,
                                .set_drive = fake_drive,
                                .transmit = fake_transmit,
                                .inputs = fake_inputs,
                                .build = "build",
                                .counts_max = 1023,
                                .drive_full = 799,
                                .board_id = RIG_BOARD_HOST,
                                .hold_tick = fake_hold,
                                .release_tick = fake_release};

static void reset(const rig_board *wanted)
{
    board.held = true; /* no tick before it is done */
    rig_init(&core, wanted, RIG_RESET_POWER_ON);
    board.held = false;
    memcpy(&seen, &core, sizeof core);
}

static void send(uint8_t type, const uint8_t *body, uint8_t n)
{
    uint8_t wire[FRAME_WIRE_MAX];
    const uint8_t length = encode_request(RIG_PROTOCOL, type, ++seq, body, n, wire);
    board.reply_length = 0;
    for (uint8_t i = 0; i < length; i++) {
        rig_byte(&core, wire[i]);
        rig_stream(&core);
    }
}

static int refused(uint8_t type, uint8_t code)
{
    return board.reply_length == 6 && board.reply[1] == RIG_NACK && board.reply[4] == code && board.reply[5] == type;
}

static void send_drive(int units)
{
    uint8_t body[2];
    (void)put16(body, units);
    send(RIG_DRIVE, body, 2);
}

static void send_arm(void)
{
    uint8_t body[4];
    (void)put32(body, SESSION);
    send(RIG_ARM, body, 4);
}

/* An armed device at 8 counts above the relay's centre. */
static void armed_about(int32_t centre, const rig_board *wanted, int polarity)
{
    const int32_t fields[] = {SESSION, centre - 512 + LIMIT_LO, centre - 512 + LIMIT_HI, 5, wanted->counts_max - 5, centre};
    static const uint8_t seen_reset = RIG_E_RESET;
    uint8_t body[30];
    uint8_t *at = body;
    memset(&board, 0, sizeof board);
    frame_receiver_init(&board.host);
    board.counts = centre + 8;
    reset(wanted);
    for (int i = 0; i < 6; i++) {
        at = put32(at, (uint32_t)fields[i]);
    }
    at = put16(put16(at, MOST), WATCHDOG_TICKS);
    at[0] = (uint8_t)polarity;
    at[1] = 0;
    send(RIG_SETUP, body, 30);
    send(RIG_ACK, &seen_reset, 1);
    send_arm();
    CHECK(board.reply[1] == (RIG_ARM | RIG_REPLY) && board.reply[4] == RIG_OK);
}

static void armed(int polarity)
{
    armed_about(512, &BOARD, polarity);
}

static void tick(void)
{
    board.now_us += RIG_TICK_US - board.now_us % RIG_TICK_US;
    interrupt();
    rig_stream(&core);
}

static void ticks(unsigned n)
{
    while (n-- > 0u) {
        tick();
    }
}

static const told_block *last(void)
{
    return &board.block[(board.blocks - 1u) % 64u];
}

/* Whatever stops the drive stops the law `type`, in the same tick; the row of that tick and the reason are told, and the
 * law does not start again (P7). `running` and `start` start it. */
static void check_faults_end_it(uint8_t type, void (*running)(void), void (*start)(void))
{
    static const struct {
        int32_t counts;
        uint8_t inputs, code;
    } cases[] = {{LIMIT_HI + 1, 0, RIG_E_TRAVEL},  {LIMIT_LO - 1, 0, RIG_E_TRAVEL},
                 {1018, 0, RIG_E_SENSOR},          {5, 0, RIG_E_SENSOR},
                 {512, RIG_INPUT_ESTOP, RIG_E_ESTOP}, {512, RIG_INPUT_END_LOW, RIG_E_END_SWITCH}};
    for (unsigned c = 0; c < sizeof cases / sizeof cases[0]; c++) {
        for (unsigned phase = 0; phase < 12u; phase++) {
            running();
            ticks(phase + 1u);
            CHECK(board.pin != 0);
            board.counts = cases[c].counts;
            board.inputs = cases[c].inputs;
            tick();
            CHECK(board.pin == 0 && core.latched && core.fault == cases[c].code && !core.running && !core.armed);
            const told_block *told = last();
            CHECK(told->status == RIG_STATUS_FAULT && told->fault == cases[c].code);
            CHECK(told->n >= 1 && told->counts[told->n - 1] == cases[c].counts && told->drive[told->n - 1] == 0);
            unsigned rows = 0;
            for (unsigned b = 0; b < board.blocks; b++) {
                CHECK(board.block[b].number == b);
                rows += board.block[b].n;
            }
            CHECK(rows == phase + 2u);
            board.counts = 520;
            board.inputs = 0;
            ticks(30);
            CHECK(board.pin == 0);
            start();
            CHECK(refused(type, cases[c].code));
        }
    }
}

#endif
