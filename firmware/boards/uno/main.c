/* The core on an Arduino Uno (ATmega328P, 16 MHz). Wiring: wiring.h.
 *
 * The control tick (sample, checks, relay, drive) is an interrupt of the clock; it lets all others in, which are short.
 * The main loop takes requests, answers them, sends what the tick has collected, and sleeps when there is nothing to do.
 * The hardware watchdog is fed by a tick with a fresh sample after a round of the main loop: that takes both interrupts
 * of the clock, the converter's where it converts the position, and the main loop.
 */
#include <avr/interrupt.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <stddef.h>
#include <util/atomic.h>

#include "adc.h"
#include "bridge.h"
#include "clock.h"
#include "encoder.h"
#include "inputs.h"
#include "loopback.h"
#include "rig_core.h"
#include "uart.h"
#include "wiring.h"

#define BLINK_TICKS 128u

static uint8_t reset_flags __attribute__((section(".noinit")));
static rig_core core;
static volatile bool in_tick; /* the core asks for the position on the grid of the ticks */
static volatile bool has_been_round; /* the main loop, since the last tick */
static uint8_t arrived; /* tick in which the byte arrived that the core is given */

/* Before anything else: after its own reset the hardware watchdog runs on, at 16 ms. */
void early(void) __attribute__((naked, used, section(".init3")));
void early(void)
{
    reset_flags = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

static uint32_t micros(void *context)
{
    (void)context;
    return clock_us();
}

/* The beginning of the tick, so that the watchdog's time ends on the grid of the ticks: at most one of them late, however
 * long the byte has waited and the main loop takes. */
static uint32_t arrived_us(void *context)
{
    const clock_stamp begin = {arrived, 0};
    (void)context;
    return clock_us_of(begin);
}

#if RIG_ENCODER

static int32_t position(void *context, uint32_t *t_us)
{
    (void)context;
    const encoder_sample sample = in_tick ? encoder_tick_sample() : encoder_newest_sample();
    *t_us = sample.t_us;
    return sample.counts;
}

static void set_position(void *context, int32_t counts)
{
    (void)context;
    encoder_set(counts);
}

static uint8_t encoder_troubles(void *context)
{
    (void)context;
    return encoder_take_troubles();
}

static bool take_tick(void)
{
    return encoder_take_tick();
}

#else

static int32_t position(void *context, uint32_t *t_us)
{
    (void)context;
    const adc_sample sample = in_tick ? adc_tick_sample() : adc_newest_sample();
    *t_us = sample.t_us;
    return (int32_t)sample.counts;
}

static bool take_tick(void)
{
    return adc_take_tick();
}

#endif

static uint16_t tach_counts(void *context)
{
    (void)context;
    return RIG_TACHOMETER ? adc_tachometer() : (uint16_t)RIG_TACH_NONE;
}

static void set_drive(void *context, int16_t units)
{
    (void)context;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        bridge_drive(inputs_have_stopped() ? 0 : units);
    }
}

static void transmit(void *context, const uint8_t *bytes, uint8_t n)
{
    (void)context;
    uart_send(bytes, n);
}

static uint8_t inputs(void *context)
{
    (void)context;
    return inputs_take();
}

/* Behind a divider by 4 the converter's 5 V are 20 V. */
static uint8_t supply(void *context)
{
    (void)context;
    return (uint8_t)(adc_supply() >> 2);
}

static void hold_tick(void *context)
{
    (void)context;
    clock_hold_tick();
}

static void release_tick(void *context)
{
    (void)context;
    clock_release_tick();
}

static const rig_board BOARD = {
    .context = NULL,
    .micros = micros,
    .position = position,
    .tach_counts = tach_counts,
    .set_drive = set_drive,
    .transmit = transmit,
    .inputs = inputs,
    .build = RIG_BUILD,
    .counts_max = RIG_ENCODER ? 0 : (int32_t)ADC_MAX,
    .drive_full = BRIDGE_FULL,
    .board_id = RIG_BOARD_UNO,
    .bridge = (uint8_t)RIG_BRIDGE,
    .features = ((RIG_TACHOMETER ? (uint8_t)RIG_FEATURE_TACHOMETER : 0u) | (RIG_SUPPLY ? (uint8_t)RIG_FEATURE_SUPPLY : 0u)) +
                (RIG_ENCODER ? (uint8_t)RIG_FEATURE_ENCODER : 0u),
    .arrived_us = arrived_us,
    .supply = RIG_SUPPLY ? supply : NULL,
#if RIG_ENCODER
    .set_position = set_position,
    .encoder_troubles = encoder_troubles,
#endif
    .loopback = &LOOPBACK,
    .hold_tick = hold_tick,
    .release_tick = release_tick,
};

static void show(void)
{
    static uint8_t ticks;
    ticks++;
    if (core.armed || (core.latched != 0u && (ticks & BLINK_TICKS) != 0u)) {
        set_bits(&PORTB, PIN_LED);
    } else {
        clear_bits(&PORTB, PIN_LED);
    }
}

static void tick(void)
{
    if (!take_tick()) {
        return; /* nothing to decide on; the next row's time tells, and a dead converter the hardware watchdog */
    }
    if (has_been_round) {
        has_been_round = false;
        wdt_reset();
    }
    rig_tick(&core);
    loopback_tick();
    show();
}

/* It lets the others in at once: the receiver holds two bytes. What is to be sent can wait, so that the drive follows the
 * sample after a time that is always the same. Itself it never lets in: a tick that comes due while the one before still
 * runs is left out, and the next row's time tells. */
ISR(TIMER2_COMPB_vect)
{
    if (in_tick) {
        return;
    }
    in_tick = true;
    const uint8_t control = uart_pause_sending();
    sei();
    tick();
    cli();
    uart_resume_sending(control);
    in_tick = false;
}

static void sleep_unless_busy(void)
{
    cli();
    if (has_been_round && !uart_has_byte()) { /* no tick since: nothing to send, either */
        sleep_enable();
        sei(); /* the instruction after it still runs: no interrupt comes between */
        sleep_cpu();
        sleep_disable();
    }
    sei();
}

int main(void)
{
    bridge_init();
    inputs_init();
    set_bits(&DDRB, PIN_LED);
    clock_init();
#if CONVERTS
    adc_init();
#endif
#if RIG_ENCODER
    encoder_init();
#endif
    uart_init();
    SMCR = 0; /* sleep is idle: timers, converter and serial port run on */
    rig_init(&core, &BOARD, reset_flags);
    wdt_enable(WDTO_120MS);
    sei();
    for (;;) {
        uint8_t byte;
        has_been_round = true;
        if (uart_take(&byte, &arrived)) {
            rig_byte(&core, byte);
        }
        rig_stream(&core);
        sleep_unless_busy();
    }
}
