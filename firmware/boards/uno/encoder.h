/* A quadrature encoder at D2 and D3, four counts for each period of a channel, by the interrupts of both pins.
 *
 * The millisecond's first interrupt takes the tick's sample, on a grid of exactly one tick. The interrupts count modulo
 * 2^16; the position has 32 bits. At most ENCODER_EDGES_MAX edges are counted in a millisecond: more are a trouble, and
 * whatever is on the wires, the chip keeps three quarters of its time.
 */
#ifndef RIG_UNO_ENCODER_H
#define RIG_UNO_ENCODER_H

#include <stdbool.h>
#include <stdint.h>

#define ENCODER_EDGES_MAX 40u /* in a millisecond */
#define ENCODER_ALONE_MAX 32u /* edges of one channel in a row */

void encoder_init(void);

/* Interrupts masked. */
void encoder_begin_tick(void);

typedef struct {
    int32_t counts;
    uint32_t t_us; /* device time at which the sample was taken */
} encoder_sample;

/* The position on the tick's grid, and now. They, and encoder_set, must not come between one another. */
encoder_sample encoder_tick_sample(void);
encoder_sample encoder_newest_sample(void);

/* From now on the present position reads so. */
void encoder_set(int32_t counts);

/* Bits of rig_encoder_trouble since the last call. */
uint8_t encoder_take_troubles(void);

/* Whether a sample has been taken since the last call. */
bool encoder_take_tick(void);

#endif
