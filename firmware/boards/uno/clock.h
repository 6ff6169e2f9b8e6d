/* Device time from Timer2, 4 us a count, whose period of 1 ms begins the converter's round (adc.h). */
#ifndef RIG_UNO_CLOCK_H
#define RIG_UNO_CLOCK_H

#include <stdint.h>

void clock_init(void);

/* Microseconds since the reset, modulo 2^32, in steps of 4. */
uint32_t clock_us(void);

/* The same with interrupts masked. */
uint32_t clock_us_masked(void);

#endif
