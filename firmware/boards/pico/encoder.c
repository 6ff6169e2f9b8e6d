#include "encoder.h"

#include <stdbool.h>

#include "clock.h"
#include "cpu.h"
#include "rig_core.h"
#include "wiring.h"

#define CHANNEL_A 1u
#define CHANNEL_B 2u
#define CHANNELS (CHANNEL_A | CHANNEL_B)

static volatile uint32_t count; /* modulo 2^32 */
static volatile uint8_t troubles;
static volatile uint32_t levels; /* of both channels, at the last edge */
static volatile uint32_t edges;  /* in this millisecond */
static volatile bool counts_edges;

/* Of the tick, and of the main loop that holds it. */
static uint32_t zero; /* count at position 0 */
static encoder_sample of_tick;

static uint32_t levels_now(void)
{
    return (REG(SIO_GPIO_IN) >> PIN_ENCODER_A) & CHANNELS;
}

static void begin_counting(void)
{
    REG(IO_INTR0) = EDGES_OF_ENCODER; /* edges of the time before */
    levels = levels_now();
    REG(IO_PROC0_INTE0) = EDGES_OF_ENCODER;
    counts_edges = true;
}

void encoder_init(void)
{
    wire_pin(PIN_ENCODER_A, PAD_CONTACT, FUNCTION_SIO); /* pulled up: most encoders only pull down */
    wire_pin(PIN_ENCODER_B, PAD_CONTACT, FUNCTION_SIO);
}

void encoder_take_edge(void)
{
    static uint32_t last;  /* channel of the last edge */
    static uint32_t alone; /* edges of that channel in a row */
    REG(IO_INTR0) = EDGES_OF_ENCODER; /* before the levels: an edge from here on comes again */
    const uint32_t now = levels_now();
    const uint32_t changed = now ^ levels;
    levels = now;
    edges++;
    if (edges > ENCODER_EDGES_MAX) {
        REG(IO_PROC0_INTE0) = 0; /* until the next tick */
        counts_edges = false;
        troubles |= (uint8_t)RIG_ENCODER_RATE;
    }
    if (changed == CHANNELS) {
        troubles |= (uint8_t)RIG_ENCODER_LOST;
        return;
    }
    if (changed == 0u) {
        return; /* shorter than the way to here: it went, and came back */
    }
    const bool differ = now == CHANNEL_A || now == CHANNEL_B;
    if ((changed == CHANNEL_A) == differ) { /* forward is A before B */
        count++;
    } else {
        count--;
    }
    alone = changed == last ? alone + 1u : 0u;
    last = changed;
    if (alone >= ENCODER_ALONE_MAX) {
        alone = 0;
        troubles |= (uint8_t)RIG_ENCODER_STILL;
    }
}

/* Two's complement without the implementation-defined cast. */
static encoder_sample sample_now(void)
{
    const uint32_t t_us = clock_us();
    const uint32_t from_zero = count - zero;
    const uint32_t below = ~from_zero; /* how far below -1 */
    const encoder_sample sample = {from_zero < 0x80000000u ? (int32_t)from_zero : -1 - (int32_t)below, t_us};
    return sample;
}

void encoder_begin_tick(void)
{
    of_tick = sample_now();
    const uint32_t before = cpu_hold_interrupts();
    edges = 0;
    if (!counts_edges) {
        begin_counting();
    }
    cpu_restore_interrupts(before);
}

encoder_sample encoder_tick_sample(void)
{
    return of_tick;
}

encoder_sample encoder_newest_sample(void)
{
    return sample_now();
}

void encoder_set(int32_t counts)
{
    zero = count - (uint32_t)counts;
}

uint8_t encoder_take_troubles(void)
{
    const uint32_t before = cpu_hold_interrupts();
    const uint8_t found = troubles;
    troubles = 0;
    cpu_restore_interrupts(before);
    return found;
}
