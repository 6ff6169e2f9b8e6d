/* Device time from the chip's timer, 1 us a count, and the control tick: its alarm each millisecond. */
#ifndef RIG_PICO_CLOCK_H
#define RIG_PICO_CLOCK_H

#include <stdint.h>

/* The first tick comes a millisecond later. */
void clock_init(void);

/* Its interrupt waits until clock_release_tick; the others go on. */
void clock_hold_tick(void);
void clock_release_tick(void);

/* First thing in the tick's interrupt: the next one is due on the grid. A tick whose time is over is left out. */
void clock_begin_tick(void);

/* Microseconds since the reset, modulo 2^32. */
uint32_t clock_us(void);

/* When the running tick, or else the last one, was due. */
uint32_t clock_tick_us(void);

#endif
