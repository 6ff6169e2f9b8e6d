#include "coloured_noise.h"

#include <math.h>

double noise_innovations(const noise_rows *r, double ratio, const double *table, int64_t columns, double *work, double *out)
{
    double *const restrict state = work;
    double variance = ratio;
    double logs = 0.0;
    int64_t window = 0;
    for (int64_t k = 0; k < r->rows; k++) {
        if (window < r->windows && k == r->starts[window]) {
            for (int64_t c = 0; c < columns; c++) {
                state[c] = 0.0;
            }
            variance = ratio;
            window++;
        } else {
            const double keep = exp(-(r->t_s[k] - r->t_s[k - 1]) / r->memory_s);
            for (int64_t c = 0; c < columns; c++) {
                state[c] *= keep;
            }
            variance = ratio + (variance - ratio) * keep * keep;
        }
        const double spread = variance + 1.0;
        const double gain = variance / spread;
        const double scale = 1.0 / sqrt(spread);
        logs += log(spread);
        const double *const restrict row = table + columns * k;
        double *const restrict white = out + columns * k;
        for (int64_t c = 0; c < columns; c++) {
            const double surprise = row[c] - state[c];
            white[c] = surprise * scale;
            state[c] += gain * surprise;
        }
        variance *= 1.0 - gain;
    }
    return logs;
}

void noise_deviances(const noise_rows *r, const double *ratios, int64_t count, const double *residual, double *work, double *out)
{
    enum { ROWS_OF_A_LOGARITHM = 16 };
    double *const restrict state = work;
    double *const restrict total = state + count;
    double *const restrict logs = total + count;
    double *const restrict variance = logs + count;
    double *const restrict product = variance + count;
    for (int64_t i = 0; i < count; i++) {
        state[i] = total[i] = logs[i] = 0.0;
        variance[i] = ratios[i];
        product[i] = 1.0;
    }
    int64_t window = 0;
    for (int64_t k = 0; k < r->rows; k++) {
        double keep = 0.0;
        if (window < r->windows && k == r->starts[window]) {
            window++;
        } else {
            keep = exp(-(r->t_s[k] - r->t_s[k - 1]) / r->memory_s);
        }
        const double y = residual[k];
        for (int64_t i = 0; i < count; i++) {
            const double v = ratios[i] + (variance[i] - ratios[i]) * keep * keep;
            const double x = state[i] * keep;
            const double inverse = 1.0 / (v + 1.0);
            const double surprise = y - x;
            total[i] += surprise * surprise * inverse;
            product[i] *= v + 1.0;
            state[i] = x + v * inverse * surprise;
            variance[i] = v * inverse;
        }
        if (k % ROWS_OF_A_LOGARITHM == ROWS_OF_A_LOGARITHM - 1) {
            for (int64_t i = 0; i < count; i++) {
                logs[i] += log(product[i]);
                product[i] = 1.0;
            }
        }
    }
    for (int64_t i = 0; i < count; i++) {
        out[i] = (double)r->rows * log(total[i] / (double)r->rows) + logs[i] + log(product[i]);
    }
}
