/* Device time from Timer2, 4 us a count, with two interrupts in its period of 1 ms. The first begins the converter's
 * round (adc.h). The second, CLOCK_TICK_US later, when the round's first sample is there, is the control tick's.
 */
#ifndef RIG_UNO_CLOCK_H
#define RIG_UNO_CLOCK_H

#include <stdint.h>

/* A moment of the last 255 ms, quick to take in an interrupt. */
typedef struct {
    uint8_t tick;  /* ticks since the reset, modulo 256 */
    uint8_t count; /* of the timer since the tick */
} clock_stamp;

#define CLOCK_TICK_US 160u /* 13 clocks of the converter are 104 us; the rest for interrupts that come first */

void clock_init(void);

/* The control tick's interrupt waits until clock_release_tick; the others go on. */
void clock_hold_tick(void);
void clock_release_tick(void);

/* Microseconds since the reset, modulo 2^32, in steps of 4. */
uint32_t clock_us(void);

/* Ticks since the reset, modulo 256. */
uint8_t clock_tick(void);

/* Now, from an interrupt that does not wait for the tick's. */
clock_stamp clock_now(void);

/* The time of a stamp. */
uint32_t clock_us_of(clock_stamp stamp);

#endif
