#include "real_readings.h"

#include "real_motor.c" /* its steps are taken here, too, with what they leave of their stages */

/* No motor is as fast: numbers that a fit tries may drive it on by themselves, as a drag that pushes does. */
static const double RUNAWAY_RAD_S = 1e5;
/* Steps at most, on the average over rows and edges: in any one, by the way that it turns in one, and by its time constants. */
static const double STEPS_OF_ROW = 80.0;
static const double STEPS_OF_TURNING = 500.0;
static const double STEPS_OF_TAUS = 1000.0;
/* Of a drive behind a lag so many of its time constants ago nothing is left within the rounding. */
static const double FORGOTTEN_LAGS = 40.0;
static const double EVENLY = 1e-12; /* of an order of waves: so near they are as far apart as the ones before */

enum { STAGES = REAL_STAGE_ROWS - 3 };

/* Derivatives of a state by the columns, and room to work in.
 *
 * v, y, f, x       of the state, by column
 * w, given, level  by number of the motor: of the drive behind the lag and before it, and of a level of friction
 * stage            of the right sides at the four stages of a step: target velocity and bristles' rate in turn
 * by_stage         for each stage, of the target velocity and of the bristles' rate in turn, by column: what does not
 *                  come from the state
 * curved           whether the sensor is, or could be: a derivative by its curvature is asked for
 * timed            whether a derivative by when drives act is asked for: delay or lag
 * drifts           whether friction changes with time, or a derivative by its drift is asked for
 */
typedef struct {
    const int64_t *which;
    const double *orders;
    int columns, waves, width;
    double *v, *y, *f, *x;
    double *w, *given, *level, *stage[STAGES], *by_stage[STAGES];
    bool curved, timed, drifts;
} slopes;

/* Derivatives of a right side: of the target velocity by v, y and w, of the bristles' rate by v, y and f. */
typedef struct {
    double av, ay, aw, rv, ry, rf;
} by_state;

/* Fills `out` with the derivatives of the level; gives those by speed and position. */
static void level_slopes(const motor *m, double speed, wave at, double t, double *out, double by[2])
{
    const double course = (t - m->start_s) / m->duration_s - 0.5;
    out[AT_fc_V] = 1.0 + m->drift * course;
    out[AT_drift] = m->fc_V * course;
    by[0] = by[1] = 0.0;
    if (m->turns) {
        out[AT_friction_sin_V] = at.sine;
        out[AT_friction_cos_V] = at.cosine - m->mean_cosine;
        by[1] = m->friction_sin_V * at.cosine - m->friction_cos_V * at.sine;
    }
    if (m->falls) {
        const double share = exp(-speed / m->stribeck_rad_s);
        out[AT_stribeck_V] = share;
        out[AT_stribeck_rad_s] = m->stribeck_V * share * speed / (m->stribeck_rad_s * m->stribeck_rad_s);
        by[0] = -m->stribeck_V * share / m->stribeck_rad_s;
    }
}

static const int OF_LEVEL[] = {AT_fc_V, AT_drift, AT_friction_sin_V, AT_friction_cos_V, AT_stribeck_V, AT_stribeck_rad_s};
enum { LEVELS = sizeof OF_LEVEL / sizeof OF_LEVEL[0] };

/* Adds to `a` what load friction, the supply's resistance and the bridge change, where the torque is on a `side`, and puts
 * the derivative by the drive into `by_w`; returns the one by the force. */
static double load_slopes(const motor *m, double sign, torque_side side, const real_state *at, wave here, double *a, double *by_w)
{
    const double gain = m->K_rad_s_V;
    const double w = at->w;
    const double back = back_emf(m, at->v);
    const double pulses = pulse_share(m, w);
    const double brakes = braking(m, w);
    const double net = net_drive(m, w, at->v);
    const double by_full = pulses < 1.0 ? back * m->free_between / m->full_drive_V : 0.0; /* a change of the share, per V */
    const double by_supply = m->source_per_V2 != 0.0 ? 1.0 / (1.0 + m->source_per_V2 * w * w) : 1.0;
    const double idle = side.passed.idle;
    const double against = side.passed.against;
    const double seen = idle * against * by_supply * net + m->load_outside * force(m, here);
    const double load = side.sign * sign * m->load_friction;
    const double share = left_of_net(m, sign, side, w);
    const double passed_on = gain * (1.0 - load) * by_supply * net; /* by a bridge that passes all */
    *by_w = gain * share * (1.0 - (w > 0.0 ? by_full : -by_full) - 2.0 * m->source_per_V2 * w * net * by_supply);
    a[AT_K_rad_s_V] += back * (share * brakes - 1.0);
    a[AT_load_friction] = -gain * sign * side.sign * seen;
    a[AT_load_outside] = -gain * load * force(m, here);
    a[AT_viscous_share] = at->v * (share * brakes - 1.0);
    a[AT_source_per_V2] = -gain * share * net * w * w * by_supply;
    a[AT_runs_free] = idle != 1.0 ? -passed_on * against : 0.0;
    a[AT_no_brake] = against != 1.0 ? -passed_on * idle : 0.0;
    a[AT_free_between] = gain * share * back * (1.0 - pulses);
    a[AT_full_drive_V] = gain * share * by_full * pulses;
    return -gain * (1.0 + load * m->load_outside);
}

/* Fills two rows with the derivatives of the target velocity and of the bristles' rate at a stage, where the target
 * velocity is `aim`, and the torque is on a `side`. */
static by_state right_sides(const motor *m, const slopes *d, double sign, torque_side side, const real_state *at, wave here, double t, double aim, int stage)
{
    double *const a = d->stage[2 * stage];
    double *const r = d->stage[2 * stage + 1];
    const double gain = m->K_rad_s_V;
    const double v = at->v;
    const double y = at->y;
    const double speed = sign * v;
    by_state by = {0.0, 0.0, gain, 0.0, 0.0, 0.0};
    double by_force = -gain;
    a[AT_K_rad_s_V] = aim / gain;
    a[AT_bias_V] = gain;
    a[AT_viscous_by_direction_V_s_rad] = -gain * speed;
    a[AT_drag_V_s2_rad2] = -gain * v * speed;
    by.av = by_velocity(m, sign, side, at->w) - gain * (2.0 * m->drag_V_s2_rad2 * speed);
    if (m->transmits) {
        by_force = load_slopes(m, sign, side, at, here, a, &by.aw);
    }
    if (m->turns) {
        a[AT_force_sin_V] = by_force * here.sine;
        a[AT_force_cos_V] = by_force * (here.cosine - m->mean_cosine);
        by.ay += by_force * (m->force_sin_V * here.cosine - m->force_cos_V * here.sine);
    }
    if (m->cogs) {
        const double slope = m->cogging_sin_V * here.cog_cosine - m->cogging_cos_V * here.cog_sine;
        a[AT_cogging_sin_V] = by_force * here.cog_sine;
        a[AT_cogging_cos_V] = by_force * here.cog_cosine;
        a[AT_cogging_per_rad] = by_force * y * slope;
        by.ay += by_force * m->cogging_per_rad * slope;
    }
    wave at_order = {0.0, 1.0, 0.0, 1.0};
    wave turn = at_order;
    double apart = 0.0;
    for (int k = 0; k < d->waves; k++) {
        const double order = d->orders[k];
        if (k > 0 && fabs(order - d->orders[k - 1] - apart) < EVENLY * order) { /* as far from the last one as that was */
            const wave last = at_order;
            at_order.sine = last.sine * turn.cosine + last.cosine * turn.sine;
            at_order.cosine = last.cosine * turn.cosine - last.sine * turn.sine;
        } else {
            apart = k + 1 < d->waves ? d->orders[k + 1] - order : 0.0;
            at_order.sine = sin(order * y);
            at_order.cosine = cos(order * y);
            turn.sine = sin(apart * y);
            turn.cosine = cos(apart * y);
        }
        a[REAL_WAVES + 2 * k] = by_force * at_order.sine;
        a[REAL_WAVES + 2 * k + 1] = by_force * at_order.cosine;
    }
    double by_level[2];
    level_slopes(m, speed, here, t, r, by_level);
    if (m->bristle_V_rad <= 0.0) {
        for (int k = 0; k < LEVELS; k++) {
            a[OF_LEVEL[k]] = -gain * sign * r[OF_LEVEL[k]];
        }
        by.av -= gain * by_level[0];
        by.ay -= gain * sign * by_level[1];
        return by;
    }
    const double top = level_of_bristles(m, speed, here, t);
    const double stiff = stiffness(m, top);
    const double share = at->f / top;
    const bool limited = stiff < m->bristle_V_rad;
    const double of_level = limited ? v * stiff / top : stiff * speed * share / top;
    for (int k = 0; k < LEVELS; k++) {
        r[OF_LEVEL[k]] *= of_level;
    }
    r[AT_bristle_V_rad] = limited ? 0.0 : v - speed * share;
    by.rv = stiff * (1.0 - sign * share) + of_level * sign * by_level[0];
    by.ry = of_level * by_level[1];
    by.rf = -stiff * speed / top;
    return by;
}

/* Fills `out` at the numbers of the drive stage with the derivatives of the drive behind it. */
static void staged_slopes(const motor *m, double u_V, double *out)
{
    out[AT_dead_band_V] = out[AT_gain_by_sign] = out[AT_sag_per_V] = 0.0;
    const double beyond = fabs(u_V) - m->dead_band_V;
    if (beyond > 0.0) {
        const double sign = u_V > 0.0 ? 1.0 : -1.0;
        const double share = 1.0 + sign * m->gain_by_sign;
        const double size = before_sag(m, beyond * share);
        const double slope = sign * (1.0 - 2.0 * m->sag_per_V * size);
        out[AT_dead_band_V] = -slope * share;
        out[AT_gain_by_sign] = slope * sign * beyond;
        out[AT_sag_per_V] = -sign * size * size;
    }
}

/* Acceleration; 0 of a motor that friction holds. */
static double acceleration(const motor *m, const real_state *at, double staged_V, double t_s)
{
    const double sign = direction(m, at, staged_V, t_s);
    return sign == 0.0 ? 0.0 : (target(m, sign, at, wave_at(m, at->y), t_s) - at->v) / m->tau_s;
}

/* Carries the derivatives of the drive over `h_s`, at whose start it is `faded_V` from its end. */
static void fade_drive(const motor *m, const slopes *d, double faded_V, double h_s)
{
    if (m->lag_s <= 0.0) {
        return;
    }
    const double keep = exp(-h_s / m->lag_s);
    for (int i = 0; i < REAL_NUMBERS; i++) {
        d->w[i] = d->given[i] + (d->w[i] - d->given[i]) * keep;
    }
    d->w[AT_lag_s] += faded_V * keep * h_s / (m->lag_s * m->lag_s);
}

/* Takes the derivatives over an edge from `staged_V` to the drive `u_V`; returns it as it is before the lag. */
static double step_drive(const motor *m, const slopes *d, double staged_V, double u_V)
{
    const double new_V = staged(m, u_V);
    staged_slopes(m, u_V, d->given);
    if (m->lag_s > 0.0) {
        d->w[AT_delay_s] += (staged_V - new_V) / m->lag_s;
    }
    return new_V;
}

/* State at the start of a piece at `t`, where the drive behind the lag is `w`, and its derivatives. */
static real_state begin(const motor *m, const slopes *d, const double start[4], double t, double w)
{
    const double v0 = start[0];
    const double side = start[2];
    double bend = start[3];
    real_state at = {v0, start[1] + 0.5 * side * m->backlash_rad, 0.0, w, start[1]};
    for (int i = 0; i < d->columns; i++) {
        d->v[i] = d->which[i] == REAL_V0 ? 1.0 : 0.0;
        d->x[i] = d->which[i] == REAL_Y0 ? 1.0 : 0.0;
        d->y[i] = d->x[i] + (d->which[i] == AT_backlash_rad ? 0.5 * side : 0.0);
        d->f[i] = 0.0;
    }
    if (m->bristle_V_rad <= 0.0) {
        return at;
    }
    const wave here = wave_at(m, at.y);
    const double top = level_of_bristles(m, fabs(v0), here, t);
    const double pull = pull_at_rest(m, w, here);
    if (bend == 0.0 && fabs(pull) > top) {
        bend = pull > 0.0 ? 1.0 : -1.0;
    }
    at.f = bend != 0.0 ? bend * top : pull;
    if (d->columns == 0) {
        return at;
    }
    const double gain = m->K_rad_s_V;
    const by_state by = right_sides(m, d, 1.0, side_of(m, &at, here), &at, here, t, target(m, 1.0, &at, here, t), 0);
    for (int i = 0; i < d->width; i++) {
        d->level[i] = 0.0;
    }
    double by_level[2];
    level_slopes(m, fabs(v0), here, t, d->level, by_level);
    const double by_v = v0 > 0.0 ? by_level[0] : -by_level[0];
    for (int i = 0; i < d->columns; i++) {
        const int64_t p = d->which[i];
        if (bend != 0.0) {
            d->f[i] = bend * (d->level[p] + by_v * d->v[i] + by_level[1] * d->y[i]);
        } else {
            const bool known = p == AT_bias_V || p == AT_force_sin_V || p == AT_force_cos_V ||
                               (AT_cogging_sin_V <= p && p <= AT_cogging_per_rad) || p >= REAL_WAVES;
            d->f[i] = (by.ay * d->y[i] + by.aw * d->w[p]) / gain + (known ? d->stage[0][p] / gain : 0.0);
        }
    }
    return at;
}

/* Fills a row with the derivatives of `by_velocity`, at velocities of 1 and of 0 those of the target velocity; returns the
 * one by the drive. `zero` has room for another row. */
static double velocity_slopes(const motor *m, double sign, torque_side side, const real_state *at, wave here, double *row, double *zero)
{
    double by_w[2] = {0.0, 0.0};
    row[AT_K_rad_s_V] = by_velocity(m, sign, side, at->w) / m->K_rad_s_V;
    row[AT_viscous_by_direction_V_s_rad] = -m->K_rad_s_V * sign;
    if (m->transmits) {
        real_state turning_at = *at;
        turning_at.v = 1.0;
        load_slopes(m, sign, side, &turning_at, here, row, &by_w[1]);
        turning_at.v = 0.0;
        zero[AT_K_rad_s_V] = 0.0;
        load_slopes(m, sign, side, &turning_at, here, zero, &by_w[0]);
        for (int i = AT_load_friction; i <= AT_full_drive_V; i++) {
            row[i] -= zero[i];
        }
    }
    return by_w[1] - by_w[0];
}

/* Takes the derivatives of v and y through a step of a linear motion from `at`, at `t`. */
static void through_linearly(const motor *restrict m, const slopes *d, const real_state *restrict at, const step *restrict now, double t)
{
    const stages *const s = &now->in;
    const weights k = s->k;
    const double h = now->duration_s;
    const double v = at->v;
    const double x = h / m->tau_s;
    double *const restrict by_v = d->stage[4];
    const double *const restrict first = d->stage[0];
    const double *const restrict last = d->drifts ? d->stage[2] : first;
    const double by_v_w = velocity_slopes(m, now->sign, s->side, at, s->here1, by_v, d->stage[5]);
    const double by_w = right_sides(m, d, now->sign, s->side, at, s->here1, t, s->a1, 0).aw;
    if (d->drifts) {
        right_sides(m, d, now->sign, s->side, at, s->here1, t + h, s->a1 + s->growth, 1);
    }
    const double q1 = k.p1 - k.p2; /* derivatives of p1, p2, p3 by -s->taus */
    const double q2 = k.p2 - 2.0 * k.p3;
    const double q3 = k.p3 - 3.0 * k.p4;
    const double v_less = k.keep * v + x * (s->steady * q1 + s->growth * q2); /* of the end, by less of these */
    const double y_less = h * (q1 * v + x * (s->steady * q2 + s->growth * q3));
    double *const restrict v_of = d->v;
    double *const restrict y_of = d->y;
    for (int i = 0; i < d->columns; i++) {
        const int64_t p = d->which[i];
        const double pull = by_v[p] + by_v_w * d->w[p];
        const double steady = first[p] + by_w * d->w[p] - v * pull;
        const double growth = last[p] - first[p];
        const double less = x * pull;
        const double v0 = v_of[i];
        v_of[i] = k.keep * v0 + x * (k.p1 * steady + k.p2 * growth) + less * v_less;
        y_of[i] += h * (k.p1 * v0 + x * (k.p2 * steady + k.p3 * growth)) + less * y_less;
        if (p == AT_tau_s) {
            v_of[i] += (s->taus * v_less - x * (k.p1 * s->steady + k.p2 * s->growth)) / m->tau_s;
            y_of[i] += (s->taus * y_less - h * x * (k.p2 * s->steady + k.p3 * s->growth)) / m->tau_s;
        }
    }
}

/* Takes the derivatives of v, y, f through a step of a motor in motion from `at`, at `t`. */
static void through(const motor *restrict m, const slopes *d, const real_state *restrict at, const step *restrict now, double t, double staged_V)
{
    if (m->linear) {
        through_linearly(m, d, at, now, t);
        return;
    }
    const stages *const s = &now->in;
    const double h = now->duration_s;
    const double tau = m->tau_s;
    const double gain = m->K_rad_s_V;
    const double lag = m->lag_s;
    const double half = lag > 0.0 ? exp(-0.5 * h / lag) : 0.0;
    const double keep = half * half;
    const double faded = at->w - staged_V;
    const double by_lag[2] = {
        lag > 0.0 ? faded * half * 0.5 * h / (lag * lag) : 0.0,
        lag > 0.0 ? faded * keep * h / (lag * lag) : 0.0,
    };
    /* weights of the step */
    const double c = h / tau;
    const weights k = s->k;
    const double b1 = c * k.b1;
    const double b2 = c * k.b2;
    const double b4 = c * k.b4;
    const double gone = 1.0 - k.half;
    /* those of the bristles; how they change shows only in what the step leaves off */
    const bool bristles = m->bristle_V_rad > 0.0;
    const double slide = s->slide;
    const weights g = s->b;
    const double near = 0.5 * h * g.mean;
    const double middle = staged_V + faded * half;
    const real_state at2 = {s->v2, s->y2, s->f2, middle, 0.0};
    const real_state at3 = {s->v3, s->y3, s->f3, middle, 0.0};
    const real_state at4 = {s->v4, s->y4, s->f4, now->end.w, 0.0};
    const torque_side side = side_of(m, &at2, s->here2); /* of the whole step, which ends where the torque turns */
    const by_state d1 = right_sides(m, d, now->sign, side, at, s->here1, t, s->a1, 0);
    const by_state d2 = right_sides(m, d, now->sign, side, &at2, s->here2, t + 0.5 * h, s->a2, 1);
    const by_state d3 = right_sides(m, d, now->sign, side, &at3, s->here3, t + 0.5 * h, s->a3, 2);
    const by_state d4 = right_sides(m, d, now->sign, side, &at4, s->here4, t + h, s->a4, 3);
    const int columns = d->columns;
    double *const restrict a1_of = d->by_stage[0];
    double *const restrict a2_of = d->by_stage[2];
    double *const restrict a3_of = d->by_stage[4];
    double *const restrict a4_of = d->by_stage[6];
    int of_tau = -1;
    for (int i = 0; i < columns; i++) {
        const int64_t p = d->which[i];
        const double drive = d->given[p];
        a1_of[i] = d1.aw * d->w[p] + d->stage[0][p];
        a2_of[i] = d2.aw * drive + d->stage[2][p];
        a3_of[i] = d3.aw * drive + d->stage[4][p];
        a4_of[i] = d4.aw * drive + d->stage[6][p];
        of_tau = p == AT_tau_s ? i : of_tau;
    }
    for (int i = 0; lag > 0.0 && i < columns; i++) { /* and what the drive behind the lag is off */
        const int64_t p = d->which[i];
        const double off = d->w[p] - d->given[p];
        const double mid = off * half + (p == AT_lag_s ? by_lag[0] : 0.0);
        a2_of[i] += d2.aw * mid;
        a3_of[i] += d3.aw * mid;
        a4_of[i] += d4.aw * (off * keep + (p == AT_lag_s ? by_lag[1] : 0.0));
    }
    for (int stage = 0; bristles && stage < STAGES / 2; stage++) {
        for (int i = 0; i < columns; i++) {
            d->by_stage[2 * stage + 1][i] = d->stage[2 * stage + 1][d->which[i]];
        }
    }
    /* by tau the weights change, too */
    double tau_v = 0.0, tau_y = 0.0;
    if (of_tau >= 0) {
        const double q1 = k.p1 - k.p2; /* derivatives of p1, p2, p3 by -c */
        const double q2 = k.p2 - 2.0 * k.p3;
        const double q3 = k.p3 - 3.0 * k.p4;
        const double rate = -c / tau;
        const double half_tau = -0.5 * rate * k.half;
        const double b1_tau = rate * (k.b1 - c * (q1 - 3.0 * q2 + 4.0 * q3));
        const double b2_tau = rate * (k.b2 - c * (2.0 * q2 - 4.0 * q3));
        const double b4_tau = rate * (k.b4 - c * (4.0 * q3 - q2));
        const double v2 = half_tau * (at->v - s->a1);
        const double y2 = at->v - tau * v2 - s->v2;
        a2_of[of_tau] += d2.av * v2 + d2.ay * y2;
        d->by_stage[3][of_tau] += d2.rv * v2 + d2.ry * y2;
        /* what a stage adds here goes on through those behind it */
        const double v3 = half_tau * (at->v - s->a2);
        const double y3 = at->v - tau * v3 - s->v3;
        a3_of[of_tau] += d3.av * v3 + d3.ay * y3;
        d->by_stage[5][of_tau] += d3.rv * v3 + d3.ry * y3;
        const double v4 = k.half * v2 + half_tau * (s->v2 - 2.0 * s->a3 + s->a1);
        const double y4 = at->v - tau * v4 - s->v4;
        a4_of[of_tau] += d4.av * v4 + d4.ay * y4;
        d->by_stage[7][of_tau] += d4.rv * v4 + d4.ry * y4;
        tau_v = -rate * k.keep * at->v + b1_tau * s->a1 + b2_tau * (s->a2 + s->a3) + b4_tau * s->a4;
        tau_y = at->v - now->end.v;
    }
    double *const restrict v_of = d->v;
    double *const restrict y_of = d->y;
    if (!bristles) {
        for (int i = 0; i < columns; i++) {
            const double v = v_of[i];
            const double y = y_of[i];
            const double along = y + tau * v; /* of p = y + tau v */
            const double a1 = d1.av * v + d1.ay * y + a1_of[i];
            const double v2 = k.half * v + gone * a1;
            const double a2 = d2.av * v2 + d2.ay * (along + 0.5 * h * a1 - tau * v2) + a2_of[i];
            const double v3 = k.half * v + gone * a2;
            const double a3 = d3.av * v3 + d3.ay * (along + 0.5 * h * a2 - tau * v3) + a3_of[i];
            const double v4 = k.half * v2 + gone * (2.0 * a3 - a1);
            const double a4 = d4.av * v4 + d4.ay * (along + h * a3 - tau * v4) + a4_of[i];
            const double v_end = k.keep * v + b1 * a1 + b2 * (a2 + a3) + b4 * a4;
            v_of[i] = v_end;
            y_of[i] = along + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4) - tau * v_end;
        }
    } else {
        for (int i = 0; i < columns; i++) {
            const double v = v_of[i];
            const double y = y_of[i];
            const double f = d->f[i];
            const double along = y + tau * v;
            const double a1 = d1.av * v + d1.ay * y - gain * f + a1_of[i];
            const double v2 = k.half * v + gone * a1;
            const double y2 = along + 0.5 * h * a1 - tau * v2;
            const double r1 = d1.rv * v + d1.ry * y + (d1.rf + slide) * f + d->by_stage[1][i];
            const double f2 = g.half * f + near * r1;
            const double r2 = d2.rv * v2 + d2.ry * y2 + (d2.rf + slide) * f2 + d->by_stage[3][i];
            const double f3 = g.half * f + near * r2;
            const double a2 = d2.av * v2 + d2.ay * y2 - gain * f2 + a2_of[i];
            const double v3 = k.half * v + gone * a2;
            const double y3 = along + 0.5 * h * a2 - tau * v3;
            const double r3 = d3.rv * v3 + d3.ry * y3 + (d3.rf + slide) * f3 + d->by_stage[5][i];
            const double f4 = g.half * f2 + near * (2.0 * r3 - r1);
            const double a3 = d3.av * v3 + d3.ay * y3 - gain * f3 + a3_of[i];
            const double v4 = k.half * v2 + gone * (2.0 * a3 - a1);
            const double y4 = along + h * a3 - tau * v4;
            const double r4 = d4.rv * v4 + d4.ry * y4 + (d4.rf + slide) * f4 + d->by_stage[7][i];
            const double a4 = d4.av * v4 + d4.ay * y4 - gain * f4 + a4_of[i];
            const double v_end = k.keep * v + b1 * a1 + b2 * (a2 + a3) + b4 * a4;
            v_of[i] = v_end;
            y_of[i] = along + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4) - tau * v_end;
            d->f[i] = g.keep * f + h * (g.b1 * r1 + g.b2 * (r2 + r3) + g.b4 * r4);
        }
    }
    if (of_tau >= 0) {
        v_of[of_tau] += tau_v;
        y_of[of_tau] += tau_y - tau * tau_v;
    }
}

/* Jump of the velocity's derivatives at a reversal of a motion in the direction `sign`. */
static void reverse(const motor *m, const slopes *d, double sign, const real_state *at, double t, double staged_V)
{
    const double before = (target(m, sign, at, wave_at(m, at->y), t) - at->v) / m->tau_s;
    const double jump = before != 0.0 ? acceleration(m, at, staged_V, t) / before : 0.0;
    for (int i = 0; i < d->columns; i++) {
        d->v[i] *= jump;
    }
}

/* Jump of the velocity's derivatives where the lag or the drift lets the motor go in the direction `sign`. */
static void release(const motor *m, const slopes *d, double sign, const real_state *at, double t, double staged_V)
{
    const double gain = m->K_rad_s_V;
    const wave here = wave_at(m, at->y);
    const double aim = target(m, sign, at, here, t);
    const by_state by = right_sides(m, d, sign, side_of(m, at, here), at, here, t, aim, 0);
    double rate = m->lag_s > 0.0 ? by.aw / gain * (staged_V - at->w) / m->lag_s : 0.0;
    rate -= sign * m->fc_V * m->drift / m->duration_s; /* of the pull beyond the level */
    double *const a = d->stage[0];
    a[AT_static_V] = -gain * sign;
    for (int i = 0; i < d->columns; i++) {
        const int64_t p = d->which[i];
        const double by_p = (by.ay * d->y[i] + by.aw * d->w[p]) / gain + (p != AT_K_rad_s_V ? a[p] / gain : 0.0);
        d->v[i] += aim / m->tau_s * by_p / rate;
    }
    a[AT_static_V] = 0.0;
}

/* Jump of the velocity's derivatives at an edge without lag, at `t`, from one drive to another. */
static void kick(const motor *m, const slopes *d, const real_state *before, const real_state *at, double t, const double drives_V[2])
{
    const double was = acceleration(m, before, drives_V[0], t);
    const double later = was - acceleration(m, at, drives_V[1], t);
    double slower = later; /* a short lag acts as a delay, except where it lets go of a motor at rest */
    if (was == 0.0 && at->v == 0.0 && later != 0.0 && m->bristle_V_rad <= 0.0) {
        const wave here = wave_at(m, at->y);
        const double beyond = fabs(pull_at_rest(m, drives_V[1], here)) - level_at_rest(m, here, t) -
                              load_at(m, drives_V[1], 0.0, here);
        slower = later * log(fabs(drives_V[1] - drives_V[0]) / beyond);
        slower += copysign(m->K_rad_s_V / m->tau_s * beyond, later);
    }
    for (int i = 0; i < d->columns; i++) {
        if (d->which[i] == AT_delay_s) {
            d->v[i] += later;
        } else if (d->which[i] == AT_lag_s) {
            d->v[i] += slower;
        }
    }
}

/* Fills a row of the Jacobian of the reading at `x`. */
static void read_slopes(const motor *m, const slopes *d, double x, double *row)
{
    if (!d->curved) {
        for (int i = 0; i < d->columns; i++) {
            row[i] = d->x[i];
        }
        return;
    }
    const double share = (x - m->centre_rad) / m->half_travel_rad;
    const double q = PI * share;
    const double s1 = sin(q);
    const double c1 = cos(q);
    const double s2 = sin(2.0 * q);
    const double c2 = cos(2.0 * q);
    const double by[4] = {s1 - 3.0 / PI * share, c1, s2 + 1.5 / PI * share, c2};
    double slope = m->linearity_sin1_rad * (PI * c1 - 3.0 / PI);
    slope -= m->linearity_cos1_rad * PI * s1;
    slope += m->linearity_sin2_rad * (2.0 * PI * c2 + 1.5 / PI);
    slope -= m->linearity_cos2_rad * 2.0 * PI * s2;
    const double by_x = 1.0 + slope / m->half_travel_rad;
    for (int i = 0; i < d->columns; i++) {
        const int64_t k = d->which[i] - AT_linearity_sin1_rad;
        row[i] = by_x * d->x[i] + (0 <= k && k < 4 ? by[k] : 0.0);
    }
}

static bool asks(const real_columns *c, int64_t from, int64_t to)
{
    bool asked = false;
    for (int64_t i = 0; i < c->columns; i++) {
        asked = asked || (from <= c->which[i] && c->which[i] <= to);
    }
    return asked;
}

/* Whether the derivatives that are asked for are those of a linear motion, too. */
static bool asks_of_linear(const real_columns *c)
{
    bool linear = c->waves == 0;
    for (int64_t i = 0; i < c->columns; i++) {
        const int64_t p = c->which[i];
        linear = linear && (p >= REAL_NUMBERS || p == AT_lag_s || IS_LINEAR[p]);
    }
    return linear;
}

static bool is_curved(const motor *m)
{
    return m->linearity_sin1_rad != 0.0 || m->linearity_cos1_rad != 0.0 || m->linearity_sin2_rad != 0.0 ||
           m->linearity_cos2_rad != 0.0;
}

static slopes room_for(const motor *m, const real_columns *c)
{
    slopes d;
    double *at = c->work;
    d.which = c->which;
    d.orders = c->orders;
    d.columns = (int)c->columns;
    d.waves = (int)c->waves;
    d.width = REAL_WAVES + 2 * d.waves;
    d.v = at;
    d.y = d.v + d.columns;
    d.f = d.y + d.columns;
    d.x = d.f + d.columns;
    at = d.x + d.columns;
    for (int i = 0; i < STAGES; i++) {
        d.by_stage[i] = at;
        at += d.columns;
    }
    for (int i = 0; i < STAGES * d.columns; i++) {
        d.by_stage[0][i] = 0.0;
    }
    for (int i = 0; i < REAL_STAGE_ROWS * d.width; i++) {
        at[i] = 0.0;
    }
    d.given = at + d.width;
    d.w = m->lag_s > 0.0 ? at : d.given; /* without a lag both are the same */
    d.level = d.given + d.width;
    for (int i = 0; i < STAGES; i++) {
        d.stage[i] = d.level + (i + 1) * d.width;
    }
    d.curved = is_curved(m) || asks(c, AT_linearity_sin1_rad, AT_linearity_cos2_rad);
    d.drifts = m->drift != 0.0 || asks(c, AT_drift, AT_drift);
    d.timed = asks(c, AT_delay_s, AT_delay_s) || asks(c, AT_lag_s, AT_lag_s);
    return d;
}

static void fill(double *values, int64_t count, double value)
{
    for (int64_t i = 0; i < count; i++) {
        values[i] = value;
    }
}

/* The edge that acts at `now`; the first one before it. */
static int64_t edge_at(const real_record *record, double delay_s, double now)
{
    int64_t low = 0;
    int64_t high = record->edges;
    while (high - low > 1) {
        const int64_t middle = low + (high - low) / 2;
        if (record->edge_s[middle] + delay_s <= now) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

void real_readings(const real_motor *numbers, const real_record *record, const real_columns *columns, double *y_rad, double *jacobian)
{
    motor own = motor_of(numbers);
    own.linear = own.linear && asks_of_linear(columns);
    own.sided = own.sided || asks(columns, AT_load_friction, AT_load_friction);
    const motor *const m = &own;
    const slopes d = room_for(m, columns);
    const bool sloping = d.columns > 0;
    const double *const edge_s = record->edge_s;
    const double *const u_V = record->u_V;
    const double *const t_s = record->t_s;
    const int64_t edges = record->edges;
    const int64_t n = record->rows;
    const double looks = (double)(n + edges);
    double left = STEPS_OF_ROW * looks;
    left += least(2.0 * (t_s[n - 1] - t_s[0]) / (CURVED_STEP * m->tau_s), STEPS_OF_TAUS * looks);
    double left_of_turning = STEPS_OF_TURNING * looks;
    const double steps_of_rad = 2.0 * (m->cogs ? most(1.0, fabs(m->cogging_per_rad)) : 1.0) / STEP_OF_TURN;
    int64_t j = edge_at(record, m->delay_s, t_s[0] - FORGOTTEN_LAGS * most(m->lag_s, 0.0));
    double staged_V = staged(m, u_V[j]);
    staged_slopes(m, u_V[j], d.given);
    if (m->lag_s > 0.0) {
        memcpy(d.w, d.given, (size_t)d.width * sizeof(double));
    }
    double w = staged_V;
    double begun = least(t_s[0], edge_s[j] + m->delay_s);
    step s = FIRST_STEP;
    for (int64_t piece = 0; piece < record->pieces; piece++) {
        int64_t k = record->first[piece];
        const int64_t last = piece + 1 < record->pieces ? record->first[piece + 1] : n;
        double now = t_s[k];
        double edge = j + 1 < edges ? edge_s[j + 1] + m->delay_s : INFINITY;
        while (begun < now || edge <= now) { /* the drive, up to the piece */
            const double until = most(least(edge, now), begun);
            fade_drive(m, &d, w - staged_V, until - begun);
            w = lagged(m, staged_V, w, until - begun);
            begun = until;
            if (edge <= now) {
                j++;
                staged_V = step_drive(m, &d, staged_V, u_V[j]);
                w = m->lag_s > 0.0 ? w : staged_V;
                edge = j + 1 < edges ? edge_s[j + 1] + m->delay_s : INFINITY;
            }
        }
        real_state at = begin(m, &d, record->starts + 4 * piece, now, w);
        for (;;) {
            while (k < last && (t_s[k] <= now || now < edge)) {
                if (t_s[k] <= now) {
                    y_rad[k] = real_reading(numbers, at.x);
                    if (sloping) {
                        read_slopes(m, &d, at.x, jacobian + k * d.columns);
                    }
                    k++;
                    continue;
                }
                const double end = least(edge, t_s[k]);
                next_step(m, &at, staged_V, now, end - now, &s);
                if (sloping) {
                    if (s.sign != 0.0) {
                        through(m, &d, &at, &s, now, staged_V);
                    } else {
                        fill(d.v, d.columns, 0.0);
                    }
                    fade_drive(m, &d, at.w - staged_V, s.duration_s);
                    if (s.sign != 0.0 && s.sign * (s.end.y - at.x) >= 0.5 * m->backlash_rad) {
                        for (int i = 0; i < d.columns; i++) { /* the play is taken up */
                            d.x[i] = d.y[i] - (d.which[i] == AT_backlash_rad ? 0.5 * s.sign : 0.0);
                        }
                    }
                }
                now = s.duration_s >= end - now ? end : now + s.duration_s;
                const double due = least(steps_of_rad * fabs(s.end.y - at.y), left_of_turning);
                left_of_turning -= due;
                left += due - 1.0;
                const double x = at.x;
                at = s.end;
                at.x = x;
                take_up_play(m, s.sign, &at);
                if (left < 0.0 || !(fabs(at.v) < RUNAWAY_RAD_S)) { /* its steps are, or would become, too short ever to end */
                    fill(y_rad, n, NAN);
                    fill(jacobian, n * d.columns, NAN);
                    return;
                }
                if (sloping && s.reverses) {
                    reverse(m, &d, s.sign, &at, now, staged_V);
                }
                if (sloping && s.released != 0.0) {
                    release(m, &d, s.released, &at, now, staged_V);
                }
            }
            if (k == last) {
                w = at.w;
                begun = now;
                break;
            }
            j++;
            edge = j + 1 < edges ? edge_s[j + 1] + m->delay_s : INFINITY;
            const real_state before = at;
            const double drives_V[2] = {staged_V, step_drive(m, &d, staged_V, u_V[j])};
            staged_V = drives_V[1];
            if (m->lag_s <= 0.0) {
                at.w = staged_V;
                if (d.timed) {
                    kick(m, &d, &before, &at, now, drives_V);
                }
            }
        }
    }
}

double real_target(const real_motor *numbers, double sign, const real_state *at, double t_s)
{
    const motor m = motor_of(numbers);
    return target(&m, sign, at, wave_at(&m, at->y), t_s);
}
