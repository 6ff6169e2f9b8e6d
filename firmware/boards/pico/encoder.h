/* A quadrature encoder at GP2 and GP3, four counts for each period of a channel, by the interrupt of both pins.
 *
 * The tick's interrupt takes its sample first of all. At most ENCODER_EDGES_MAX edges are counted in a millisecond: more
 * are a trouble, and whatever is on the wires, the chip keeps three quarters of its time.
 */
#ifndef RIG_PICO_ENCODER_H
#define RIG_PICO_ENCODER_H

#include <stdint.h>

#define ENCODER_EDGES_MAX 250u /* in a millisecond */
#define ENCODER_ALONE_MAX 32u  /* edges of one channel in a row */

void encoder_init(void);

/* An edge of either channel, from the pins' interrupt. */
void encoder_take_edge(void);

/* First thing in the tick. */
void encoder_begin_tick(void);

typedef struct {
    int32_t counts;
    uint32_t t_us; /* device time at which the sample was taken */
} encoder_sample;

/* The tick's position, and the present one. They, and encoder_set, must not come between one another. */
encoder_sample encoder_tick_sample(void);
encoder_sample encoder_newest_sample(void);

/* From now on the present position reads so. */
void encoder_set(int32_t counts);

/* Bits of rig_encoder_trouble since the last call. */
uint8_t encoder_take_troubles(void);

#endif
