#include "encoder.h"

#include <avr/interrupt.h>
#include <util/atomic.h>

#include "clock.h"
#include "rig_core.h"
#include "wiring.h"

#if RIG_ENCODER

#define CHANNELS ((uint8_t)(PIN_ENCODER_A | PIN_ENCODER_B))
#define BOTH ((uint8_t)(BIT(INT0) | BIT(INT1)))

static volatile uint16_t count; /* modulo 2^16 */
static volatile uint8_t troubles;
static volatile uint16_t count_of_tick;
static volatile clock_stamp count_taken_at;
static volatile bool has_sample; /* count_of_tick has not been taken yet */

/* Of the interrupts alone. */
static uint8_t levels; /* of both channels, at the last edge */
static uint8_t edges;  /* in this millisecond */

/* Of the tick, and of the main loop that holds it. */
static uint32_t unwrapped; /* modulo 2^32, at `taken` */
static uint16_t taken;

static void begin_counting(void)
{
    EIFR = BOTH; /* edges of the time before */
    levels = (uint8_t)(PIND & CHANNELS);
    EIMSK = BOTH;
}

void encoder_init(void)
{
    set_bits(&PORTD, CHANNELS); /* pull-ups: most encoders only pull down */
    EICRA = (uint8_t)(BIT(ISC00) | BIT(ISC10)); /* any edge; the first millisecond begins to count */
}

/* One channel for A, another for B: forward is A before B. */
static inline void take_edge(void)
{
    static uint8_t last;  /* channel of the last edge */
    static uint8_t alone; /* edges of that channel in a row */
    const uint8_t now = (uint8_t)(PIND & CHANNELS);
    const uint8_t changed = (uint8_t)(now ^ levels);
    levels = now;
    edges++;
    if (edges > ENCODER_EDGES_MAX) {
        EIMSK = 0; /* until the next millisecond */
        troubles |= (uint8_t)RIG_ENCODER_RATE;
    }
    if (changed == CHANNELS) {
        troubles |= (uint8_t)RIG_ENCODER_LOST;
        return;
    }
    if (changed == 0u) {
        return; /* shorter than the way to here: it went, and came back */
    }
    const bool differ = now == PIN_ENCODER_A || now == PIN_ENCODER_B;
    if ((changed == PIN_ENCODER_A) == differ) {
        count++;
    } else {
        count--;
    }
    alone = changed == last ? (uint8_t)(alone + 1u) : 0u;
    last = changed;
    if (alone >= ENCODER_ALONE_MAX) {
        alone = 0;
        troubles |= (uint8_t)RIG_ENCODER_STILL;
    }
}

ISR(INT0_vect)
{
    take_edge();
}

ISR(INT1_vect)
{
    take_edge();
}

void encoder_begin_tick(void)
{
    const clock_stamp now = clock_now();
    count_of_tick = count;
    count_taken_at.tick = now.tick;
    count_taken_at.count = now.count;
    has_sample = true;
    edges = 0;
    if (EIMSK == 0u) {
        begin_counting();
    }
}

/* Two's complement without the implementation-defined casts. */
static void follow(uint16_t now)
{
    const uint16_t gone = (uint16_t)(now - taken);
    unwrapped += gone;
    if (gone > 0x7FFFu) {
        unwrapped -= (uint32_t)0x10000;
    }
    taken = now;
}

static int32_t signed_position(void)
{
    const uint32_t below = ~unwrapped; /* how far below -1 */
    return unwrapped < 0x80000000UL ? (int32_t)unwrapped : -1 - (int32_t)below;
}

encoder_sample encoder_tick_sample(void)
{
    clock_stamp at;
    uint16_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        now = count_of_tick;
        at.tick = count_taken_at.tick;
        at.count = count_taken_at.count;
    }
    follow(now);
    const encoder_sample sample = {signed_position(), clock_us_of(at)};
    return sample;
}

static uint16_t count_now(void)
{
    uint16_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        now = count;
    }
    return now;
}

encoder_sample encoder_newest_sample(void)
{
    const uint32_t t_us = clock_us();
    follow(count_now());
    const encoder_sample sample = {signed_position(), t_us};
    return sample;
}

void encoder_set(int32_t counts)
{
    taken = count_now();
    unwrapped = (uint32_t)counts;
}

uint8_t encoder_take_troubles(void)
{
    uint8_t found;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        found = troubles;
        troubles = 0;
    }
    return found;
}

bool encoder_take_tick(void)
{
    if (!has_sample) {
        return false;
    }
    has_sample = false;
    return true;
}

#endif
