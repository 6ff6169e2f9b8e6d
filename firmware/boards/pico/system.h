/* The chip's clocks, its resets and its hardware watchdog. */
#ifndef RIG_PICO_SYSTEM_H
#define RIG_PICO_SYSTEM_H

#include <stdint.h>

/* Crystal, PLLs and clocks: 125 MHz for processor, PWM and serial port, 48 MHz for the converter, 1 MHz for timer and
 * watchdog. Then the peripherals that the program uses come out of reset. */
void system_init(void);

/* Of enum rig_reset_cause. A brown-out is a power-on to this chip. */
uint8_t system_reset_cause(void);

/* From now on the chip is reset unless system_feed_watchdog comes every 120 ms. */
void system_start_watchdog(void);
void system_feed_watchdog(void);

#endif
