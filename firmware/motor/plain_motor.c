/* The step of plain_motor.h: its events, and motion under Stribeck friction by Taylor series of bounded truncation.
 *
 * The right side of x' = e - x - b expm1(-x) is analytic, so x is a power series in time. So are position and integral
 * of position, its integrals.
 *
 * The step. With B = b exp(-x0), on the disc |x - x0| <= R the right side is at most M = |x0'| + R + B (exp(R) - 1) and
 * its slope at most L = 1 + B exp(R). So the solution is analytic, and stays in the disc, at least for |t| < rho =
 * max(R / M, ln(1 + R L / |x0'|) / L) (Picard; Gronwall). By Cauchy's estimate the k-th term at t is at most
 * R (t / rho)^k. Steps end at rho / RATIO, so the terms beyond the order add up to at most R RATIO^-order / (RATIO - 1),
 * 2e-14 R. In practice they are below rounding, because rho is about half of the true radius.
 *
 * Where b exp(-x) is below rounding, the closed form of docs/theory.md 1.3 takes over.
 */
#include "plain_motor.h"

static const double RATIO = 4.0;
static const double NEGLIGIBLE = 32.0; /* exp(-32) = 1.3e-14, against a speed of at least 32: 4e-16 of it */
/* Range of b. Below it friction does not fall. Above it friction falls within 1e-12 tau: it is static at rest only. */
static const double SMALLEST = 1e-200;
static const double LARGEST = 1e12;
static const double JUST_ABOVE = 1.0 + 1e-9; /* a glide down to the far speed ends on it, give or take rounding */

/* Speed, in vs, above which the Stribeck effect is below rounding; 0 without Stribeck effect. */
static double far_speed(double b)
{
    return SMALLEST <= b && b <= LARGEST ? NEGLIGIBLE + log1p(b) : 0.0;
}

/* Whether the motion from speed `x` towards `target` = e + b is exponential at first. */
static bool is_exponential(double x, double target, double b)
{
    const double far = far_speed(b);
    return far == 0.0 || x > JUST_ABOVE * far || (x >= far && far <= target);
}

double series_expand(double x, double e, double b, double c[SERIES])
{
    double w[SERIES]; /* of exp(-x) */
    const double slope = e - x - b * expm1(-x);
    c[0] = x;
    c[1] = slope;
    w[0] = exp(-x);
    const double steady = b * w[0];
    for (int k = 1; k < SERIES_ORDER; k++) {
        double total = 0.0;
        for (int j = 1; j <= k; j++) {
            total += (double)j * c[j] * w[k - j];
        }
        w[k] = -total * (1.0 / (double)k);
        c[k + 1] = -(c[k] + b * w[k]) * (1.0 / (double)(k + 1));
    }
    if (slope == 0.0) {
        return INFINITY;
    }
    const double size = fabs(slope);
    const double growth = (1.0 + size) / steady; /* exp(R) - 1 */
    const double radius = log1p(growth);
    const double lipschitz = 1.0 + steady * (1.0 + growth);
    const double by_size = radius / (size + radius + steady * growth);
    const double by_slope = log1p(radius * lipschitz / size) / lipschitz;
    return fmax(by_size, by_slope) / RATIO;
}

double series_speed(const double c[SERIES], double h)
{
    double x = 0.0;
    for (int k = SERIES_ORDER; k >= 0; k--) {
        x = x * h + c[k];
    }
    return x;
}

double series_path(const double c[SERIES], double h)
{
    double y = 0.0;
    for (int k = SERIES_ORDER; k >= 0; k--) {
        y = y * h + c[k] / (double)(k + 1);
    }
    return y * h;
}

double series_integral(const double c[SERIES], double h)
{
    double z = 0.0;
    for (int k = SERIES_ORDER; k >= 0; k--) {
        z = z * h + c[k] / (double)((k + 1) * (k + 2));
    }
    return z * h * h;
}

/* Time within (0, h], in tau, at which a falling speed is zero. It is > 0 at 0 and <= 0 at h. Bracketed Newton. */
static double rest_within(const double c[SERIES], double h)
{
    double before = 0.0;
    double after = h;
    double t = h;
    for (int i = 0; i < 100; i++) {
        double x = 0.0;
        double slope = 0.0;
        for (int k = SERIES_ORDER; k >= 0; k--) {
            slope = slope * t + x;
            x = x * t + c[k];
        }
        if (x > 0.0) {
            before = t;
        } else {
            after = t;
        }
        const double newton = slope < 0.0 ? t - x / slope : before;
        if (fabs(newton - t) <= 4e-16 * h) {
            return fmin(fmax(newton, before), after);
        }
        t = before < newton && newton < after ? newton : 0.5 * (before + after);
    }
    return t;
}

/* Final speed of the motion from `x`, in vs; 0 if it comes to rest; b > 0. */
static double series_terminal_speed(double x, double e, double b)
{
    /* The right side is concave in x. It has no zero, or two: the lower one is unstable, the upper one stable. */
    const double slope = e - x - b * expm1(-x);
    if (slope == 0.0) {
        return x;
    }
    const double top = b > 1.0 ? log(b) : 0.0; /* where the right side is largest */
    if (slope < 0.0 && (x <= top || e - top - b * expm1(-top) <= 0.0)) {
        return 0.0;
    }
    /* Newton from above: on a concave function it falls monotonically to the upper zero. */
    double root = e + b;
    for (int i = 0; i < 200; i++) {
        const double fall = 1.0 - b * exp(-root);
        const double lower = root + (e - root - b * expm1(-root)) / fall;
        if (!(top <= lower && lower < root)) {
            break;
        }
        root = lower;
    }
    return root;
}

plain_state series_state(plain_state start, double unit, double tau_s, const double c[SERIES], double h_s)
{
    const double h = h_s / tau_s;
    const plain_state end = {
        unit * series_speed(c, h),
        start.y + unit * tau_s * series_path(c, h),
        start.z + start.y * h_s + unit * tau_s * tau_s * series_integral(c, h),
    };
    return end;
}

plain_state plain_glided(plain_state start, double target, double tau_s, double h_s)
{
    return plain_glide(start, target, tau_s, h_s);
}

plain_segment plain_next_segment(const plain_motor *m, double v, double drive_V, double longest_s, double c[SERIES])
{
    const double unit = m->stribeck_rad_s;
    if (unit == 0.0) {
        return plain_exponential(m, v, drive_V, longest_s);
    }
    const double sign = plain_direction(m, v, drive_V);
    plain_segment segment = {sign, longest_s, 0.0, NAN, false};
    if (sign == 0.0) {
        return segment;
    }
    const double tau = m->tau_s;
    const double gain = m->K_rad_s_V;
    const double moving_V = sign > 0.0 ? m->plus_V : m->minus_V;
    const double static_V = sign > 0.0 ? m->static_plus_V : m->static_minus_V;
    const double b = gain * (static_V - moving_V) / unit;
    const double x = fabs(v) / unit;
    const double target = gain * (sign * drive_V - moving_V) / unit;
    if (is_exponential(x, target, b)) {
        const double far = far_speed(b);
        segment.target_rad_s = sign * unit * target;
        /* down to the speed at which the effect begins, or to rest if this direction has none */
        const double leaves_s = target < far && far < x ? tau * log1p((x - far) / (far - target)) : INFINITY;
        if (leaves_s <= longest_s) {
            segment.duration_s = leaves_s;
            segment.end_rad_s = sign * unit * far;
        }
        return segment;
    }
    segment.is_series = true;
    segment.target_rad_s = NAN;
    segment.duration_s = fmin(tau * series_expand(x, gain * (sign * drive_V - static_V) / unit, b, c), longest_s);
    if (x > 0.0 && series_speed(c, segment.duration_s / tau) <= 0.0) {
        segment.duration_s = tau * rest_within(c, segment.duration_s / tau);
        segment.end_rad_s = 0.0;
    }
    return segment;
}

plain_state plain_within(const plain_motor *m, const plain_segment *s, const double c[SERIES], plain_state start, double h_s)
{
    if (!s->is_series) {
        return plain_glide(start, s->target_rad_s, m->tau_s, h_s);
    }
    return series_state(start, s->sign * m->stribeck_rad_s, m->tau_s, c, h_s);
}

plain_state plain_after(const plain_motor *m, const plain_segment *s, const double c[SERIES], plain_state start)
{
    plain_state end = plain_within(m, s, c, start, s->duration_s);
    if (!isnan(s->end_rad_s)) {
        end.v = s->end_rad_s;
    }
    return end;
}

void plain_advance(const plain_motor *m, plain_state *at, double u_V, double dt_s)
{
    if (m->stribeck_rad_s == 0.0) {
        *at = plain_advance_exponentially(m, *at, u_V, dt_s);
        return;
    }
    const double drive_V = u_V + m->bias_V;
    double c[SERIES];
    double left_s = dt_s;
    while (left_s > 0.0) {
        const plain_segment segment = plain_next_segment(m, at->v, drive_V, left_s, c);
        *at = plain_after(m, &segment, c, *at);
        left_s -= segment.duration_s;
    }
}

double plain_terminal_velocity(const plain_motor *m, double v, double u_V)
{
    const double drive_V = u_V + m->bias_V;
    const double gain = m->K_rad_s_V;
    const double unit = m->stribeck_rad_s;
    for (;; v = 0.0) {
        const double sign = plain_direction(m, v, drive_V);
        if (sign == 0.0) {
            return 0.0;
        }
        const double moving_V = sign > 0.0 ? m->plus_V : m->minus_V;
        const double static_V = sign > 0.0 ? m->static_plus_V : m->static_minus_V;
        double speed = fmax(gain * (sign * drive_V - moving_V), 0.0);
        if (unit > 0.0 && static_V > moving_V) {
            const double e = gain * (sign * drive_V - static_V) / unit;
            speed = unit * series_terminal_speed(fabs(v) / unit, e, gain * (static_V - moving_V) / unit);
        }
        if (speed > 0.0 || v == 0.0) {
            return sign * speed;
        }
    }
}
