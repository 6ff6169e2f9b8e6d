/* The steady cycle under given edges of the relays, in closed form, with its derivatives, and fits to it.
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

/* What a cycle is fitted to.
 * gains       h1, h2
 * edges       time from RC to RB and to the next RC, in the half that starts upwards and in the other; or the durations
 * t_s         times since the half's own RC edge as recorded, before the delay; none for the conditions
 * measured, weight   target of the curve or of the conditions (n), and one over the size of an error
 * first_half  number of samples of the first half; those of the second are folded: position and drive negated
 */
typedef struct {
    double gains[2], edges[4];
    const double *t_s, *measured, *weight;
    int64_t samples, first_half;
} cycle_data;

/* Times of the reversal in both halves; 0 where the motor stops before the RC edge. */
void cycle_reversal_times(const double theta[CYCLE_NUMBERS], const cycle_data *data, double times_s[2]);

/* Fills `y` (samples) with positions of the steady cycle, and `jacobian` (samples, 6). */
void cycle_curve(const double theta[CYCLE_NUMBERS], const cycle_data *data, double *y, double *jacobian);

/* Range of theta, steps that end the search, damping of the first step, iterates at most. The delay goes up to its
 * bounds and stays there. */
typedef struct {
    const double *low, *high, *tolerance;
    double damping;
    int64_t most_iterates;
} cycle_search;

/* Room for cycle_solve with so many residuals and numbers. */
#define CYCLE_WORK(residuals, numbers) (2 * (residuals) * (1 + (numbers)))

/* Damped Gauss-Newton: changes `theta` (numbers) where `is_free`. `numbers` is 6 for a curve and 3 for the conditions.
 * `iterates` is filled with theta at each iteration, the start first; returns how many there are, and in `cost` the sum of
 * squares. The damping grows until a step lowers the sum, then it falls. */
int64_t cycle_solve(double *theta, int64_t numbers, const uint8_t *is_free, const cycle_data *data, const cycle_search *search, double *work, double *iterates, double *cost);

#endif
