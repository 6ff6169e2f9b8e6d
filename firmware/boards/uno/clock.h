/* Device time from Timer2, 4 us a count, whose period of 1 ms begins the converter's round (adc.h). */
#ifndef RIG_UNO_CLOCK_H
#define RIG_UNO_CLOCK_H

#include <stdint.h>

/* A moment of the last 255 ms, quick to take in an interrupt. */
typedef struct {
    uint8_t tick;  /* ticks since the reset, modulo 256 */
    uint8_t count; /* of the timer since the tick */
} clock_stamp;

void clock_init(void);

/* Microseconds since the reset, modulo 2^32, in steps of 4. */
uint32_t clock_us(void);

/* Ticks since the reset, modulo 256. */
uint8_t clock_tick(void);

/* Now, from an interrupt that does not wait for the tick's. */
clock_stamp clock_now(void);

/* The time of a stamp. */
uint32_t clock_us_of(clock_stamp stamp);

#endif
