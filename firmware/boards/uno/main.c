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
#include <util/atomic.h>

#include "adc.h"
#include "board.h"
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

/* The beginning of the tick, so that the watchdog's time ends on the grid of the ticks: at most one of them late, however
 * long the byte has waited and the main loop takes. */
uint32_t board_arrived_us(void *context)
{
    const clock_stamp begin = {arrived, 0};
    (void)context;
    return clock_us_of(begin);
}

void board_set_drive(void *context, int16_t units)
{
    (void)context;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        bridge_drive(inputs_have_stopped() ? 0 : units);
    }
}

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
    if (!(RIG_ENCODER ? encoder_take_tick() : adc_take_tick())) {
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
