#include "system.h"

#include <stdbool.h>

#include "rig_core.h"
#include "rp2040.h"

#define XOSC_MS_1 47u /* in 256 periods of the 12 MHz: 2.16 */
#define TICK_CYCLES 12u /* of the crystal: 1 us */
#define WATCHDOG_LOAD_120_MS 240000u /* it counts down by 2 each microsecond: erratum RP2040-E1 */
#define OURS 0x52494721u /* in a register that outlives all resets but a hard one */
#define USED (RESETS_IO_BANK0 | RESETS_PADS_BANK0 | RESETS_PWM | RESETS_TIMER | RESETS_UART0 | RESETS_PIO0 | RESETS_PIO1)

static void bring_up(uint32_t peripherals)
{
    CLEAR_BITS(RESETS_RESET, peripherals);
    while ((REG(RESETS_DONE) & peripherals) != peripherals) {
    }
}

/* 12 MHz * times / first / second */
static void start_pll(uint32_t pll, uint32_t times, uint32_t first, uint32_t second)
{
    REG(pll + PLL_CS) = 1u; /* reference divided by 1 */
    REG(pll + PLL_FBDIV_INT) = times;
    CLEAR_BITS(pll + PLL_PWR, PLL_PD | PLL_VCOPD);
    while ((REG(pll + PLL_CS) & PLL_LOCK) == 0u) {
    }
    REG(pll + PLL_PRIM) = (first << 16) | (second << 12);
    CLEAR_BITS(pll + PLL_PWR, PLL_POSTDIVPD); /* last: the dividers start with the right numbers */
}

void system_init(void)
{
    REG(XOSC_STARTUP) = XOSC_MS_1;
    REG(XOSC_CTRL) = XOSC_ENABLE_1_15_MHZ;
    while ((REG(XOSC_STATUS) & XOSC_STABLE) == 0u) {
    }
    REG(CLK_REF_CTRL) = CLK_REF_XOSC;
    while ((REG(CLK_REF_SELECTED) & BIT(CLK_REF_XOSC)) == 0u) {
    }
    bring_up(RESETS_PLL_SYS | RESETS_PLL_USB);
    start_pll(PLL_SYS, 125u, 6u, 2u); /* 1500 MHz, 125 MHz */
    start_pll(PLL_USB, 100u, 5u, 5u); /* 1200 MHz, 48 MHz */
    REG(CLK_SYS_CTRL) = CLK_SYS_AUX;
    while ((REG(CLK_SYS_SELECTED) & BIT(CLK_SYS_AUX)) == 0u) {
    }
    REG(CLK_PERI_CTRL) = CLK_ENABLE;
    REG(CLK_ADC_CTRL) = CLK_ENABLE;
    REG(WATCHDOG_TICK) = TICK_CYCLES | WATCHDOG_TICK_ENABLE; /* the timer's, too: before it comes out of reset */
    bring_up(USED | RESETS_ADC); /* after the converter's clock, without which it never is done */
}

uint8_t system_reset_cause(void)
{
    /* The boot program, too, restarts the chip by the watchdog: after it has written a new program. */
    const bool was_ours = REG(WATCHDOG_SCRATCH0) == OURS;
    REG(WATCHDOG_SCRATCH0) = 0;
    if (REG(WATCHDOG_REASON) != 0u && was_ours) {
        return (uint8_t)RIG_RESET_WATCHDOG;
    }
    const uint32_t had = REG(CHIP_RESET);
    return (uint8_t)(((had & HAD_RUN) != 0u ? (unsigned)RIG_RESET_EXTERNAL : 0u) |
                     ((had & HAD_POR) != 0u ? (unsigned)RIG_RESET_POWER_ON : 0u));
}

void system_start_watchdog(void)
{
    REG(PSM_WDSEL) = PSM_ALL_BUT_OSCILLATORS;
    REG(WATCHDOG_SCRATCH0) = OURS;
    system_feed_watchdog();
    REG(WATCHDOG_CTRL) = WATCHDOG_ENABLE; /* and no pause while a debugger holds the processor: the bridge would drive on */
}

void system_feed_watchdog(void)
{
    REG(WATCHDOG_LOAD) = WATCHDOG_LOAD_120_MS;
}
