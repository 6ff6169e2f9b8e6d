#include "loopback.h"

#include <avr/interrupt.h>
#include <util/atomic.h>
#include <util/delay_basic.h>

#include "clock.h"
#include "wiring.h"

#define PATIENCE 200u /* looks at the e-stop's input, some 60 us: its pull-up has to lift a wire */
#define STRETCHES 8u  /* of looks at a share, each of about a period; all take less than half a tick */
#define LOOKS 32u     /* in a stretch */

static volatile uint8_t ends_before; /* at the last edge */
static volatile uint16_t rises[2];
static volatile uint8_t last_tick[2]; /* of the last edge, by the clock: soon over, so the tick keeps its time */
static volatile uint8_t last_count[2];
static volatile uint8_t changed; /* ends, since the tick before */
static uint32_t last_us[2];
static uint32_t estop_us;

/* As short as it can be: it comes 40,000 times a second. */
ISR(PCINT1_vect)
{
    const uint8_t count = TCNT2;
    const uint8_t tick = clock_tick();
    const uint8_t now = PINC;
    const uint8_t differ = (uint8_t)(now ^ ends_before);
    ends_before = now;
    changed |= differ;
    if ((differ & PIN_WIRE_A) != 0u) {
        last_tick[0] = tick;
        last_count[0] = count;
        if ((now & PIN_WIRE_A) != 0u) {
            rises[0]++;
        }
    }
    if ((differ & PIN_WIRE_B) != 0u) {
        last_tick[1] = tick;
        last_count[1] = count;
        if ((now & PIN_WIRE_B) != 0u) {
            rises[1]++;
        }
    }
}

static void keep_time(uint8_t which, uint8_t end)
{
    clock_stamp at = {0, 0};
    bool is_new = false;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        is_new = (changed & end) != 0u;
        changed &= (uint8_t)~end;
        at.tick = last_tick[which];
        at.count = last_count[which];
    }
    if (is_new) {
        last_us[which] = clock_us_of(at);
    }
}

void loopback_tick(void)
{
    if (changed != 0u) {
        keep_time(0, PIN_WIRE_A);
        keep_time(1, PIN_WIRE_B);
    }
}

/* Low closes the contact that is not there; as an input the pin leaves it to the pull-up of the e-stop's. */
static void open_estop(bool open)
{
    if (open) {
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
        {
            estop_us = clock_us();
            clear_bits(&DDRC, PIN_ESTOP_WIRE);
        }
    } else {
        clear_bits(&PORTC, PIN_ESTOP_WIRE);
        set_bits(&DDRC, PIN_ESTOP_WIRE);
    }
}

static bool estop_becomes(uint8_t level)
{
    bool is = false;
    for (uint8_t i = 0; i < PATIENCE && !is; i++) {
        is = (PIND & PIN_ESTOP) == level;
    }
    return is;
}

static void disconnect(void)
{
    PCICR = BIT(PCIE2);
    PCMSK1 = 0;
    clear_bits(&DDRC, PIN_ESTOP_WIRE);
    clear_bits(&PORTC, PIN_WIRE_A);
    clear_bits(&PORTC, PIN_WIRE_B);
}

static bool connect(void)
{
    disconnect();
    set_bits(&PORTC, PIN_WIRE_A); /* a pull-up: an end without its wire is high */
    set_bits(&PORTC, PIN_WIRE_B);
    open_estop(false);
    bool follows = estop_becomes(0u);
    open_estop(true);
    follows = estop_becomes(PIN_ESTOP) && follows;
    open_estop(false);
    follows = estop_becomes(0u) && follows;
    ends_before = PINC;
    PCMSK1 = (uint8_t)(BIT(PCINT11) | BIT(PCINT12));
    PCICR = (uint8_t)(BIT(PCIE2) | BIT(PCIE1));
    return follows;
}

static inline uint8_t level_of(uint8_t byte, uint8_t which)
{
    return (uint8_t)((uint8_t)(byte >> which) & 1u);
}

/* A look takes as long at a high pin as at a low one, or the share would be wrong. */
static void count_highs(rig_loopback_view *view)
{
    uint16_t wire_a = 0;
    uint16_t wire_b = 0;
    uint16_t output_a = 0;
    uint16_t output_b = 0;
    PCICR = BIT(PCIE2); /* else each edge would hide what follows it */
    for (uint8_t stretch = 1; stretch <= STRETCHES; stretch++) {
        _delay_loop_1(stretch); /* else each period is looked at in the same places */
        for (uint8_t i = 0; i < LOOKS; i++) {
            const uint8_t ends = PINC;    /* PC3 and PC4 */
            const uint8_t outputs = PINB; /* PB1 and the other */
            wire_a += level_of(ends, 3u);
            wire_b += level_of(ends, 4u);
            output_a += level_of(outputs, 1u);
            output_b += level_of(outputs, OTHER);
        }
    }
    PCICR = (uint8_t)(BIT(PCIE2) | BIT(PCIE1));
    view->wire[0].wire_highs = wire_a;
    view->wire[1].wire_highs = wire_b;
    view->wire[0].pin_highs = output_a;
    view->wire[1].pin_highs = output_b;
    view->looks = STRETCHES * LOOKS;
}

static void look(rig_loopback_view *view, bool share)
{
    if (share) {
        count_highs(view);
    }
    loopback_tick(); /* the tick is held */
    view->estop_us = estop_us;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        const uint8_t ends = PINC;
        view->high = (uint8_t)(((ends & PIN_WIRE_A) != 0u ? 1u : 0u) | ((ends & PIN_WIRE_B) != 0u ? 2u : 0u));
        for (uint8_t i = 0; i < 2u; i++) {
            view->wire[i].rises = rises[i];
            view->wire[i].last_us = last_us[i];
        }
    }
}

static void hang_up(void)
{
    for (;;) {
    }
}

const rig_loopback_board LOOPBACK = {
    .begin = connect, .end = disconnect, .open_estop = open_estop, .look = look, .hang_up = hang_up
};
