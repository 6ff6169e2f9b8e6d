#include "clock.h"

#include <avr/cpufunc.h>
#include <avr/interrupt.h>
#include <util/atomic.h>

#include "adc.h"
#include "encoder.h"
#include "wiring.h"

#define COUNTS_PER_TICK 250u /* 16 MHz / 64 / 250 = 1 kHz */
#define US_PER_COUNT 4u
#define US_PER_TICK 1000u

static volatile uint32_t tick_us; /* device time of the last tick */
static volatile uint8_t ticks;

void clock_init(void)
{
    OCR2A = (uint8_t)(COUNTS_PER_TICK - 1u);
    OCR2B = (uint8_t)(CLOCK_TICK_US / US_PER_COUNT - 1u);
    TCCR2A = BIT(WGM21);
    TCCR2B = BIT(CS22);
    clock_release_tick();
}

/* What is in registers goes to memory before, and is read anew after. */
void clock_hold_tick(void)
{
    TIMSK2 = BIT(OCIE2A);
    _MemoryBarrier();
}

void clock_release_tick(void)
{
    _MemoryBarrier();
    TIMSK2 = (uint8_t)(BIT(OCIE2A) | BIT(OCIE2B));
}

ISR(TIMER2_COMPA_vect)
{
    tick_us += US_PER_TICK;
    ticks++;
#if CONVERTS
    adc_begin_round();
#endif
#if RIG_ENCODER
    encoder_begin_tick();
#endif
}

static uint32_t since_tick_us(uint8_t count)
{
    return (uint32_t)count * US_PER_COUNT;
}

uint32_t clock_us(void)
{
    uint32_t us;
    uint8_t count;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        count = TCNT2;
        us = tick_us;
        if ((TIFR2 & BIT(OCF2A)) != 0u && count < COUNTS_PER_TICK / 2u) {
            us += US_PER_TICK; /* this tick's interrupt still waits */
        }
    }
    return us + since_tick_us(count);
}

uint8_t clock_tick(void)
{
    return ticks;
}

clock_stamp clock_now(void)
{
    const clock_stamp now = {ticks, TCNT2};
    return now;
}

uint32_t clock_us_of(clock_stamp stamp)
{
    uint32_t us;
    uint8_t age;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        us = tick_us;
        age = (uint8_t)(ticks - stamp.tick);
    }
    return us - (uint32_t)age * US_PER_TICK + since_tick_us(stamp.count);
}
