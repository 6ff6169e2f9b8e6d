/* Prediction of noise that is partly white and partly coloured (rig/identification/noise.py), sample by sample. */
#ifndef RIG_COLOURED_NOISE_H
#define RIG_COLOURED_NOISE_H

#include <stdint.h>

/* Times of the rows; first rows of the windows, each with coloured noise of its own, whose correlation time is
 * `memory_s`. */
typedef struct {
    const double *t_s;
    const int64_t *starts;
    int64_t rows, windows;
    double memory_s;
} noise_rows;

/* Fills `out` (rows, columns) with the innovations of `table` in units of the white part; returns the sum of log F. F is
 * the variance of each innovation over that of the white noise; all of `out` has the same variance. `ratio`: variance of
 * the coloured noise over that of the white noise. `work`: room for `columns` numbers. */
double noise_innovations(const noise_rows *r, double ratio, const double *table, int64_t columns, double *work, double *out);

/* Fills `out` (count) with -2 log likelihood of the residual (rows) for each ratio, at most 1e18, up to a constant. The
 * scale is profiled out. `work`: room for 5 count numbers. */
void noise_deviances(const noise_rows *r, const double *ratios, int64_t count, const double *residual, double *work, double *out);

#endif
