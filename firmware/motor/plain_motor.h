/* The motor without parts: one step of its motion under a constant drive, from one event to the next.
 *
 *     tau dv/dt + v = K (u + b - f(v)),   dy/dt = v,   dz/dt = y      (docs/theory.md 1.2)
 *
 * Between two events the motion is a formula, here called a segment: an exponential, or under Stribeck friction a
 * Taylor polynomial of bounded error. An event is a reversal, a motor that comes to rest, or a speed below which the
 * Stribeck effect begins. Velocities are in rad/s, positions in rad, drives and friction in V, times in s.
 *
 * The small functions stand here so that loops over samples have them inline.
 */
#ifndef RIG_PLAIN_MOTOR_H
#define RIG_PLAIN_MOTOR_H

#include <math.h>
#include <stdbool.h>

enum { SERIES_ORDER = 22, SERIES = SERIES_ORDER + 1 };

/* tau and K are the effective ones: they include viscous friction. plus and minus: friction while moving towards +y
 * and -y, >= 0; static: the level to break away, at least the moving one; stribeck: the velocity over which the static
 * level falls to the moving one; 0: at rest only. The bias is added to the drive. */
typedef struct {
    double tau_s, K_rad_s_V, plus_V, minus_V, static_plus_V, static_minus_V, stribeck_rad_s, bias_V;
} plain_motor;

/* Velocity and position of the measured shaft, and integral of the position, rad s. */
typedef struct {
    double v, y, z;
} plain_state;

/* Motion in one direction, or rest, up to its first event or to the end of the time asked for.
 * sign          direction: +1, -1; 0 where friction holds the motor
 * duration_s    how long it lasts; may be infinite
 * target_rad_s  velocity that it would tend to without a further event; nan for a polynomial
 * end_rad_s     velocity at the event that ends it, exact; nan where time ends it
 * is_series     whether it is a Taylor polynomial; else the velocity tends exponentially to the target
 */
typedef struct {
    double sign, duration_s, target_rad_s, end_rad_s;
    bool is_series;
} plain_segment;

/* The sign of `v`; from rest the sign of the drive, bias included; 0 if friction holds the motor. */
static inline double plain_direction(const plain_motor *m, double v, double drive_V)
{
    if (v != 0.0) {
        return v > 0.0 ? 1.0 : -1.0;
    }
    if (drive_V > m->static_plus_V) {
        return 1.0;
    }
    return drive_V < -m->static_minus_V ? -1.0 : 0.0;
}

/* Final velocity of a motion in the direction `sign` under Coulomb friction; 0 for a sign of 0. */
static inline double plain_target(const plain_motor *m, double sign, double drive_V)
{
    if (sign > 0.0) {
        return m->K_rad_s_V * (drive_V - m->plus_V);
    }
    return sign < 0.0 ? m->K_rad_s_V * (drive_V + m->minus_V) : 0.0;
}

/* Time until a velocity `v` that tends to `target` reaches zero; infinite if it never does. */
static inline double plain_reversal_time(double v, double target, double tau_s)
{
    if (v == 0.0) {
        return 0.0;
    }
    if ((v < 0.0 && 0.0 < target) || (target < 0.0 && 0.0 < v)) { /* not by their product, which can round to 0 */
        return tau_s * log1p(-v / target);
    }
    return INFINITY;
}

/* 1 - exp(-h / tau): the share of its way to the target that a velocity has gone after `h_s`. */
static inline double plain_decay(double h_s, double tau_s)
{
    return -expm1(-h_s / tau_s);
}

/* The state `h_s` later of a motion whose velocity tends to `target`, with the decay over that time
 * (docs/theory.md 1.3). */
static inline plain_state plain_glide_by(plain_state at, double target, double tau_s, double h_s, double decay)
{
    const double excess = at.v - target;
    const plain_state end = {
        at.v - excess * decay,
        at.y + target * h_s + excess * tau_s * decay,
        at.z + at.y * h_s + 0.5 * target * h_s * h_s + excess * tau_s * (h_s - tau_s * decay),
    };
    return end;
}

static inline plain_state plain_glide(plain_state at, double target, double tau_s, double h_s)
{
    return plain_glide_by(at, target, tau_s, h_s, plain_decay(h_s, tau_s));
}

/* The next segment under Coulomb friction, at most `longest_s` (> 0) long; `drive_V` with the bias. */
static inline plain_segment plain_exponential(const plain_motor *m, double v, double drive_V, double longest_s)
{
    const double sign = plain_direction(m, v, drive_V);
    const double target = plain_target(m, sign, drive_V);
    plain_segment segment = {sign, longest_s, target, NAN, false};
    if (v != 0.0) {
        const double stop_s = plain_reversal_time(v, target, m->tau_s);
        if (stop_s < longest_s) {
            segment.duration_s = stop_s;
            segment.end_rad_s = 0.0;
        }
    }
    return segment;
}

/* The next segment under any friction; `c` gets the coefficients of a polynomial. */
plain_segment plain_next_segment(const plain_motor *m, double v, double drive_V, double longest_s, double c[SERIES]);

/* The state `h_s` after the start of a segment, `c` as it was left. */
plain_state plain_within(const plain_motor *m, const plain_segment *s, const double c[SERIES], plain_state start, double h_s);

/* The state at the end of a segment, its velocity exact where an event ends it. */
plain_state plain_after(const plain_motor *m, const plain_segment *s, const double c[SERIES], plain_state start);

/* Lets `dt_s` (>= 0) of the constant drive `u_V` pass, through every event. */
void plain_advance(const plain_motor *m, plain_state *at, double u_V, double dt_s);

/* Final velocity of the motion from `v` under the constant drive `u_V`; 0 if friction stops it. */
double plain_terminal_velocity(const plain_motor *m, double v, double u_V);

/* plain_glide, for those who cannot have it inline. */
plain_state plain_glided(plain_state start, double target, double tau_s, double h_s);

/* plain_advance, without Stribeck effect. */
static inline plain_state plain_advance_exponentially(const plain_motor *m, plain_state at, double u_V, double dt_s)
{
    const double drive_V = u_V + m->bias_V;
    double left_s = dt_s;
    while (left_s > 0.0) {
        const plain_segment s = plain_exponential(m, at.v, drive_V, left_s);
        at = plain_glide(at, s.target_rad_s, m->tau_s, s.duration_s);
        if (s.end_rad_s == 0.0) {
            at.v = 0.0;
        }
        left_s -= s.duration_s;
    }
    return at;
}

/* ---- Stribeck friction: speed x in units of the Stribeck velocity vs, time in units of tau
 *
 *     x' = e - x - b expm1(-x),    e = K (D - fs) / vs,    b = K (fs - fc) / vs,    x >= 0
 *
 * D is the drive along the motion. plain_motor.c has the derivation. */

/* Fills `c` with the coefficients of x(t) about speed `x`; returns the step, in tau, for which they hold. */
double series_expand(double x, double e, double b, double c[SERIES]);

/* Speed, path in vs tau, and integral of the path in vs tau^2, `h` after the point of expansion. */
double series_speed(const double c[SERIES], double h);
double series_path(const double c[SERIES], double h);
double series_integral(const double c[SERIES], double h);

/* The state `h_s` later of a motion in units of `unit`: the Stribeck velocity with the sign of the motion. */
plain_state series_state(plain_state start, double unit, double tau_s, const double c[SERIES], double h_s);

#endif
