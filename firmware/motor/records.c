#include "records.h"

/* fmin and fmax of numbers, which compilers have inline. */
static inline double least(double a, double b)
{
    return b < a ? b : a;
}

static inline double most(double a, double b)
{
    return b > a ? b : a;
}

/* The first edge that acts at `now` or before it; where there is none, the first. */
static int64_t edge_at(const plain_drive *drive, double now)
{
    int64_t low = 0;
    int64_t high = drive->edges;
    while (high - low > 1) {
        const int64_t middle = low + (high - low) / 2;
        if (drive->edge_s[middle] + drive->delay_s <= now) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

static double end_of(const plain_drive *drive, int64_t j)
{
    return j + 1 < drive->edges ? drive->edge_s[j + 1] + drive->delay_s : INFINITY;
}

static inline void put(double *row, plain_state at)
{
    row[0] = at.v;
    row[1] = at.y;
    row[2] = at.z;
}

/* The motion, with a row at each time: all of the state, or the position alone. */
static inline void follow(const plain_motor *m, plain_state at, const plain_drive *drive, const double *t_s, int64_t n, double *out, bool whole)
{
    const bool falls = m->stribeck_rad_s > 0.0;
    const double tau = m->tau_s;
    double c[SERIES];
    double now = t_s[0];
    int64_t k = 0;
    for (int64_t j = edge_at(drive, now);; j++) {
        const double end = end_of(drive, j);
        const double drive_V = drive->u_V[j] + m->bias_V;
        while (now < end) {
            const plain_segment s =
                falls ? plain_next_segment(m, at.v, drive_V, end - now, c) : plain_exponential(m, at.v, drive_V, end - now);
            const double until = s.duration_s < end - now ? now + s.duration_s : end;
            const double unit = s.sign * m->stribeck_rad_s;
            while (s.is_series && k < n && t_s[k] < until) {
                const double h = t_s[k] - now;
                if (whole) {
                    put(out + 3 * k, series_state(at, unit, tau, c, h));
                } else {
                    out[k] = at.y + unit * tau * series_path(c, h / tau);
                }
                k++;
            }
            while (!s.is_series && k < n && t_s[k] < until) {
                const plain_state there = plain_glide(at, s.target_rad_s, tau, t_s[k] - now);
                if (whole) {
                    put(out + 3 * k, there);
                } else {
                    out[k] = there.y;
                }
                k++;
            }
            if (k == n) {
                return;
            }
            at = plain_after(m, &s, c, at);
            now = until;
        }
    }
}

void plain_states(const plain_motor *m, const plain_state *start, const plain_drive *drive, const double *t_s, int64_t n, double *out)
{
    follow(m, *start, drive, t_s, n, out, true);
}

void plain_positions(const plain_motor *m, const plain_state *start, const plain_drive *drive, const double *t_s, int64_t n, double *out)
{
    follow(m, *start, drive, t_s, n, out, false);
}

void plain_jacobian(const plain_motor *m, const plain_state *start, const plain_drive *drive, const double *t_s, int64_t n, double *y_rad, double *jacobian)
{
    const double tau = m->tau_s;
    const double K = m->K_rad_s_V;
    const double v0 = start->v;
    const double y0 = start->y;
    plain_state at = *start;
    double now = t_s[0];
    /* derivatives of v and y at the segment's begin by tau, fc, asym, delay, v0 */
    double vt = 0.0, vf = 0.0, va = 0.0, vd = 0.0, v_0 = 1.0;
    double yt = 0.0, yf = 0.0, ya = 0.0, yd = 0.0, y_0 = 0.0;
    int64_t k = 0;
    for (int64_t j = edge_at(drive, now);;) {
        const double end = end_of(drive, j);
        double drive_V = drive->u_V[j] + m->bias_V;
        double target = 0.0;
        while (now < end) {
            const plain_segment s = plain_exponential(m, at.v, drive_V, end - now);
            const bool reverses = s.end_rad_s == 0.0;
            const double until = reverses ? now + s.duration_s : end;
            const double tf = -K * s.sign;
            const double ta = s.sign != 0.0 ? K : 0.0;
            target = s.target_rad_s;
            const double excess = at.v - target;
            while (k < n && t_s[k] < until) {
                const double h = t_s[k] - now;
                const double decay = plain_decay(h, tau);
                const double glide = tau * decay;
                const double drift = h - glide;
                const double y = plain_glide_by(at, target, tau, h, decay).y;
                double *const row = jacobian + 7 * k;
                y_rad[k] = y;
                row[0] = yt + vt * glide + excess * (decay - h / tau * (1.0 - decay));
                /* the motion is linear in K at a given v0 / K */
                row[5] = y_0 + v_0 * glide;
                row[1] = (y - y0 - v0 * row[5]) / K;
                row[2] = yf + vf * glide + tf * drift;
                row[3] = ya + va * glide + ta * drift;
                row[4] = yd + vd * glide;
                row[6] = 1.0;
                k++;
            }
            if (k == n) {
                return;
            }
            const double h = until - now;
            const double decay = plain_decay(h, tau);
            const double keep = 1.0 - decay;
            const double glide = tau * decay;
            const double drift = h - glide;
            yt += vt * glide + excess * (decay - h / tau * keep);
            yf += vf * glide + tf * drift;
            ya += va * glide + ta * drift;
            yd += vd * glide;
            y_0 += v_0 * glide;
            vt = vt * keep + excess * keep * h / (tau * tau);
            vf = vf * keep + tf * decay;
            va = va * keep + ta * decay;
            vd *= keep;
            v_0 *= keep;
            at = plain_glide_by(at, target, tau, h, decay);
            at.z = 0.0;
            now = until;
            if (reverses) {
                at.v = 0.0;
                const double before = target;
                target = plain_target(m, plain_direction(m, 0.0, drive_V), drive_V);
                const double jump = target / before;
                vt *= jump;
                vf *= jump;
                va *= jump;
                vd *= jump;
                v_0 *= jump;
            }
        }
        j++;
        drive_V = drive->u_V[j] + m->bias_V;
        vd += (target - plain_target(m, plain_direction(m, at.v, drive_V), drive_V)) / tau;
    }
}

/* Sign of a value; at exactly zero the previous one stays. */
static double keep_sign(double value, double previous)
{
    if (value > 0.0) {
        return 1.0;
    }
    return value < 0.0 ? -1.0 : previous;
}

void relay_test(const plain_motor *m, const relay_plan *plan, const plain_state *start, double *out)
{
    const double *const t_s = plan->t_s;
    const double *const t_u_s = plan->t_u_s;
    plain_state at = *start;
    double z = 0.0;
    double before = 0.0;
    double acting_V = 0.0;
    double sign_y = 0.0;
    double sign_z = 0.0;
    int64_t applied = 0;
    for (int64_t k = 0; k < plan->rows; k++) {
        double *const row = out + 5 * k;
        double read = at.y + plan->reading_rad[k];
        if (plan->lsb_rad > 0.0) {
            read = floor(read / plan->lsb_rad + 0.5) * plan->lsb_rad;
        }
        if (k == 0) {
            sign_y = sign_z = read >= 0.0 ? 1.0 : -1.0;
        } else {
            z += (t_s[k] - t_s[k - 1]) * 0.5 * (read + before);
            sign_z = keep_sign(z, sign_z);
        }
        sign_y = keep_sign(read, sign_y);
        before = read;
        row[0] = read;
        row[1] = -plan->h1_V * sign_y - plan->h2_V * sign_z;
        row[2] = z;
        row[3] = at.v;
        row[4] = at.y;
        if (k + 1 == plan->rows) {
            return;
        }
        double now = t_s[k];
        const double until = t_s[k + 1];
        while (applied <= k && t_u_s[applied] < until) {
            const double when = most(t_u_s[applied], now);
            at = plain_advance_exponentially(m, at, acting_V + plan->drive_V[k], when - now);
            acting_V = out[5 * applied + 1];
            applied++;
            now = when;
        }
        at = plain_advance_exponentially(m, at, acting_V + plan->drive_V[k], until - now);
    }
}

int64_t test_drive(const plain_motor *m, const test_plan *plan, const plain_state *start, int64_t n, double *u_V, double *states, int64_t *longest)
{
    const double *const first = plan->first;
    const double *const second = plan->second;
    const bool is_relay = plan->strokes == 0;
    const double period_s = plan->period_s;
    const int64_t late = (int64_t)(plan->delay_s / period_s);
    const double part_s = plan->delay_s - (double)late * period_s;
    plain_state at = *start;
    double z = 0.0;
    double before = at.y;
    double sign_y = at.y >= 0.0 ? 1.0 : -1.0;
    double sign_z = sign_y;
    int64_t ended = 0;
    int64_t since = 0;
    int64_t i = !is_relay && at.y * first[0] > 0.0 ? 1 % plan->strokes : 0;
    *longest = 0;
    for (int64_t k = 0; k < n; k++) {
        const double y = at.y;
        if (is_relay) {
            if (k > 0) {
                z += period_s * 0.5 * (y + before);
            }
            before = y;
            sign_y = keep_sign(y, sign_y);
            sign_z = keep_sign(z, sign_z);
            u_V[k] = -first[0] * sign_y - first[1] * sign_z;
        } else {
            if ((first[i] > 0.0 && y >= second[i]) || (first[i] < 0.0 && y <= second[i])) {
                i = (i + 1) % plan->strokes;
                ended++;
                *longest = k - since > *longest ? k - since : *longest;
                since = k;
                if (ended == plan->most_strokes) {
                    return k;
                }
            }
            u_V[k] = first[i];
        }
        states[2 * k] = at.v;
        states[2 * k + 1] = y;
        if (part_s > 0.0) {
            at = plain_advance_exponentially(m, at, k > late ? u_V[k - late - 1] : 0.0, part_s);
        }
        at = plain_advance_exponentially(m, at, k >= late ? u_V[k - late] : 0.0, period_s - part_s);
    }
    *longest = n - since > *longest ? n - since : *longest;
    return n;
}

void test_jacobian(const plain_motor *m, const test_plan *plan, int64_t n, const double *u_V, const double *states, double *work, double *jacobian)
{
    double *const edge_s = work;
    double *const drives_V = edge_s + n + 1;
    double *const t_s = drives_V + n + 1;
    double *const y_rad = t_s + n;
    edge_s[0] = -plan->period_s;
    drives_V[0] = 0.0;
    for (int64_t k = 0; k < n; k++) {
        t_s[k] = (double)k * plan->period_s;
        edge_s[k + 1] = (double)k * plan->period_s + plan->delay_s;
        drives_V[k + 1] = u_V[k];
    }
    const plain_state start = {states[0], states[1], 0.0};
    const plain_drive drive = {edge_s, drives_V, n + 1, 0.0};
    plain_jacobian(m, &start, &drive, t_s, n, y_rad, jacobian);
    for (int64_t k = 0; k < n; k++) {
        jacobian[TEST_WIDTH * k] *= m->tau_s;
        jacobian[TEST_WIDTH * k + 1] *= m->K_rad_s_V;
    }
}

void test_known(const double *full, const double *seen, double *out)
{
    double work[TEST_WIDTH][TEST_WIDTH];
    for (int a = 0; a < TEST_WIDTH; a++) {
        for (int b = 0; b < TEST_WIDTH; b++) {
            work[a][b] = full[TEST_WIDTH * a + b];
        }
    }
    for (int q = TEST_WIDTH - 1; q >= TEST_NUMBERS; q--) {
        const double pivot = work[q][q];
        if (pivot > 0.0) {
            for (int a = 0; a < q; a++) {
                const double share = work[a][q] / pivot;
                for (int b = 0; b < q; b++) {
                    work[a][b] -= share * work[q][b];
                }
            }
        }
    }
    for (int a = 0; a < TEST_NUMBERS; a++) {
        for (int b = 0; b < TEST_NUMBERS; b++) {
            out[TEST_NUMBERS * a + b] = seen[TEST_NUMBERS * a + b] + work[a][b];
        }
    }
}

bool test_variances(const double *information, double out[3])
{
    enum { P = TEST_NUMBERS };
    double work[P][2 * P];
    double scale[P];
    for (int a = 0; a < P; a++) {
        const double own = information[P * a + a];
        if (!(own > 0.0)) {
            return false;
        }
        scale[a] = 1.0 / sqrt(own);
    }
    for (int a = 0; a < P; a++) {
        for (int b = 0; b < P; b++) {
            work[a][b] = information[P * a + b] * scale[a] * scale[b];
            work[a][P + b] = a == b ? 1.0 : 0.0;
        }
    }
    for (int q = 0; q < P; q++) {
        const double pivot = work[q][q];
        if (!(pivot > 1e-11)) { /* of a matrix with a unit diagonal that is positive definite */
            return false;
        }
        for (int b = 0; b < 2 * P; b++) {
            work[q][b] /= pivot;
        }
        for (int a = 0; a < P; a++) {
            if (a != q) {
                const double factor = work[a][q];
                for (int b = 0; b < 2 * P; b++) {
                    work[a][b] -= factor * work[q][b];
                }
            }
        }
    }
    for (int a = 0; a < 3; a++) {
        out[a] = work[a][P + a] * scale[a] * scale[a];
    }
    return true;
}

double test_rows(const double *jacobian, int64_t n, double noise_rad2, const double *seen, const double wanted[3], int64_t every, double *information)
{
    double full[TEST_WIDTH * TEST_WIDTH] = {0.0};
    double ratio = INFINITY;
    for (int64_t k = 0; k < n; k++) {
        const double *const row = jacobian + TEST_WIDTH * k;
        for (int a = 0; a < TEST_WIDTH; a++) {
            for (int b = 0; b <= a; b++) {
                full[TEST_WIDTH * a + b] += row[a] * row[b] / noise_rad2;
            }
        }
        if ((k + 1) % every != 0 && k + 1 != n) {
            continue;
        }
        for (int a = 0; a < TEST_WIDTH; a++) {
            for (int b = 0; b < a; b++) {
                full[TEST_WIDTH * b + a] = full[TEST_WIDTH * a + b];
            }
        }
        test_known(full, seen, information);
        const double before = ratio;
        double found[3];
        ratio = INFINITY;
        if (test_variances(information, found)) {
            ratio = 0.0;
            for (int i = 0; i < 3; i++) {
                ratio = most(ratio, sqrt(found[i]) / wanted[i]);
            }
        }
        if (ratio <= 1.0) {
            const double share = before < INFINITY ? log(before) / log(before / ratio) : 1.0;
            return (double)(k + 1) - (double)every * (1.0 - share);
        }
    }
    return (double)n * ratio * ratio;
}

void test_bounds(const double *states, int64_t n, double horizon_s, double out[5])
{
    for (int i = 0; i < 5; i++) {
        out[i] = 0.0;
    }
    for (int64_t k = 0; k < n; k++) {
        const double v = states[2 * k];
        const double y = states[2 * k + 1];
        const double stop = y + v * horizon_s;
        out[0] = least(out[0], y);
        out[1] = most(out[1], y);
        out[2] = most(out[2], fabs(v));
        out[3] = least(out[3], stop);
        out[4] = most(out[4], stop);
    }
}
