#include "windows.h"

#include <math.h>
#include <string.h>

#include "records.h"

enum { FRAME = 4, START = 4, PLAIN_WIDTH = 7 };

/* Of a start that a piece does not show: so little of its own sum, and next to nothing, make its block one to solve. */
static const double REGULAR = 1e-12;
static const double NEXT_TO_NOTHING = 1e-300;

void windows_readings(const double *numbers, const real_window *windows, int64_t count, const double *starts, const real_columns *columns, double *y_rad, double *jacobian)
{
    double all[REAL_NUMBERS + FRAME];
    real_motor m;
    memcpy(all, numbers, REAL_NUMBERS * sizeof(double));
    for (int64_t i = 0; i < count; i++) {
        real_record record = windows[i].record;
        memcpy(all + REAL_NUMBERS, windows[i].frame, sizeof windows[i].frame);
        memcpy(&m, all, sizeof m);
        record.starts = starts;
        real_readings(&m, &record, columns, y_rad, jacobian);
        starts += START * record.pieces;
        y_rad += record.rows;
        jacobian += record.rows * columns->columns;
    }
}

void windows_plain(const double *numbers, const real_window *windows, int64_t count, const double *starts, const real_columns *columns, double *y_rad, double *jacobian)
{
    const double fc = numbers[2];
    const plain_motor m = {numbers[0], numbers[1], fc, fc, fc, fc, 0.0, numbers[3]};
    const int64_t width = columns->columns;
    for (int64_t i = 0; i < count; i++) {
        const real_record *const record = &windows[i].record;
        const plain_drive drive = {record->edge_s, record->u_V, record->edges, numbers[4]};
        for (int64_t piece = 0; piece < record->pieces; piece++) {
            const int64_t first = record->first[piece];
            const int64_t n = (piece + 1 < record->pieces ? record->first[piece + 1] : record->rows) - first;
            const plain_state start = {starts[0], starts[1], 0.0};
            starts += START;
            if (width == 0) {
                plain_positions(&m, &start, &drive, record->t_s + first, n, y_rad);
            } else {
                plain_jacobian(&m, &start, &drive, record->t_s + first, n, y_rad, columns->work);
                for (int64_t k = 0; k < n; k++) {
                    for (int64_t c = 0; c < width; c++) {
                        *jacobian++ = columns->work[PLAIN_WIDTH * k + columns->which[c]];
                    }
                }
            }
            y_rad += n;
        }
    }
}

void bordered_sums(const bordered_rows *rows, double *own, double *border)
{
    const int64_t m = rows->numbers;
    for (int64_t piece = 0; piece < rows->pieces; piece++) {
        const int64_t last = piece + 1 < rows->pieces ? rows->first[piece + 1] : rows->rows;
        double *const by_v = border + 2 * (m + 1) * piece;
        double *const by_y = by_v + m + 1;
        double vv = 0.0, vy = 0.0, yy = 0.0;
        memset(by_v, 0, (size_t)(2 * (m + 1)) * sizeof(double));
        for (int64_t k = rows->first[piece]; k < last; k++) {
            const double v = rows->by_start[rows->start_stride * k];
            const double y = rows->by_start[rows->start_stride * k + 1];
            const double *const row = rows->by_number + rows->number_stride * k;
            vv += v * v;
            vy += v * y;
            yy += y * y;
            for (int64_t c = 0; c < m; c++) {
                by_v[c] += v * row[c];
                by_y[c] += y * row[c];
            }
            by_v[m] += v * rows->residual[k];
            by_y[m] += y * rows->residual[k];
        }
        own[4 * piece] = vv;
        own[4 * piece + 1] = own[4 * piece + 2] = vy;
        own[4 * piece + 3] = yy;
    }
}

void bordered_reduce(const double *own, const double *border, int64_t pieces, int64_t numbers, double damping, const double *scale, double *matrix, double *solved)
{
    const int64_t width = numbers + 1;
    for (int64_t piece = 0; piece < pieces; piece++) {
        const double *const by_v = border + 2 * width * piece;
        const double *const by_y = by_v + width;
        double *const v = solved + 2 * width * piece;
        double *const y = v + width;
        const double own_v = own[4 * piece] + damping * scale[2 * piece];
        const double own_y = own[4 * piece + 3] + damping * scale[2 * piece + 1];
        const double vv = own_v + REGULAR * own_v + NEXT_TO_NOTHING;
        const double yy = own_y + REGULAR * own_y + NEXT_TO_NOTHING;
        const double vy = own[4 * piece + 1];
        if (fabs(vv) >= fabs(vy)) { /* the larger one of the first column divides */
            const double share = vy / vv;
            const double left = yy - share * vy;
            for (int64_t c = 0; c < width; c++) {
                y[c] = (by_y[c] - share * by_v[c]) / left;
                v[c] = (by_v[c] - vy * y[c]) / vv;
            }
        } else {
            const double share = vv / vy;
            const double left = vy - share * yy;
            for (int64_t c = 0; c < width; c++) {
                y[c] = (by_v[c] - share * by_y[c]) / left;
                v[c] = (by_y[c] - yy * y[c]) / vy;
            }
        }
        for (int64_t r = 0; r < width; r++) {
            for (int64_t c = 0; c < width; c++) {
                matrix[width * r + c] -= by_v[r] * v[c] + by_y[r] * y[c];
            }
        }
    }
}

double normal_step(const double *matrix, const double *vector, const uint8_t *held, int64_t numbers, double *work, double *x)
{
    double *const lower = work; /* row k: what is left of all columns at the k-th pivot, over the root of that */
    double *const left = lower + numbers * numbers;
    double *const scale = left + numbers;
    double *const solved = scale + numbers;
    double *const order = solved + numbers;
    double largest = 0.0;
    double regular = INFINITY;
    int64_t free = 0;
    for (int64_t i = 0; i < numbers; i++) {
        const double own = matrix[(numbers + 1) * i];
        x[i] = left[i] = scale[i] = 0.0;
        if (!held[i]) {
            free++;
            left[i] = 1.0;
            scale[i] = 1.0 / sqrt(own);
            largest = own > largest ? own : largest;
        }
    }
    for (int64_t pivot = 0; pivot < free; pivot++) {
        int64_t at = 0;
        for (int64_t i = 1; i < numbers; i++) {
            at = left[i] > left[at] ? i : at;
        }
        if (!(left[at] > 0.0)) {
            return 0.0;
        }
        double *const row = lower + numbers * pivot;
        const double root = sqrt(left[at]);
        regular = fmin(regular, left[at] / (scale[at] * scale[at]));
        double pull = -scale[at] * vector[at];
        for (int64_t k = 0; k < pivot; k++) {
            pull -= lower[numbers * k + at] * solved[k];
        }
        solved[pivot] = pull / root;
        for (int64_t i = 0; i < numbers; i++) {
            if (left[i] > 0.0) {
                double rest = scale[at] * scale[i] * matrix[numbers * at + i];
                for (int64_t k = 0; k < pivot; k++) {
                    rest -= lower[numbers * k + at] * lower[numbers * k + i];
                }
                row[i] = rest / root;
                left[i] -= row[i] * row[i];
                if (!(left[i] > 0.0) && i != at) {
                    return 0.0;
                }
            }
        }
        row[at] = root;
        left[at] = 0.0;
        order[pivot] = (double)at;
    }
    for (int64_t k = free - 1; k >= 0; k--) {
        const int64_t at = (int64_t)order[k];
        double rest = solved[k];
        for (int64_t j = k + 1; j < free; j++) {
            const int64_t other = (int64_t)order[j];
            rest -= lower[numbers * k + other] * x[other];
        }
        x[at] = rest / lower[numbers * k + at];
    }
    for (int64_t i = 0; i < numbers; i++) {
        x[i] *= scale[i];
    }
    return regular / largest;
}

void windows_filter(const double forward[3], const double back[2], const int64_t *first, int64_t pieces, int64_t rows, int64_t columns, double *values)
{
    for (int64_t piece = 0; piece < pieces; piece++) {
        const int64_t last = piece + 1 < pieces ? first[piece + 1] : rows;
        for (int64_t c = 0; c < columns; c++) {
            double kept = 0.0;
            double later = 0.0;
            for (int64_t k = first[piece]; k < last; k++) {
                double *const at = values + columns * k + c;
                const double x = *at;
                const double y = forward[0] * x + kept;
                kept = forward[1] * x - back[0] * y + later;
                later = forward[2] * x - back[1] * y;
                *at = y;
            }
        }
    }
}
