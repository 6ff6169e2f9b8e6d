/* The core on a Raspberry Pi Pico (RP2040, 125 MHz, one of its two cores). Wiring: wiring.h.
 *
 * The control tick (sample, checks, relay, drive) is an interrupt of the timer; all others come between, and are short.
 * The main loop takes requests, answers them, sends what the tick has collected, and sleeps when there is nothing to do.
 * The hardware watchdog is fed by a tick with a fresh sample after a round of the main loop: that takes the timer, its
 * interrupt, what counts the encoder, the converter where it converts anything, and the main loop.
 */
#include "adc.h"
#include "board.h"
#include "bridge.h"
#include "clock.h"
#include "cpu.h"
#include "encoder.h"
#include "inputs.h"
#include "rig_core.h"
#include "system.h"
#include "uart.h"
#include "wiring.h"

#define BLINK_TICKS 128u

int main(void);
void timer_0_interrupt(void);

static rig_core core;
static volatile bool has_been_round; /* the main loop, since the last tick */
static uint32_t arrived; /* when the tick was due in which the byte arrived that the core is given */

/* The beginning of the tick, so that the watchdog's time ends on the grid of the ticks: at most one of them late. */
uint32_t board_arrived_us(void *context)
{
    (void)context;
    return arrived;
}

void board_set_drive(void *context, int16_t units)
{
    (void)context;
    const uint32_t before = cpu_hold_interrupts();
    bridge_drive(inputs_have_stopped() ? 0 : units);
    cpu_restore_interrupts(before);
}

static void show(void)
{
    static uint8_t ticks;
    ticks++;
    const bool lit = core.armed || (core.latched != 0u && (ticks & BLINK_TICKS) != 0u);
    REG(lit ? SIO_GPIO_OUT_SET : SIO_GPIO_OUT_CLR) = BIT(PIN_LED);
}

void timer_0_interrupt(void)
{
    const bool is_sampled = !RIG_ENCODER || encoder_begin_tick();
    clock_begin_tick();
    if (!is_sampled || !adc_take_all()) {
        return; /* nothing to decide on; the next row's time tells, and the hardware watchdog a dead counter or converter */
    }
    if (has_been_round) {
        has_been_round = false;
        system_feed_watchdog();
    }
    in_tick = true;
    rig_tick(&core);
    in_tick = false;
    show();
}

static void sleep_unless_busy(void)
{
    cpu_mask_interrupts();
    if (has_been_round && !uart_has_byte()) { /* no tick since: nothing to send, either */
        cpu_sleep();
    }
    cpu_let_interrupts_in();
}

int main(void)
{
    const uint8_t cause = system_reset_cause();
    system_init();
    bridge_init();
    inputs_init();
    REG(SIO_GPIO_OUT_SET) = BIT(PIN_QUIET_SUPPLY);
    REG(SIO_GPIO_OE_SET) = BIT(PIN_LED) | BIT(PIN_QUIET_SUPPLY);
    wire_pin(PIN_QUIET_SUPPLY, PAD_OUTPUT, FUNCTION_SIO);
    wire_pin(PIN_LED, PAD_OUTPUT, FUNCTION_SIO);
    adc_init();
    if (RIG_ENCODER) {
        encoder_init();
    }
    uart_init();
    rig_init(&core, &BOARD, cause);
    system_start_watchdog();
    clock_init();
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
