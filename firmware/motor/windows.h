/* Records in windows, all read in one call, and least squares over their pieces: each piece has a start of its own, two
 * numbers that no other row tells of, so that the normal equations have a 2 x 2 block for each.
 *
 * A matrix is given row by row.
 */
#ifndef RIG_WINDOWS_H
#define RIG_WINDOWS_H

#include <stdint.h>

#include "real_readings.h"

/* A record, whose `starts` are not looked at, and the frame that parts over position and time refer to in it. */
typedef struct {
    real_record record;
    double frame[4];
} real_window;

/* Readings of all windows, one after the other, and their Jacobian, as real_readings. `numbers`: of the motor, without a
 * frame. `starts`: four numbers for each piece of all windows. */
void windows_readings(const double *numbers, const real_window *windows, int64_t count, const double *starts, const real_columns *columns, double *y_rad, double *jacobian);

/* The same of a motor without parts, by its closed form. `which` of the columns: place of each among tau, K, fc, bias,
 * delay, v0, y0. `work`: room for seven numbers for each row of the longest piece. */
void windows_plain(const double *numbers, const real_window *windows, int64_t count, const double *starts, const real_columns *columns, double *y_rad, double *jacobian);

/* Rows of least squares: residual (n), derivatives by m numbers (n, m) and by the own piece's start (n, 2), of which a row
 * is `number_stride` and `start_stride` numbers behind the one before; first rows (p). */
typedef struct {
    const double *residual, *by_number, *by_start;
    const int64_t *first;
    int64_t rows, numbers, pieces, number_stride, start_stride;
} bordered_rows;

/* Fills sums of products within each piece: of the starts `own` (p, 2, 2), and of them with the numbers and the residual,
 * `border` (p, 2, m + 1). */
void bordered_sums(const bordered_rows *rows, double *own, double *border);

/* Takes the starts out of the normal equations `matrix` (m + 1, m + 1), the last column of which is the residual's.
 * `damping`: share of `scale` (p, 2) that is added to the starts' own sums. `solved` (p, 2, m + 1): what each start is for
 * one of each column. */
void bordered_reduce(const double *own, const double *border, int64_t pieces, int64_t numbers, double damping, const double *scale, double *matrix, double *solved);

/* Solves matrix x = -vector, of `numbers` numbers, for those that are not `held` (1 each; those stay 0), by Cholesky's
 * factors of the matrix scaled to a diagonal of 1, the largest one first. `work`: room for numbers (numbers + 4) numbers.
 * Returns how regular the matrix is: its least pivot over its largest number, 0 of a singular one. */
double normal_step(const double *matrix, const double *vector, const uint8_t *held, int64_t numbers, double *work, double *x);

/* Filters the columns of `values` (rows, columns) in place, from nothing on at each piece: y_k = f0 x_k + f1 x_(k-1) +
 * f2 x_(k-2) - b0 y_(k-1) - b1 y_(k-2). `first`: first rows of the pieces. */
void windows_filter(const double forward[3], const double back[2], const int64_t *first, int64_t pieces, int64_t rows, int64_t columns, double *values);

#endif
