/* A quadrature encoder at GP2 and GP3, four counts for each period of a channel, counted by three state machines of the
 * chip: one the position, and one the edges of each channel. They look at the pins at least each 80 ns, and take no time of
 * the processor.
 *
 * The tick's interrupt takes its sample first of all.
 */
#ifndef RIG_PICO_ENCODER_H
#define RIG_PICO_ENCODER_H

#include <stdbool.h>
#include <stdint.h>

#define ENCODER_EDGES_MAX 2000u /* in a millisecond: even a lopsided encoder leaves two looks for each */
#define ENCODER_ALONE_MAX 32u   /* edges of one channel in a row */

void encoder_init(void);

/* First thing in the tick. False if what counts does not answer. */
bool encoder_begin_tick(void);

typedef struct {
    int32_t counts;
    uint32_t t_us; /* device time at which the sample was taken */
} encoder_sample;

/* The tick's position, and the present one. They, and encoder_set, must not come between one another. */
encoder_sample encoder_tick_sample(void);
encoder_sample encoder_newest_sample(void);

/* From now on the present position reads so. */
void encoder_set(int32_t counts);

/* Bits of rig_encoder_trouble since the last call. For the tick. */
uint8_t encoder_take_troubles(void);

#endif
