/* The emulated device: the core of the firmware on a board that is wired to the bench. Time comes from outside, so
 * it runs in real time (main.c) as well as in virtual time (virtual.c).
 */
#ifndef RIG_DEVICE_H
#define RIG_DEVICE_H

#include "bench.h"
#include "rig_core.h"

typedef struct {
    bench bench;
    rig_core core;
    rig_board board;
    struct {           /* an encoder's counter */
        int64_t steps;  /* of the shaft, at the last look */
        int32_t counts;
        unsigned levels, edges; /* of its channels; since the tick began */
        unsigned last, alone; /* channel of the last edge; further edges of it in a row */
        uint8_t troubles;
    } encoder;
    double reset_t_s;  /* where the device's clock began */
    uint32_t ticks;    /* done since then */
    void (*transmit)(void *context, const uint8_t *bytes, uint8_t n);
    void (*drive_changed)(void *context); /* may be NULL */
    void *context;                        /* of both */
} device;

/* Powers on at time 0. `p` must have passed bench_check. The struct must not move afterwards: the core points
 * into it. `transmit` gets each reply; `drive_changed` is told of each change at the pin. */
void device_init(device *d, const bench_params *p, void (*transmit)(void *, const uint8_t *, uint8_t),
                 void (*drive_changed)(void *), void *context);

/* A reset at the present time: the pins go to 0 by hardware, the clock starts anew. */
void device_reset(device *d, uint8_t cause);

/* Time at which the next tick is due, s. */
double device_next_tick_s(const device *d);

/* One tick, at device_next_tick_s. */
void device_tick(device *d);

void device_byte(device *d, uint8_t byte);

#endif
