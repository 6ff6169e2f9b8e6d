/* The stroke test: each stroke of a plan drives until the position has passed its turning point, then the next does.
 *
 * Decided once a tick from the position's raw counts. A stroke turns in the direction that its drive pushes: where that
 * raises the counts it is over at its turning point or above, else at it or below. A stroke that does not get there is
 * over after its longest time: the next one drives, usually the other way. One stroke ends in a tick at most. After the
 * last stroke the drive is 0.
 *
 */
#ifndef RIG_STROKES_H
#define RIG_STROKES_H

#include <stdbool.h>
#include <stdint.h>

#define STROKES_MAX 21u /* of a plan */
#define STROKE_TICKS_MAX 10000u

typedef struct {
    int32_t turn;   /* counts */
    uint16_t ticks; /* at most */
    int16_t drive;  /* units, not 0 */
} stroke;

typedef struct {
    stroke plan[STROKES_MAX];
    uint8_t n;       /* of them */
    int8_t polarity; /* +1: positive drive raises the counts */
    uint8_t at;      /* the stroke that drives; n: all are over */
    uint16_t ticks;  /* that it has driven */
} strokes;

/* Forgets the plan. */
void strokes_clear(strokes *s);

/* Adds a stroke to a plan that has room for one more. */
void strokes_add(strokes *s, const stroke *next);

/* Whether a stroke has a drive, and a time of 1 to STROKE_TICKS_MAX. */
bool stroke_is_valid(const stroke *one);

/* Begins with the first stroke, at the next step. `polarity` is +1 or -1. */
void strokes_begin(strokes *s, int8_t polarity);

/* Takes this tick's position; returns its drive. */
int16_t strokes_step(strokes *s, int32_t counts);

#endif
