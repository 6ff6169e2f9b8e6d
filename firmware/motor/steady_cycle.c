#include "steady_cycle.h"

#include <math.h>
#include <stdbool.h>

static const double LATEST = 600.0; /* a reversal, in tau */

void cycle_conditions(const double theta[CYCLE_SHORT], const double gains[2], const double durations[3], double *values, double *jacobian)
{
    const double tau = exp(theta[0]);
    const double K = exp(theta[1]);
    const double fc = theta[2];
    const double h1 = gains[0];
    const double h2 = gains[1];
    const double t1 = durations[0];
    const double t2 = durations[1];
    const double t3 = durations[2];
    const double U1 = h1 + h2 + fc;
    const double U2 = h1 + h2 - fc;
    const double U3 = h2 - h1 - fc;
    const double e1 = exp(-t1 / tau);
    const double e2 = exp(-t2 / tau);
    const double e3 = exp(-t3 / tau);
    const double half = t1 + t2 + t3;
    const double whole = e1 * e2 * e3;
    const double forced = U1 * (e2 * e3 - whole) + U2 * (e3 - e2 * e3) + U3 * (1.0 - e3);
    const double v0 = -forced / (1.0 + whole);
    const double area = U1 * t1 + U2 * t2 + U3 * t3;
    /* integral over the half period of w - w(0) */
    const double under = U1 * t1 * (0.5 * t1 + t2 + t3) + U2 * t2 * (0.5 * t2 + t3) + 0.5 * U3 * t3 * t3;
    const double w0 = -0.5 * area;
    const double y0 = w0 - tau * v0;
    const double z0 = -tau * y0 - 0.5 * (w0 * half + under);
    const double v1 = U1 + (v0 - U1) * e1;
    const double v2 = U2 + (v1 - U2) * e2;
    const double y1 = w0 + U1 * t1 - tau * v1;
    const double y2 = w0 + U1 * t1 + U2 * t2 - tau * v2;
    values[0] = K * z0;
    values[1] = K * v1;
    values[2] = K * y2;
    values[3] = K * y1;
    values[4] = K * y0;
    for (int i = 0; i < CYCLE_CONDITIONS; i++) {
        jacobian[3 * i + 1] = values[i];
    }
    for (int by_fc = 0; by_fc < 2; by_fc++) {
        /* directions: tau d/dtau, then d/dfc */
        const double d1 = by_fc ? 1.0 : 0.0;
        const double d2 = -d1;
        const double d3 = -d1;
        const double scale = by_fc ? 0.0 : 1.0 / tau;
        const double m23 = e2 * e3 * (t2 + t3) * scale;
        const double m3 = e3 * t3 * scale;
        const double mw = whole * half * scale;
        const double m1 = e1 * t1 * scale;
        const double m2 = e2 * t2 * scale;
        double dforced = U1 * (m23 - mw) + U2 * (m3 - m23) - U3 * m3;
        dforced += d1 * (e2 * e3 - whole) + d2 * (e3 - e2 * e3) + d3 * (1.0 - e3);
        const double dv0 = -(dforced + v0 * mw) / (1.0 + whole);
        const double dw0 = -0.5 * (d1 * t1 + d2 * t2 + d3 * t3);
        const double dtau = by_fc ? 0.0 : tau;
        const double dy0 = dw0 - tau * dv0 - dtau * v0;
        const double dunder = d1 * t1 * (0.5 * t1 + t2 + t3) + d2 * t2 * (0.5 * t2 + t3) + 0.5 * d3 * t3 * t3;
        const double dz0 = -tau * dy0 - dtau * y0 - 0.5 * (dw0 * half + dunder);
        const double dv1 = d1 * (1.0 - e1) + dv0 * e1 + (v0 - U1) * m1;
        const double dv2 = d2 * (1.0 - e2) + dv1 * e2 + (v1 - U2) * m2;
        double *const column = jacobian + (by_fc ? 2 : 0);
        column[0] = K * dz0;
        column[3] = K * dv1;
        column[6] = K * (dw0 + d1 * t1 + d2 * t2 - tau * dv2 - dtau * v2);
        column[9] = K * (dw0 + d1 * t1 - tau * dv1 - dtau * v1);
        column[12] = K * dy0;
    }
}

/* One half of a cycle.
 * drive   effective drives of its three stages, folded
 * x       exp(t1 / tau), and its derivatives by log tau, fc and asym
 * t1, rb, rc, stop   times of the reversal, of the RB and the RC edge, and of a stop after RB; infinite without one
 * side    sign with which asym enters
 */
typedef struct {
    double drive[3], x[4], t1, rb, rc, stop, side;
} half_cycle;

/* Fills `x` of both halves, from v(t1) = 0 in both and a velocity of period T. A motor that stops before the RC edge, and
 * is held by friction until then, has t1 = 0 in the half that follows. A t1 after RB is put there. */
static void reversals(double tau, half_cycle *up, half_cycle *down)
{
    const double rb1 = up->rb;
    const double rc1 = up->rc;
    const double rb2 = down->rb;
    const double rc2 = down->rc;
    const double e3 = exp(-(rc1 - rb1) / tau);
    const double whole1 = exp(-rc1 / tau);
    const double g3 = exp(-(rc2 - rb2) / tau);
    const double whole2 = exp(-rc2 / tau);
    const double a1 = up->drive[0];
    const double a2 = up->drive[1];
    const double a3 = up->drive[2];
    const double b1 = down->drive[0];
    const double b2 = down->drive[1];
    const double b3 = down->drive[2];
    /* velocity at the end of a half: p - q x, with x = exp(t1 / tau); at its begin: -a1 (x - 1) */
    const double p1 = a3 * (1.0 - e3) + a2 * e3;
    const double q1 = a2 * whole1;
    const double p2 = b3 * (1.0 - g3) + b2 * g3;
    const double q2 = b2 * whole2;
    const double determinant = a1 * b1 - q1 * q2;
    double x1 = (b1 * (p2 + a1) - q2 * (p1 + b1)) / determinant;
    double x2 = (a1 * (p1 + b1) - q1 * (p2 + a1)) / determinant;
    bool stops1 = x1 < 1.0;
    bool stops2 = x2 < 1.0;
    if (stops1) {
        x2 = 1.0 + (p1 - q1) / b1;
        stops2 = x2 < 1.0;
    } else if (stops2) {
        x1 = 1.0 + (p2 - q2) / a1;
        stops1 = x1 < 1.0;
    }
    x1 = x1 < 1.0 ? 1.0 : x1;
    x2 = x2 < 1.0 ? 1.0 : x2;
    up->x[0] = x1;
    down->x[0] = x2;
    const double de3 = e3 * (rc1 - rb1) / tau;
    const double dg3 = g3 * (rc2 - rb2) / tau;
    for (int k = 0; k < 3; k++) {
        double dp1 = 1.0;
        double dq1 = whole1;
        double dp2 = -1.0;
        double dq2 = -whole2;
        double da1 = 1.0;
        double db1 = -1.0;
        if (k == 0) {
            dp1 = (a2 - a3) * de3;
            dq1 = q1 * rc1 / tau;
            dp2 = (b2 - b3) * dg3;
            dq2 = q2 * rc2 / tau;
            da1 = db1 = 0.0;
        } else if (k == 1) {
            dp1 = -1.0;
            dq1 = -whole1;
            db1 = 1.0;
        }
        /* p1 - q1 x1 = b1 (x2 - 1) and p2 - q2 x2 = a1 (x1 - 1), differentiated */
        const double r1 = dp1 + db1 * (1.0 - x2) - dq1 * x1;
        const double r2 = dp2 + da1 * (1.0 - x1) - dq2 * x2;
        if (stops1 || stops2) {
            up->x[1 + k] = stops1 ? 0.0 : r2 / a1;
            down->x[1 + k] = stops2 ? 0.0 : r1 / b1;
        } else {
            up->x[1 + k] = (b1 * r2 - q2 * r1) / determinant;
            down->x[1 + k] = (a1 * r1 - q1 * r2) / determinant;
        }
    }
}

/* A reversal after RB is put there; with it go its time, and when the motor would stop after RB. */
static void timed(double tau, half_cycle *half)
{
    const double ratio = half->rb / tau;
    const double latest = LATEST < ratio ? LATEST : ratio;
    if (half->x[0] > exp(latest)) {
        half->x[0] = exp(latest);
        half->x[1] = -latest * half->x[0];
        half->x[2] = half->x[3] = 0.0;
    }
    half->t1 = tau * log(half->x[0]);
    const double speed = -half->drive[1] * expm1((half->t1 - half->rb) / tau);
    half->stop = speed > 0.0 && 0.0 > half->drive[2] ? half->rb + tau * log1p(-speed / half->drive[2]) : INFINITY;
}

/* Folded displacement since the RC edge for K = 1, its derivatives by log tau, fc and asym, and the velocity. */
typedef struct {
    double d, by_tau, by_fc, by_asym, v;
} travelled;

static travelled travel(double tau, const half_cycle *half, double t)
{
    const bool held = t >= half->stop;
    t = half->stop < t ? half->stop : t; /* where it stops the velocity is 0, so that the time of the stop has no derivative */
    const double A1 = half->drive[0];
    const double A2 = half->drive[1];
    const double A3 = half->drive[2];
    const double *const x = half->x;
    const double t1 = half->t1;
    const double rb = half->rb;
    const double side = half->side;
    const double share = 1.0 / x[0];
    const double m = exp((t1 - t) / tau);
    const double m_0 = m * (x[1] * share + t / tau);
    const double m_1 = m * x[2] * share;
    const double m_2 = m * x[3] * share;
    double v, v_0, v_1, v_2, p, p_0, p_1, p_2;
    if (t < t1) {
        v = A1 * (1.0 - m);
        v_0 = -A1 * m_0;
        v_1 = (1.0 - m) - A1 * m_1;
        v_2 = side * (1.0 - m) - A1 * m_2;
        p = A1 * t;
        p_0 = 0.0;
        p_1 = t;
        p_2 = side * t;
    } else {
        const double second = (rb < t ? rb : t) - t1;
        const double jump = tau * (A1 - A2) * share;
        p = A1 * t1 + A2 * second;
        p_0 = jump * x[1] + (A1 - A2) * t1;
        p_1 = jump * x[2] + t1 - second;
        p_2 = jump * x[3] + side * t;
        if (t < rb) {
            v = A2 * (1.0 - m);
            v_0 = -A2 * m_0;
        } else {
            const double third = t - rb;
            const double n = exp(-third / tau);
            p += A3 * third;
            p_1 -= third;
            v = A3 * (1.0 - n) + A2 * (n - m);
            v_0 = (A2 - A3) * n * third / tau - A2 * m_0;
        }
        v_1 = -(1.0 - m) - A2 * m_1;
        v_2 = side * (1.0 - m) - A2 * m_2;
    }
    const double gained = v + A1 * (x[0] - 1.0);
    const travelled way = {
        p - tau * gained,
        p_0 - tau * (v_0 + A1 * x[1] + gained),
        p_1 - tau * (v_1 + A1 * x[2] + x[0] - 1.0),
        p_2 - tau * (v_2 + A1 * x[3] + side * (x[0] - 1.0)),
        held ? 0.0 : v,
    };
    return way;
}

static half_cycle half_of(const double *theta, const cycle_data *data, double side)
{
    const double h1 = data->gains[0];
    const double h2 = data->gains[1];
    const double fc = theta[2];
    const double a = side * theta[3];
    const int at = side > 0.0 ? 0 : 2;
    const half_cycle half = {
        {h1 + h2 + fc + a, h1 + h2 - fc + a, h2 - h1 - fc + a},
        {0.0, 0.0, 0.0, 0.0},
        0.0,
        data->edges[at],
        data->edges[at + 1],
        INFINITY,
        side,
    };
    return half;
}

static void both_halves(const double *theta, const cycle_data *data, half_cycle *up, half_cycle *down)
{
    const double tau = exp(theta[0]);
    *up = half_of(theta, data, 1.0);
    *down = half_of(theta, data, -1.0);
    reversals(tau, up, down);
    timed(tau, up);
    timed(tau, down);
}

void cycle_reversal_times(const double theta[CYCLE_NUMBERS], const cycle_data *data, double times_s[2])
{
    half_cycle up;
    half_cycle down;
    both_halves(theta, data, &up, &down);
    times_s[0] = up.t1;
    times_s[1] = down.t1;
}

void cycle_curve(const double theta[CYCLE_NUMBERS], const cycle_data *data, double *y, double *jacobian)
{
    const double tau = exp(theta[0]);
    const double K = exp(theta[1]);
    const double offset = theta[4];
    const double delay = theta[5];
    half_cycle up;
    half_cycle down;
    both_halves(theta, data, &up, &down);
    const travelled top = travel(tau, &up, up.rc);
    const travelled bottom = travel(tau, &down, down.rc);
    for (int64_t n = 0; n < data->samples; n++) {
        const bool first = n < data->first_half;
        const double t = data->t_s[n] - delay;
        travelled way;
        /* After the delay a sample may lie in the half before. From the first RC edge the motor moves away through one
         * half, and back through the other. Before that edge it is on its way back. */
        if (first == (t >= 0.0)) {
            way = travel(tau, &up, first ? t : t + up.rc);
        } else {
            const travelled back = travel(tau, &down, first ? t + down.rc : t);
            const travelled *const end = first ? &bottom : &top;
            way.d = end->d - back.d;
            way.by_tau = end->by_tau - back.by_tau;
            way.by_fc = end->by_fc - back.by_fc;
            way.by_asym = end->by_asym - back.by_asym;
            way.v = -back.v;
        }
        const double fold = first ? 1.0 : -1.0;
        double *const row = jacobian + CYCLE_NUMBERS * n;
        y[n] = fold * (offset + K * way.d);
        row[0] = fold * K * way.by_tau;
        row[1] = fold * K * way.d;
        row[2] = fold * K * way.by_fc;
        row[3] = fold * K * way.by_asym;
        row[4] = fold;
        row[5] = -fold * K * way.v;
    }
}
