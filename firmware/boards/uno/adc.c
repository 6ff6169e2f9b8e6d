#include "adc.h"

#include <avr/interrupt.h>
#include <util/atomic.h>

#include "clock.h"
#include "wiring.h"

#define REFERENCE BIT(REFS0)                                        /* AVcc, which feeds the potentiometer, too */
#define PRESCALER ((uint8_t)(BIT(ADPS2) | BIT(ADPS1) | BIT(ADPS0))) /* 125 kHz: 104 us a conversion */
#define IDLE ((uint8_t)(BIT(ADEN) | BIT(ADIE) | PRESCALER))
#define SAMPLE_AFTER_US 12u /* from the start to the hold: 1.5 clocks of the converter */
#define ROUND 8u            /* conversions; they and their interrupts take 0.9 ms */

typedef struct {
    uint16_t counts; /* 0 is a rail: nothing arms before the first conversion */
    clock_stamp started;
} conversion;

static volatile conversion of_tick;
static volatile conversion newest;
static volatile uint16_t tachometer;
static volatile uint16_t motor_supply;
static volatile bool is_fresh; /* of_tick has not been taken yet */

/* Of the interrupts alone. */
static uint8_t turn = ROUND; /* of the conversion that runs; ROUND: none does */
static bool begin_again;
static clock_stamp started;

static uint8_t channel_of(uint8_t which)
{
    if (RIG_SUPPLY && which == ROUND - 1u) {
        return CHANNEL_SUPPLY;
    }
    return RIG_TACHOMETER && (which & 1u) != 0u ? CHANNEL_TACHOMETER : CHANNEL_POSITION;
}

static void start(uint8_t which)
{
    turn = which;
    ADMUX = (uint8_t)(REFERENCE | channel_of(which));
    started = clock_now();
    ADCSRA = (uint8_t)(IDLE | BIT(ADSC));
}

void adc_begin_round(void)
{
    if (turn < ROUND) {
        begin_again = true; /* interrupts were masked for long: the last conversion still runs */
    } else {
        start(0);
    }
}

static inline void keep(volatile conversion *where, uint16_t counts)
{
    where->counts = counts;
    where->started.tick = started.tick;
    where->started.count = started.count;
}

ISR(ADC_vect)
{
    const uint16_t counts = ADC;
    const uint8_t channel = channel_of(turn);
    if (channel == CHANNEL_POSITION) {
        keep(&newest, counts);
        if (turn == 0u) {
            keep(&of_tick, counts);
            is_fresh = true;
        }
    } else if (channel == CHANNEL_TACHOMETER) {
        tachometer = counts;
    } else {
        motor_supply = counts;
    }
    if (begin_again) {
        begin_again = false;
        start(0);
    } else if (turn + 1u < ROUND) {
        start((uint8_t)(turn + 1u));
    } else {
        turn = ROUND;
    }
}

void adc_init(void)
{
    DIDR0 = (uint8_t)(BIT(ADC0D) | BIT(ADC1D) | BIT(ADC2D)); /* no digital inputs at analogue pins */
    ADCSRA = IDLE;
}

static adc_sample sample_of(const volatile conversion *from)
{
    clock_stamp at;
    adc_sample sample;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        sample.counts = from->counts;
        at.tick = from->started.tick;
        at.count = from->started.count;
    }
    sample.t_us = clock_us_of(at) + SAMPLE_AFTER_US;
    return sample;
}

adc_sample adc_tick_sample(void)
{
    return sample_of(&of_tick);
}

adc_sample adc_newest_sample(void)
{
    return sample_of(&newest);
}

static uint16_t reading_of(const volatile uint16_t *from)
{
    uint16_t counts;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        counts = *from;
    }
    return counts;
}

uint16_t adc_tachometer(void)
{
    return reading_of(&tachometer);
}

uint16_t adc_supply(void)
{
    return reading_of(&motor_supply);
}

bool adc_take_tick(void)
{
    if (!is_fresh) {
        return false;
    }
    is_fresh = false;
    return true;
}
