#include "real_motor.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

static const double PI = 3.14159265358979323846;
static const double LEAST_LEVEL_V = 1e-4;   /* of bristles: their friction is divided by the level */
static const double LEAST_BEND_RAD = 1e-4;  /* bristles slide after at least this: stiffer ones nobody sees, and take long */
static const double SLIDING = 1e-8;         /* share of the level that bristles which slide may still lack */
static const double LEVEL_CHANGES = 60.0;   /* what a level that changes along the way costs, per change within a bend */
static const double BALANCED = 1e-12;       /* of K times 1 V: bristles that pull less than this rest */
static const double TURNED_V = sizeof(double) < 8u ? 1e-7 : 1e-9; /* a torque beyond it on either side has turned within a step */
static const double PRESSED_S = 1e-3;       /* a motor pressed against a stop looks this often whether it still is */
static const double ROUNDED = sizeof(double) < 8u ? 1e-6 : 1e-13; /* of a step: the rounding of the times of its ends */
enum { ROUNDS = 60 };                       /* of the search for an event, which needs about five */
/* Where double has four bytes, as on an AVR, rounding is coarser: an event within its reach, and longer steps, will do. */
static const double EVENT_S = sizeof(double) < 8u ? 1e-7 : 1e-14;
static const double STRETCH = sizeof(double) < 8u ? 4.0 : 1.0;
static const double HUGE_POWER = sizeof(double) < 8u ? 80.0 : 700.0;
/* Largest steps, so that a relay test of 20 s stays within 1e-6 rad of its exact motion. */
static const double LONGEST_STEP = 2.0;     /* of tau, s/s: of longer ones rounding takes the weights, and events are far */
static const double CURVED_STEP = sizeof(double) < 8u ? 0.05 : 0.07; /* of tau, s/s; drag, bridge, Stribeck effect (it grows at rest) */
static const double STEP_OF_TAU = sizeof(double) < 8u ? 0.05 : 0.2; /* s/s; any other part that changes the right side */
static const double SHORT_LAG_S = 1e-3;     /* of a shorter lag the derivative would suffer before the motion does */
static const double STEP_OF_LAG = 0.065;    /* s/s, at 1 V s of fading drive times its time constant; longer the less there is */
static const double STEP_OF_TURN = 0.15;    /* rad of the phase of a force over position */
static const double SMALL_TURN = 0.25;      /* rad, of which a short power series is exact */
static const double STEP_OF_BRISTLE = 0.25; /* of the length over which bristles bend */
static const double STEP_OF_SWING = 0.04;   /* rad of the swing of a motor on a spring */
static const double STEP_OF_STRIBECK = 0.2; /* of the Stribeck velocity; longer beyond its range */

/* What a step calls again and again is set in where it is called; a small chip has no room for that. */
#if defined(__GNUC__) && !defined(__AVR__)
#define INLINE inline __attribute__((always_inline))
#else
#define INLINE
#endif

/* fmin and fmax of numbers, which compilers have inline. */
static double least(double a, double b)
{
    return b < a ? b : a;
}

static double most(double a, double b)
{
    return b > a ? b : a;
}

/* Whether a linear motion is taken in one exact step. An AVR has no room for that. */
static const bool EXACT = sizeof(double) >= 8u;

#define REAL_MOTOR_IS_LINEAR(name, of, is_linear, least, below) (is_linear) != 0,
static const bool IS_LINEAR[] = {REAL_MOTOR_NUMBERS(REAL_MOTOR_IS_LINEAR)};

/* The numbers of a motor, and what else is the same in all of its steps: whether it has a force or a friction over the
 * travel, cogging, a Stribeck effect, a torque that differs from its drive, one whose sign matters, and a linear motion;
 * mean of the cosine over the travel. */
typedef struct {
    REAL_MOTOR_NUMBERS(REAL_MOTOR_FIELD)
    double centre_rad, half_travel_rad, start_s, duration_s;
    bool turns, cogs, falls, transmits, sided, linear;
    double mean_cosine, back_V_s_rad;
} motor;

static motor motor_of(const real_motor *numbers)
{
    motor m;
    memcpy(&m, numbers, sizeof *numbers);
    m.turns = m.force_sin_V != 0.0 || m.force_cos_V != 0.0 || m.friction_sin_V != 0.0 || m.friction_cos_V != 0.0;
    m.cogs = m.cogging_sin_V != 0.0 || m.cogging_cos_V != 0.0;
    m.falls = m.stribeck_V != 0.0 && m.stribeck_rad_s > 0.0;
    m.transmits = m.load_friction != 0.0 || m.source_per_V2 != 0.0 || m.runs_free != 0.0 || m.no_brake != 0.0 ||
                  m.free_between != 0.0;
    m.sided = m.load_friction != 0.0 || m.no_brake != 0.0;
    m.linear = EXACT;
#define REAL_MOTOR_LINEAR(name, of, is_linear, least, below) \
    m.linear = m.linear && (IS_LINEAR[AT_##name] || m.name == 0.0);
    REAL_MOTOR_NUMBERS(REAL_MOTOR_LINEAR)
    m.mean_cosine = m.turns ? sin(m.half_travel_rad) / m.half_travel_rad : 0.0;
    m.back_V_s_rad = (1.0 - m.viscous_share) / m.K_rad_s_V;
    return m;
}

/* The part of 1/K that is back-EMF, V. */
static INLINE double back_emf(const motor *m, double v)
{
    return m->back_V_s_rad * v;
}

/* Share of the time for which the drive `w` connects the motor: it counts where the motor runs free between two pulses. */
static INLINE double pulse_share(const motor *m, double w)
{
    return fabs(w) < m->full_drive_V ? fabs(w) / m->full_drive_V : 1.0;
}

/* Share of the back-EMF that brakes: between two pulses some of it may not. */
static INLINE double braking(const motor *m, double w)
{
    return m->free_between != 0.0 ? 1.0 - m->free_between * (1.0 - pulse_share(m, w)) : 1.0;
}

/* What drives at the drive `w` behind the stage: less the back-EMF that brakes, V. */
static INLINE double net_drive(const motor *m, double w, double v)
{
    return w - back_emf(m, v) * braking(m, w);
}

/* What a bridge passes of the torque at a drive of 0, where it may let the motor run free, and against its drive, where it
 * may have no way for a current. Beside a lag, which is a current that lasts, it passes all. */
typedef struct {
    double idle, against;
} bridge;

static INLINE bridge passed(const motor *m, double w, double v)
{
    bridge all = {1.0, 1.0};
    if (m->lag_s <= 0.0 && (m->runs_free != 0.0 || m->no_brake != 0.0)) {
        all.idle = w == 0.0 ? 1.0 - m->runs_free : 1.0;
        all.against = w * net_drive(m, w, v) <= 0.0 ? 1.0 - m->no_brake : 1.0;
    }
    return all;
}

/* The motor's torque, V, at the drive `w`, which a supply with a resistance lets the current lower: the bridge connects it
 * for the share w of the time. */
static INLINE double torque(const motor *m, double w, double v)
{
    const bridge share = passed(m, w, v);
    const double net = share.idle * share.against * net_drive(m, w, v);
    return m->source_per_V2 != 0.0 ? net / (1.0 + m->source_per_V2 * w * w) : net;
}

/* A drive behind its dead band, up to the one that a sagging stage gives the most of: beyond it gives no less. */
static double before_sag(const motor *m, double size)
{
    return 2.0 * m->sag_per_V * size > 1.0 ? 0.5 / m->sag_per_V : size;
}

static double staged(const motor *m, double u_V)
{
    const double beyond = fabs(u_V) - m->dead_band_V;
    if (beyond <= 0.0) {
        return 0.0;
    }
    const double sign = u_V > 0.0 ? 1.0 : -1.0;
    const double size = before_sag(m, beyond * (1.0 + sign * m->gain_by_sign));
    return sign * size * (1.0 - m->sag_per_V * size);
}

static double lagged(const motor *m, double staged_V, double w_V, double h_s)
{
    return m->lag_s <= 0.0 ? staged_V : staged_V + (w_V - staged_V) * exp(-h_s / m->lag_s);
}

/* The waves at a position: over the travel, and of the cogging. */
typedef struct {
    double sine, cosine, cog_sine, cog_cosine;
} wave;

static wave wave_at(const motor *m, double y)
{
    wave here = {0.0, 1.0, 0.0, 1.0};
    if (m->turns) {
        const double q = y - m->centre_rad;
        here.sine = sin(q);
        here.cosine = cos(q);
    }
    if (m->cogs) {
        const double q = m->cogging_per_rad * y;
        here.cog_sine = sin(q);
        here.cog_cosine = cos(q);
    }
    return here;
}

static const double SINE[] = {-1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362880.0, -1.0 / 39916800.0};
static const double COSINE[] = {-1.0 / 24.0, 1.0 / 720.0, -1.0 / 40320.0, 1.0 / 3628800.0, -1.0 / 479001600.0};

/* Turns sine and cosine of an angle on by a small one, by its power series: what they leave out is below the rounding. */
static INLINE void turn_on(double *sine, double *cosine, double by)
{
    const double q = by * by;
    const double s = by + by * q * (SINE[0] + q * (SINE[1] + q * (SINE[2] + q * (SINE[3] + q * SINE[4]))));
    const double c = q * (0.5 + q * (COSINE[0] + q * (COSINE[1] + q * (COSINE[2] + q * (COSINE[3] + q * COSINE[4])))));
    const double was = *sine;
    *sine += *cosine * s - was * c;
    *cosine -= was * s + *cosine * c;
}

/* The waves `y` rad on from where they are `from`: the stages of a step are near its start. */
static wave wave_near(const motor *m, wave from, double start, double y)
{
    const double by = y - start;
    const double cog_by = m->cogs ? m->cogging_per_rad * by : 0.0;
    if (!EXACT || !(fabs(by) < SMALL_TURN) || !(fabs(cog_by) < SMALL_TURN)) {
        return wave_at(m, y);
    }
    if (m->turns) {
        turn_on(&from.sine, &from.cosine, by);
    }
    if (m->cogs) {
        turn_on(&from.cog_sine, &from.cog_cosine, cog_by);
    }
    return from;
}

/* The wave with these shares, the cosine less its mean over the travel. */
static INLINE double over_travel(const motor *m, wave here, double sine, double cosine)
{
    return m->turns ? sine * here.sine + cosine * (here.cosine - m->mean_cosine) : 0.0;
}

static double force(const motor *m, wave here)
{
    const double total = over_travel(m, here, m->force_sin_V, m->force_cos_V);
    return m->cogs ? total + (m->cogging_sin_V * here.cog_sine + m->cogging_cos_V * here.cog_cosine) : total;
}

/* Torque that load friction sees, at the drive `w`; and what has another law of motion where it turns. */
static INLINE double transmitted(const motor *m, double w, double v, wave here)
{
    return torque(m, w, v) + m->load_outside * force(m, here);
}

static double turning(const motor *m, const real_state *at, wave here)
{
    return m->no_brake != 0.0 ? net_drive(m, at->w, at->v) : transmitted(m, at->w, at->v, here);
}

/* The sign of the torque that load friction sees, and what the bridge passes of it. */
typedef struct {
    double sign;
    bridge passed;
} torque_side;

static torque_side side_of(const motor *m, const real_state *at, wave here)
{
    const double sign = m->sided && transmitted(m, at->w, at->v, here) < 0.0 ? -1.0 : 1.0;
    return (torque_side){sign, passed(m, at->w, at->v)};
}

/* Share of a change of the net drive that is left behind the bridge, the supply and the load friction. */
static double left_of_net(const motor *m, double sign, torque_side side, double w)
{
    const double load = side.sign * sign * m->load_friction;
    const double left = (1.0 - load) * side.passed.idle * side.passed.against;
    return m->source_per_V2 != 0.0 ? left / (1.0 + m->source_per_V2 * w * w) : left;
}

/* Derivative by the velocity of the target velocity of a motor that neither drags nor has a Stribeck effect. */
static double by_velocity(const motor *m, double sign, torque_side side, double w)
{
    const double viscous = -m->K_rad_s_V * m->viscous_by_direction_V_s_rad * sign;
    const double share = m->transmits ? left_of_net(m, sign, side, w) * braking(m, w) : 1.0;
    return viscous + (1.0 - m->viscous_share) * (1.0 - share);
}

static INLINE double level(const motor *m, double speed, wave here, double t_s)
{
    double total = m->fc_V;
    if (m->drift != 0.0) {
        total += m->fc_V * m->drift * ((t_s - m->start_s) / m->duration_s - 0.5);
    }
    total += over_travel(m, here, m->friction_sin_V, m->friction_cos_V);
    if (m->falls) {
        /* a step that is tried beyond standstill and then cut: not infinite */
        total += m->stribeck_V * exp(least(-speed / m->stribeck_rad_s, HUGE_POWER));
    }
    return total;
}

static double level_at_rest(const motor *m, wave here, double t_s)
{
    return level(m, 0.0, here, t_s) + m->static_V;
}

/* Pull on a motor at rest under the drive `w`, and the friction that it must pass, without bristles. */
static double pull_at_rest(const motor *m, double w, wave here)
{
    return torque(m, w, 0.0) + m->bias_V - force(m, here);
}

static INLINE double load_at(const motor *m, double w, double v, wave here)
{
    return m->load_friction == 0.0 ? 0.0 : m->load_friction * fabs(transmitted(m, w, v, here));
}

static double level_of_bristles(const motor *m, double speed, wave here, double t_s)
{
    return most(level(m, speed, here, t_s), LEAST_LEVEL_V);
}

static double stiffness(const motor *m, double level_V)
{
    return least(m->bristle_V_rad, level_V / LEAST_BEND_RAD);
}

static INLINE double target(const motor *m, double sign, const real_state *at, wave here, double t_s)
{
    const double speed = sign * at->v;
    const double friction = m->bristle_V_rad > 0.0 ? at->f : sign * level(m, speed, here, t_s);
    const double viscous = speed * (m->viscous_by_direction_V_s_rad + m->drag_V_s2_rad2 * at->v);
    double drive = at->w;
    if (m->transmits) {
        const double load = load_at(m, at->w, at->v, here);
        drive = torque(m, at->w, at->v) + back_emf(m, at->v) - sign * load;
    }
    return m->K_rad_s_V * (drive + m->bias_V - force(m, here) - friction - viscous);
}

static double bending(const motor *m, double sign, const real_state *at, wave here, double t_s)
{
    if (m->bristle_V_rad <= 0.0) {
        return 0.0;
    }
    const double speed = sign * at->v;
    const double top = level_of_bristles(m, speed, here, t_s);
    return stiffness(m, top) * (at->v - speed * at->f / top);
}

static double direction(const motor *m, const real_state *at, double staged_V, double t_s)
{
    if (at->v != 0.0) {
        return at->v > 0.0 ? 1.0 : -1.0;
    }
    const wave here = wave_at(m, at->y);
    double pull = pull_at_rest(m, at->w, here);
    const double load = load_at(m, at->w, 0.0, here);
    if (m->bristle_V_rad > 0.0) {
        pull -= at->f;
        if (fabs(pull) <= BALANCED + load) {
            pull = m->lag_s > 0.0 ? staged_V - at->w : 0.0;
            if (fabs(pull) <= BALANCED) {
                return 0.0;
            }
        }
        return pull > 0.0 ? 1.0 : -1.0;
    }
    const double held = level_at_rest(m, here, t_s) + load;
    return pull > held ? 1.0 : pull < -held ? -1.0 : 0.0;
}

/* The function phi_4 of exponential integrators at -c: a power series, of which the terms left out are below the rounding. */
static double phi4(double c)
{
    static const double of[] = {1.0 / 24.0,       1.0 / 120.0,       1.0 / 720.0,       1.0 / 5040.0,      1.0 / 40320.0,
                                1.0 / 362880.0, 1.0 / 3628800.0, 1.0 / 39916800.0, 1.0 / 479001600.0};
    if (fabs(c) < 0.5) {
        double total = of[8];
        for (int k = 7; k >= 0; k--) {
            total = of[k] - c * total;
        }
        return total;
    }
    return ((((1.0 - exp(-c)) / c - 1.0) / -c - 0.5) / -c - 1.0 / 6.0) / -c;
}

/* of a step of so many time constants; and phi_1 to phi_4 */
typedef struct {
    double keep, half, mean, b1, b2, b4;
    double p1, p2, p3, p4;
} weights;

static weights weights_of(double c)
{
    const double p4 = phi4(c);
    const double p3 = 1.0 / 6.0 - c * p4;
    const double p2 = 0.5 - c * p3;
    const double p1 = 1.0 - c * p2;
    const double keep = 1.0 - c * p1;
    const double half = sqrt(keep);
    const weights w = {keep, half, 2.0 * p1 / (1.0 + half), p1 - 3.0 * p2 + 4.0 * p3, 2.0 * p2 - 4.0 * p3, 4.0 * p3 - p2,
                       p1,   p2,   p3,                      p4};
    return w;
}

/* Rate at which the friction of bristles nears its level in the middle of a step. */
static double sliding(const motor *m, double sign, const real_state *at, wave here, double a1, double t, double h)
{
    if (m->bristle_V_rad <= 0.0) {
        return 0.0;
    }
    const double speed = most(sign * (at->v + 0.5 * h * (a1 - at->v) / m->tau_s), 0.0);
    const double top = level_of_bristles(m, speed, here, t);
    return stiffness(m, top) * speed / top;
}

/* The inner stages of a step: target velocities; from the second on velocity, position and friction of the bristles;
 * rate of the bristles, 1/s. */
typedef struct {
    double a1, a2, a3, a4;
    double v2, y2, f2, v3, y3, f3, v4, y4, f4;
    double slide;
    wave here1, here2, here3, here4, end; /* the last at `end_y`, where a step ended that was looked at */
    weights k, kept, b;                   /* of the motion, of its last step of another length, and of the bristles */
    double taus, kept_taus, end_y;        /* time constants of the steps that `k` and `kept` are of; nan: none yet */
    /* of a linear motion: side of its torque; target velocity at a velocity of 0, by velocity, and its growth in the step */
    torque_side side;
    double steady, by_v, growth;
} stages;

/* of a step of no time constants */
static const weights NO_FADING = {1.0, 1.0, 1.0, 1.0 / 6.0, 1.0 / 3.0, 1.0 / 6.0, 1.0, 0.5, 1.0 / 6.0, 1.0 / 24.0};

/* The waves where a step ends, which is where the next one sets out. */
static wave wave_at_end(const motor *m, double y, stages *s)
{
    if (y != s->end_y) {
        s->end = wave_at(m, y);
        s->end_y = y;
    }
    return s->end;
}

/* The first stage of any step from there in the direction `sign`. */
static void set_out(const motor *m, double sign, const real_state *at, double t, stages *s)
{
    s->here1 = wave_at_end(m, at->y, s);
    s->a1 = target(m, sign, at, s->here1, t);
}

/* Side of the torque of a linear motion that begins: where it is about to turn, the one to which it accelerates. */
static torque_side side_ahead(const motor *m, const real_state *at, const stages *s)
{
    real_state ahead = *at;
    if (m->sided && fabs(turning(m, at, s->here1)) <= TURNED_V) {
        ahead.v += copysign(most(TURNED_V * m->K_rad_s_V, fabs(s->a1 - at->v)), s->a1 - at->v);
    }
    return side_of(m, &ahead, s->here1);
}

/* The same of a linear motion, whose one stage is exact. */
static real_state moved_linearly(const motor *restrict m, double sign, const real_state *restrict at, double t, double h, stages *restrict s)
{
    const double tau = m->tau_s;
    const double x = h / tau;
    s->side = side_ahead(m, at, s);
    s->by_v = by_velocity(m, sign, s->side, at->w);
    s->steady = s->a1 - s->by_v * at->v;
    s->growth = m->drift != 0.0 ? target(m, sign, at, s->here1, t + h) - s->a1 : 0.0;
    s->taus = x * (1.0 - s->by_v);
    s->k = weights_of(s->taus);
    const weights k = s->k;
    real_state end = *at;
    end.v = k.keep * at->v + x * (k.p1 * s->steady + k.p2 * s->growth);
    end.y = at->y + h * (k.p1 * at->v + x * (k.p2 * s->steady + k.p3 * s->growth));
    return end;
}

/* State after `h` s in the direction `sign`, and its further stages. */
static real_state moved(const motor *restrict m, double sign, const real_state *restrict at, double staged_V, double t, double h, stages *restrict s)
{
    if (EXACT && m->linear) {
        return moved_linearly(m, sign, at, t, h, s);
    }
    const double tau = m->tau_s;
    const double c = h / tau;
    if (!(fabs(c - s->taus) <= ROUNDED * c)) { /* whole steps and what is left to a row take turns */
        const weights kept = s->k;
        const double taus = s->taus;
        s->k = EXACT && fabs(c - s->kept_taus) <= ROUNDED * c ? s->kept : weights_of(c);
        s->taus = c;
        s->kept = kept;
        s->kept_taus = taus;
    }
    const weights k = s->k;
    const double near = 0.5 * c * k.mean;
    const double middle = t + 0.5 * h;
    const double p = at->y + tau * at->v;
    real_state in = *at;
    s->slide = sliding(m, sign, at, s->here1, s->a1, t, h);
    const weights b = s->b = m->bristle_V_rad > 0.0 ? weights_of(h * s->slide) : NO_FADING;
    const double near_f = 0.5 * h * b.mean;
    const double n1 = bending(m, sign, &in, s->here1, t) + s->slide * in.f;
    in.v = s->v2 = k.half * at->v + near * s->a1;
    in.y = s->y2 = p + 0.5 * h * s->a1 - tau * in.v;
    in.f = s->f2 = b.half * at->f + near_f * n1;
    in.w = lagged(m, staged_V, at->w, 0.5 * h);
    s->here2 = wave_near(m, s->here1, at->y, in.y);
    s->a2 = target(m, sign, &in, s->here2, middle);
    const double n2 = bending(m, sign, &in, s->here2, middle) + s->slide * in.f;
    in.v = s->v3 = k.half * at->v + near * s->a2;
    in.y = s->y3 = p + 0.5 * h * s->a2 - tau * in.v;
    in.f = s->f3 = b.half * at->f + near_f * n2;
    s->here3 = wave_near(m, s->here1, at->y, in.y);
    s->a3 = target(m, sign, &in, s->here3, middle);
    const double n3 = bending(m, sign, &in, s->here3, middle) + s->slide * in.f;
    in.v = s->v4 = k.half * s->v2 + near * (2.0 * s->a3 - s->a1);
    in.y = s->y4 = p + h * s->a3 - tau * in.v;
    in.f = s->f4 = b.half * s->f2 + near_f * (2.0 * n3 - n1);
    in.w = lagged(m, staged_V, at->w, h);
    s->here4 = wave_near(m, s->here1, at->y, in.y);
    s->a4 = target(m, sign, &in, s->here4, t + h);
    const double n4 = bending(m, sign, &in, s->here4, t + h) + s->slide * in.f;
    in.v = k.keep * at->v + c * (k.b1 * s->a1 + k.b2 * (s->a2 + s->a3) + k.b4 * s->a4);
    in.y = p + h / 6.0 * (s->a1 + 2.0 * (s->a2 + s->a3) + s->a4) - tau * in.v;
    in.f = b.keep * at->f + h * (b.b1 * n1 + b.b2 * (n2 + n3) + b.b4 * n4);
    return in;
}

/* Largest step in the direction `sign` with a small error, whose first stage is `s`. */
static double longest_step(const motor *m, double sign, const real_state *at, double staged_V, double t_s, const stages *s)
{
    const double tau = m->tau_s;
    double longest = LONGEST_STEP * tau;
    if (EXACT && m->linear) {
        return longest;
    }
    const double speed = fabs(at->v);
    const double pull = fabs(s->a1 - at->v) / tau;
    double distance = m->turns ? STEP_OF_TURN : INFINITY;
    double spring = 0.0;
    if (m->lag_s > 0.0 && at->w != staged_V) {
        longest = least(longest, STEP_OF_LAG * m->lag_s * pow(fabs(at->w - staged_V) * most(m->lag_s, SHORT_LAG_S), -0.2));
    }
    if (m->cogs) {
        if (m->cogging_per_rad != 0.0) {
            distance = least(distance, STEP_OF_TURN / fabs(m->cogging_per_rad));
        }
        spring += fabs(m->cogging_per_rad) * (fabs(m->cogging_sin_V) + fabs(m->cogging_cos_V));
    }
    if (m->bristle_V_rad > 0.0) {
        const double top = level_of_bristles(m, speed, s->here1, t_s);
        const double stiff = stiffness(m, top);
        double left = least(most(fabs(1.0 - sign * at->f / top), SLIDING), 2.0);
        left += LEVEL_CHANGES * (fabs(m->friction_sin_V) + fabs(m->friction_cos_V)) / stiff;
        if (m->falls) {
            left += fabs(m->stribeck_V) * exp(-speed / m->stribeck_rad_s) / top;
        }
        distance = least(distance, STEP_OF_BRISTLE * top / stiff * pow(left, -0.25));
        spring += stiff * left;
    }
    if (distance < INFINITY) {
        longest = least(longest, 2.0 * distance / (speed + sqrt(speed * speed + 2.0 * pull * distance) + 1e-9));
    }
    if (spring > 0.0) {
        longest = least(longest, STEP_OF_SWING * sqrt(tau / (m->K_rad_s_V * spring)));
    }
    if (m->falls) {
        const double unit = m->stribeck_rad_s;
        const double fade = exp(least(speed / (5.0 * unit), 50.0));
        const double rate = pull + m->K_rad_s_V * fabs(m->stribeck_V) / tau + 1e-9;
        longest = least(longest, STEP_OF_STRIBECK * fade * unit / rate);
    }
    if (m->falls || m->drag_V_s2_rad2 != 0.0 || m->runs_free != 0.0 || m->no_brake != 0.0) {
        longest = least(longest, CURVED_STEP * tau);
    } else if (m->turns || m->transmits || spring > 0.0 || m->viscous_by_direction_V_s_rad != 0.0) {
        longest = least(longest, STEP_OF_TAU * tau);
    }
    return STRETCH * longest;
}

/* By how much the pull in the direction `sign` on a motor at rest is above its level `h` s after `t`. */
static double margin(const motor *m, double sign, const real_state *at, double staged_V, double t, double h)
{
    const double w = lagged(m, staged_V, at->w, h);
    const wave here = wave_at(m, at->y);
    const double held = level_at_rest(m, here, t + h) + load_at(m, w, 0.0, here); /* as in `direction`, to the last bit */
    return sign * pull_at_rest(m, w, here) - held;
}

/* Motion in one direction, or rest.
 * sign         direction: +1, -1; 0 where friction holds the motor
 * duration_s   how long it lasts
 * released     direction in which a held motor breaks away at its end; 0: it does not
 * reverses     whether it ends with the velocity at 0
 * end, in      state at its end; stages of the method, unless the motor is held
 */
typedef struct {
    double sign, duration_s, released;
    bool reverses;
    real_state end;
    stages in;
} step;

static const step FIRST_STEP = {.in = {.taus = NAN, .kept_taus = NAN, .end_y = NAN}}; /* whose weights are not known yet */

/* The next step of a motor that friction holds, at most `longest_s`: to its end, or to where it breaks away. */
static void rest(const motor *m, const real_state *at, double staged_V, double t_s, double longest_s, step *s)
{
    double h = longest_s;
    s->released = 0.0;
    if ((m->lag_s > 0.0 || m->drift != 0.0) && m->bristle_V_rad <= 0.0) {
        if (m->lag_s > 0.0 && m->drift != 0.0) {
            h = least(h, most(m->lag_s, 1e-3)); /* within it the margin has no second zero */
        }
        for (int side = 0; side < 2; side++) {
            const double sign = side == 0 ? 1.0 : -1.0;
            if (margin(m, sign, at, staged_V, t_s, h) > 0.0) {
                double low = 0.0;
                double high = h;
                for (int i = 0; i < ROUNDS; i++) {
                    const double middle = 0.5 * (low + high);
                    if (middle <= low || middle >= high) {
                        break; /* there is no number between them */
                    }
                    if (margin(m, sign, at, staged_V, t_s, middle) > 0.0) {
                        high = middle;
                    } else {
                        low = middle;
                    }
                }
                h = high;
                s->released = sign;
            }
        }
    }
    s->sign = 0.0;
    s->duration_s = h;
    s->reverses = false;
    s->end = *at;
    s->end.v = 0.0;
    s->end.w = lagged(m, staged_V, at->w, h);
}

/* Ends a step of `h` s, of a motor whose law changes with the torque, where that turns; returns how long it then is. */
static double until_torque_turns(const motor *m, double sign, const real_state *at, double staged_V, double t_s, double h, step *s)
{
    if (!m->sided) {
        return h;
    }
    double low = 0.0;
    double high = h;
    double first = turning(m, at, s->in.here1);
    double last = turning(m, &s->end, wave_at_end(m, s->end.y, &s->in));
    if (fabs(first) <= TURNED_V || fabs(last) <= TURNED_V || (first > 0.0) == (last > 0.0)) {
        return h;
    }
    for (int i = 0; i < ROUNDS && fabs(last) > TURNED_V; i++) { /* friction is continuous there: near it will do */
        h = low + (high - low) * least(most(first / (first - last), 0.05), 0.95);
        s->end = moved(m, sign, at, staged_V, t_s, h, &s->in);
        const double now = turning(m, &s->end, wave_at_end(m, s->end.y, &s->in));
        if (fabs(now) <= TURNED_V) {
            break;
        }
        if ((now > 0.0) == (first > 0.0)) {
            low = h;
            first = now;
        } else {
            high = h;
            last = now;
        }
    }
    return h;
}

/* The next step under the constant drive `staged_V` before its lag: at most `longest_s` long, to an event. */
static void next_step(const motor *m, const real_state *at, double staged_V, double t_s, double longest_s, step *s)
{
    const double sign = direction(m, at, staged_V, t_s);
    if (sign == 0.0) {
        rest(m, at, staged_V, t_s, longest_s, s);
        return;
    }
    set_out(m, sign, at, t_s, &s->in);
    double h = least(longest_s, longest_step(m, sign, at, staged_V, t_s, &s->in));
    s->sign = sign;
    s->released = 0.0;
    s->reverses = false;
    s->end = moved(m, sign, at, staged_V, t_s, h, &s->in);
    h = until_torque_turns(m, sign, at, staged_V, t_s, h, s);
    s->duration_s = h;
    if (sign * s->end.v > 0.0) {
        return;
    }
    if (at->v == 0.0) { /* rounding sends a motor in balance back: it stays */
        const double w = s->end.w;
        s->sign = 0.0;
        s->end = *at;
        s->end.w = w;
        return;
    }
    double low = 0.0;
    double high = h;
    for (int i = 0; i < ROUNDS; i++) {
        const double slope = sign * (target(m, sign, &s->end, wave_at_end(m, s->end.y, &s->in), t_s + h) - s->end.v) / m->tau_s;
        double next = slope < 0.0 ? h - sign * s->end.v / slope : 0.5 * (low + high);
        if (!(low < next && next < high)) {
            next = 0.5 * (low + high);
        }
        const double change = fabs(next - h);
        h = next;
        s->end = moved(m, sign, at, staged_V, t_s, h, &s->in);
        if (change <= EVENT_S || s->end.v == 0.0) {
            break;
        }
        if (sign * s->end.v > 0.0) {
            low = h;
        } else {
            high = h;
        }
    }
    s->end.v = 0.0;
    s->duration_s = h;
    s->reverses = true;
}

/* Cuts a step of a motor in motion, which ends beyond `stop`, where it meets it. */
static void cut(const motor *m, const real_state *at, double staged_V, double t_s, double stop, step *s)
{
    double low = 0.0;
    double high = s->duration_s;
    for (int i = 0; i < ROUNDS; i++) {
        const double middle = 0.5 * (low + high);
        const real_state there = moved(m, s->sign, at, staged_V, t_s, middle, &s->in);
        if (s->sign * (there.y - stop) < 0.0) {
            low = middle;
        } else {
            high = middle;
        }
    }
    s->end = moved(m, s->sign, at, staged_V, t_s, high, &s->in);
    s->end.v = 0.0;
    s->end.y = stop;
    s->duration_s = high;
}

static void take_up_play(const motor *m, double sign, real_state *at)
{
    if (sign > 0.0) {
        at->x = most(at->x, at->y - 0.5 * m->backlash_rad);
    } else if (sign < 0.0) {
        at->x = least(at->x, at->y + 0.5 * m->backlash_rad);
    }
}

void real_start(const real_motor *numbers, real_state *at, double y)
{
    const motor own = motor_of(numbers);
    const motor *const m = &own;
    at->v = 0.0;
    at->y = y;
    at->x = y;
    at->w = staged(m, 0.0);
    at->f = 0.0;
    if (m->bristle_V_rad > 0.0) {
        const wave here = wave_at(m, y);
        const double held = level_of_bristles(m, 0.0, here, m->start_s);
        at->f = least(most(pull_at_rest(m, at->w, here), -held), held);
    }
}

void real_put(const real_motor *m, real_state *at, double v, double y)
{
    at->v = v;
    at->y = y;
    at->x = least(most(at->x, y - 0.5 * m->backlash_rad), y + 0.5 * m->backlash_rad);
}

void real_advance(const real_motor *numbers, real_state *at, double u_V, const double when[2], const double stops[2])
{
    const motor own = motor_of(numbers);
    const motor *const m = &own;
    const double drive_V = staged(m, u_V);
    double left_s = when[1];
    step s = FIRST_STEP;
    if (m->lag_s <= 0.0) {
        at->w = drive_V;
    }
    while (left_s > 0.0) {
        const double t = when[0] + when[1] - left_s;
        next_step(m, at, drive_V, t, left_s, &s);
        const double stop = s.sign > 0.0 ? stops[1] : stops[0];
        if (s.sign != 0.0 && at->v == 0.0 && s.sign * (at->y - stop) >= 0.0) { /* pressed against it */
            const double h = least(left_s, PRESSED_S);
            at->w = lagged(m, drive_V, at->w, h);
            left_s -= h;
            continue;
        }
        if (s.sign * (s.end.y - stop) > 0.0) {
            cut(m, at, drive_V, t, stop, &s);
        }
        *at = s.end;
        take_up_play(m, s.sign, at);
        left_s -= s.duration_s;
    }
}

double real_force(const real_motor *numbers, double y)
{
    const motor m = motor_of(numbers);
    return force(&m, wave_at(&m, y));
}

double real_level(const real_motor *numbers, double speed, double y)
{
    const motor m = motor_of(numbers);
    return level(&m, speed, wave_at(&m, y), m.start_s);
}

double real_level_at_rest(const real_motor *numbers, double y)
{
    const motor m = motor_of(numbers);
    return level_at_rest(&m, wave_at(&m, y), m.start_s);
}

double real_staged(const real_motor *numbers, double u_V)
{
    const motor m = motor_of(numbers);
    return staged(&m, u_V);
}

double real_reading(const real_motor *m, double x)
{
    if (m->linearity_sin1_rad == 0.0 && m->linearity_cos1_rad == 0.0 && m->linearity_sin2_rad == 0.0 &&
        m->linearity_cos2_rad == 0.0) {
        return x;
    }
    const double share = (x - m->centre_rad) / m->half_travel_rad;
    const double q = PI * share;
    return x + m->linearity_sin1_rad * (sin(q) - 3.0 / PI * share) + m->linearity_cos1_rad * cos(q) +
           m->linearity_sin2_rad * (sin(2.0 * q) + 1.5 / PI * share) + m->linearity_cos2_rad * cos(2.0 * q);
}
