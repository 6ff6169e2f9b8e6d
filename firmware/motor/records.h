/* The motor without parts over the samples of a record: its motion, the derivatives, a relay test, a planned test.
 *
 * Rows are numbered from 0. A matrix is given row by row.
 */
#ifndef RIG_RECORDS_H
#define RIG_RECORDS_H

#include <stdint.h>

#include "plain_motor.h"

/* Edges, non-decreasing, the drives that act from them on, and by how much later all of them do. Before the first edge
 * the drive is that edge's. At least one. */
typedef struct {
    const double *edge_s, *u_V;
    int64_t edges;
    double delay_s;
} plain_drive;

/* Fills `out` with v, y, z (n, 3), or with the positions alone (n), at the times `t_s`, non-decreasing. `start`: at the
 * first of them. */
void plain_states(const plain_motor *m, const plain_state *start, const plain_drive *drive, const double *t_s, int64_t n, double *out);
void plain_positions(const plain_motor *m, const plain_state *start, const plain_drive *drive, const double *t_s, int64_t n, double *out);

/* Fills positions (n) and their derivatives (n, 7) by tau, K, fc, asym, delay, v0, y0; no Stribeck effect. fc is the
 * motor's level in both directions, and asym its bias. */
void plain_jacobian(const plain_motor *m, const plain_state *start, const plain_drive *drive, const double *t_s, int64_t n, double *y_rad, double *jacobian);

/* A relay test: times of the samples, and at which each sample's drive acts; what is added to the readings, rad, and to
 * the drives, V; step of the reading, rad, 0 for none. */
typedef struct {
    const double *t_s, *t_u_s, *reading_rad, *drive_V;
    double h1_V, h2_V, lsb_rad;
    int64_t rows;
} relay_plan;

/* Fills `out` (rows, 5): position as read, drive, integral of what was read, true velocity, true position. */
void relay_test(const plain_motor *m, const relay_plan *plan, const plain_state *start, double *out);

/* A planned test: a relay of the gains `first`, h1 and h2; or strokes of the drives `first` to the turning points
 * `second`. Sampling period, and from a sample until its drive acts. `most_strokes`: it ends when so many have. */
typedef struct {
    const double *first, *second;
    double period_s, delay_s;
    int64_t strokes, most_strokes; /* 0 strokes: a relay */
} test_plan;

/* Fills `u_V` (n) and `states` (n, 2), velocity and position at each sample, without noise. Until the first drive acts
 * there is none. Returns how many rows it took until the strokes had ended, or all; `longest`: rows of the longest. */
int64_t test_drive(const plain_motor *m, const test_plan *plan, const plain_state *start, int64_t n, double *u_V, double *states, int64_t *longest);

/* Fills `jacobian` (n, 7) of that test's positions by log tau, log K, fc, asym, delay, v0, y0. `states`: the first is
 * the start. `work`: room for 4 n + 2 numbers. */
void test_jacobian(const plain_motor *m, const test_plan *plan, int64_t n, const double *u_V, const double *states, double *work, double *jacobian);

enum { TEST_NUMBERS = 5, TEST_WIDTH = 7 }; /* log tau, log K, fc, asym, delay; and the start, which no test tells */

/* Fills `out` (5, 5): the information `seen` and that of rows, `full` (7, 7), without what the starts take. */
void test_known(const double *full, const double *seen, double *out);

/* Fills the variances of log tau, log K and fc; false where the information (5, 5) does not separate them. */
bool test_variances(const double *information, double out[3]);

/* Rows until the deviations of log tau, log K and fc are within `wanted`.
 *
 * `noise_rad2`: variance of a reading. `seen` (5, 5): information before the first row. It looks after each `every` rows,
 * and at the last; between two looks the logarithm of the deviation falls evenly. If the rows are too few: as many as it
 * takes if information goes on as it came in until then. `information` (5, 5) gets all that there is at the end. */
double test_rows(const double *jacobian, int64_t n, double noise_rad2, const double *seen, const double wanted[3], int64_t every, double *information);

/* Lowest and highest position, largest speed, lowest and highest stop that a guard predicts, of `states` (n, 2). */
void test_bounds(const double *states, int64_t n, double horizon_s, double out[5]);

#endif
