/* A board of plain variables, and a host that keeps the last reply. */
#ifndef RIG_PLAIN_BOARD_H
#define RIG_PLAIN_BOARD_H

#include <string.h>

#include "check.h"
#include "request.h"
#include "rig_core.h"

static struct {
    uint32_t now_us;
    int32_t counts;
    uint16_t tach;
    uint8_t inputs;
    uint8_t troubles; /* of an encoder */
    int16_t pin;
    unsigned drives;     /* calls of set_drive */
    frame_receiver host; /* what comes back */
    uint8_t got[FRAME_CONTENT_MAX]; /* last frame that was no block */
    uint8_t got_length;
    unsigned replies;
} board;

static rig_core core;
static uint16_t seq;

static uint32_t fake_micros(void *context)
{
    (void)context;
    return board.now_us;
}

static int32_t fake_position(void *context, uint32_t *t_us)
{
    (void)context;
    *t_us = board.now_us;
    return board.counts;
}

static uint16_t fake_tach(void *context)
{
    (void)context;
    return board.tach;
}

static void fake_drive(void *context, int16_t units)
{
    (void)context;
    board.pin = units;
    board.drives++;
}

static void fake_transmit(void *context, const uint8_t *bytes, uint8_t n)
{
    (void)context;
    for (uint8_t i = 0; i < n; i++) {
        const uint8_t length = frame_receive(&board.host, bytes[i]);
        if (length != 0u && board.host.buffer[1] != (uint8_t)RIG_BLOCK) {
            memcpy(board.got, board.host.buffer, length);
            board.got_length = length;
            board.replies++;
        }
    }
}

static uint8_t fake_inputs(void *context)
{
    (void)context;
    return board.inputs;
}

#define PLAIN_BOARD \
    .micros = fake_micros, .position = fake_position, .tach_counts = fake_tach, .set_drive = fake_drive, \
    .transmit = fake_transmit, .inputs = fake_inputs, .board_id = RIG_BOARD_HOST

static void start(const rig_board *as, uint8_t cause)
{
    memset(&board, 0, sizeof board);
    frame_receiver_init(&board.host);
    board.tach = RIG_TACH_NONE;
    board.now_us = 1000;
    board.pin = 123; /* whatever the pin was, init sets 0 */
    rig_init(&core, as, cause);
}

static void send_raw(uint8_t version, uint8_t type, const uint8_t *body, uint8_t n)
{
    uint8_t wire[FRAME_WIRE_MAX];
    const uint8_t length = encode_request(version, type, ++seq, body, n, wire);
    board.replies = 0;
    board.got_length = 0;
    for (uint8_t i = 0; i < length; i++) {
        rig_byte(&core, wire[i]);
    }
}

static void tick(void)
{
    board.now_us += RIG_TICK_US;
    rig_tick(&core);
    rig_stream(&core);
}

#endif
