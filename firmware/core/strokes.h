/* The stroke test: strokes to and fro, again and again, each driven until the position is at its turning point or beyond.
 *
 * Decided once a tick from the position's raw counts, which are compared and never added to: any 32 bits will do. The
 * drives of a plan change their sign from each stroke to the next, and from the last to the first. The first stroke is
 * that of the plan's first two that drives towards the centre.
 *
 * One stroke ends in a tick at most. It fails if its turning point does not come in time, or if the reading stands still
 * for too long; the next one then drives back. After two failed strokes in a row nothing drives any more: the sensor
 * does not show how the shaft moves, or the drive does not move it.
 */
#ifndef RIG_STROKES_H
#define RIG_STROKES_H

#include <stdbool.h>
#include <stdint.h>

#define STROKES_MAX 8u
#define STROKES_FAILED_MAX 2u /* in a row */
#define STROKES_TICKS_MAX 10000u
#define STROKES_REACH_MAX 0xFFFFFu /* counts on either side of the centre, without travel limits: as far as the relay's */

typedef struct {
    int32_t turn;  /* counts */
    int16_t drive; /* units */
} stroke;

typedef struct {
    stroke plan[STROKES_MAX];
    int32_t centre;        /* counts */
    uint16_t stroke_ticks; /* of a stroke, at most */
    uint16_t still_ticks;  /* for which the reading may stand still under one drive, at most */
    uint16_t still_counts; /* readings less than this apart are one position */
    uint8_t n;             /* strokes of the plan */
    int8_t polarity;       /* +1: positive drive raises the counts, -1: lowers */
} strokes_setup;

typedef struct {
    strokes_setup setup;
    int32_t low; /* readings since the standstill began */
    int32_t high;
    uint16_t driven; /* ticks since the stroke began */
    uint16_t still;  /* ticks since the reading moved */
    uint8_t at;      /* of the stroke that drives */
    uint8_t failed;  /* strokes in a row; at STROKES_FAILED_MAX nothing drives */
    bool is_first;   /* no step yet */
    bool is_fresh;   /* no step since the stroke began */
} strokes;

/* Whether it is a plan: an even number of strokes, 2 to STROKES_MAX, to and fro; times of 1 to STROKES_TICKS_MAX; a span of
 * 1 or more. */
bool strokes_are_valid(const strokes_setup *setup);

/* Begins anew with its setup, which must be valid. */
void strokes_begin(strokes *s);

/* Takes this tick's position; returns its drive. */
int16_t strokes_step(strokes *s, int32_t counts);

#endif
