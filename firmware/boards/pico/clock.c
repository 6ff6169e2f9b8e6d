#include "clock.h"

#include "cpu.h"
#include "rig_core.h"
#include "rp2040.h"

/* An alarm fires when the counter equals it, and one that is over fires an hour later (4.6): it lies so far ahead at
 * least, interrupts masked meanwhile. */
#define AHEAD_US 3u
#define BELOW_0 0x7FFFFFFFu /* differences of times above it are negative */

static volatile uint32_t due_us; /* of the running tick, or the last */

/* The alarm of the first tick after `after_us` that is not over yet. */
static void set_alarm(uint32_t after_us)
{
    const uint32_t before = cpu_hold_interrupts();
    uint32_t next_us = after_us + RIG_TICK_US;
    uint32_t ahead_us = next_us - clock_us();
    while (ahead_us < AHEAD_US || ahead_us > BELOW_0) {
        next_us += RIG_TICK_US;
        ahead_us += RIG_TICK_US;
    }
    REG(TIMER_ALARM0) = next_us;
    cpu_restore_interrupts(before);
}

void clock_init(void)
{
    REG(NVIC_IPR0) = PRIORITY_LOWEST; /* all others interrupt it */
    REG(TIMER_INTE) = ALARM_0;
    set_alarm(clock_us());
    clock_release_tick();
}

void clock_hold_tick(void)
{
    REG(NVIC_ICER) = BIT(IRQ_TIMER_0);
    cpu_barrier();
}

void clock_release_tick(void)
{
    cpu_barrier();
    REG(NVIC_ISER) = BIT(IRQ_TIMER_0);
}

void clock_begin_tick(void)
{
    due_us = REG(TIMER_ALARM0);
    REG(TIMER_INTR) = ALARM_0;
    set_alarm(due_us);
}

uint32_t clock_us(void)
{
    return REG(TIMER_TIMERAWL);
}

uint32_t clock_tick_us(void)
{
    return due_us;
}
