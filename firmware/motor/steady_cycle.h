/* The steady cycle under given edges of the relays, in closed form, with its derivatives.
 *
 * Velocity is linear in the drive, and w = y + tau v moves in straight lines. So a periodic motion under given edges needs
 * no iteration. The reversal needs none either: exp(t1 / tau) solves a linear equation. rig/identification/triple_relay.py uses
 * it. theta is log tau, log K, fc for the conditions, and for the curve also asym, position at the first RC edge, and
 * delay of the edges; columns of a Jacobian are in the same order.
 */
#ifndef RIG_STEADY_CYCLE_H
#define RIG_STEADY_CYCLE_H

#include <stdint.h>

enum { CYCLE_CONDITIONS = 5, CYCLE_SHORT = 3, CYCLE_NUMBERS = 6 };

/* Fills `values` (5): z at RC, v at RA, y at RB, y at RA, y at RC, from odd symmetry, and `jacobian` (5, 3). `gains`: h1,
 * h2; `durations`: of the three parts of a half. */
void cycle_conditions(const double theta[CYCLE_SHORT], const double gains[2], const double durations[3], double *values, double *jacobian);

/* A cycle as recorded.
 * gains       h1, h2
 * edges       time from RC to RB and to the next RC, in the half that starts upwards and in the other
 * t_s         times since the half's own RC edge as recorded, before the delay
 * first_half  number of samples of the first half; those of the second are folded: position and drive negated
 */
typedef struct {
    double gains[2], edges[4];
    const double *t_s;
    int64_t samples, first_half;
} cycle_data;

/* Times of the reversal in both halves; 0 where the motor stops before the RC edge. */
void cycle_reversal_times(const double theta[CYCLE_NUMBERS], const cycle_data *data, double times_s[2]);

/* Fills `y` (samples) with positions of the steady cycle, and `jacobian` (samples, 6). */
void cycle_curve(const double theta[CYCLE_NUMBERS], const cycle_data *data, double *y, double *jacobian);

#endif
