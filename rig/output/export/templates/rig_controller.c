#include "rig_controller.h"

#include "rig_motor.h"

#include <math.h>

static const double SOFT_SHARE = 0.1;   /* of fc: within it the dead band is crossed on a straight line */
static const double STILL_SHARE = 0.03; /* of tau: within it a shaft leaves its static level behind */
static const double CLOSE_RAD = 1e-9;
enum { ROUNDS = 40 };

static const real_motor MOTOR = RIG_MOTOR;

/* Drive whose stage gives `wanted_V`. */
static double before_stage(double wanted_V)
{
    const double size = fabs(wanted_V);
    if (!(size > 0.0)) {
        return 0.0;
    }
    const double sign = wanted_V > 0.0 ? 1.0 : -1.0;
    const double given_V = MOTOR.sag_per_V <= 0.0 ? size : fmin(size, 0.25 / MOTOR.sag_per_V);
    const double before_sag = 2.0 * given_V / (1.0 + sqrt(1.0 - 4.0 * MOTOR.sag_per_V * given_V));
    const double soft_V = SOFT_SHARE * MOTOR.fc_V;
    const double crossed = size >= soft_V ? 1.0 : size / soft_V;
    return sign * (before_sag / (1.0 + sign * MOTOR.gain_by_sign) + crossed * MOTOR.dead_band_V);
}

/* How much of the static level a drive has to add at an estimated speed: 1 at rest, 0 in motion. */
static double still_share(double speed_rad_s)
{
    const double still_rad_s = STILL_SHARE * MOTOR.K_rad_s_V * MOTOR.static_V;
    return still_rad_s > 0.0 ? fmax(1.0 - speed_rad_s / still_rad_s, 0.0) : 0.0;
}

double rig_drive_V(double v_rad_s, double y_rad, double acceleration_rad_s2, double direction)
{
    double friction_V = 0.0;
    if (direction > 0.0 || direction < 0.0) {
        const double sign = direction > 0.0 ? 1.0 : -1.0;
        const double speed = fmax(sign * v_rad_s, 0.0);
        const double level_V = real_level(&MOTOR, speed, y_rad);
        friction_V = sign * (level_V + still_share(speed) * MOTOR.static_V);
    }
    const double viscous_V =
        fabs(v_rad_s) * (MOTOR.viscous_by_direction_V_s_rad + MOTOR.drag_V_s2_rad2 * v_rad_s);
    const double wanted_V = (MOTOR.tau_s * acceleration_rad_s2 + v_rad_s) / MOTOR.K_rad_s_V + real_force(&MOTOR, y_rad) +
                            friction_V + viscous_V - MOTOR.bias_V;
    return before_stage(wanted_V);
}

double rig_linearising_drive_V(double v_rad_s, double y_rad, const rig_reference *to, double k1_1_s, double k2_1_s2)
{
    const double wanted = to->a_rad_s2 + k1_1_s * (to->v_rad_s - v_rad_s) + k2_1_s2 * (to->y_rad - y_rad);
    return rig_drive_V(v_rad_s, y_rad, wanted, to->v_rad_s);
}

/* Position at which the sensor shows `reading_rad`; beyond the travel its error stays as at the end. */
static double position(double reading_rad)
{
    if (!RIG_MOTOR_HAS_LINEARITY) {
        return reading_rad;
    }
    const double low = MOTOR.centre_rad - MOTOR.half_travel_rad;
    const double high = MOTOR.centre_rad + MOTOR.half_travel_rad;
    double x = reading_rad;
    for (int i = 0; i < ROUNDS; i++) {
        const double inside = fmin(fmax(x, low), high);
        const double next = reading_rad - (real_reading(&MOTOR, inside) - inside);
        if (fabs(next - x) <= CLOSE_RAD) {
            return next;
        }
        x = next;
    }
    return x;
}

#if RIG_MOTOR_HAS_PARTS
static void advance(real_state *at, double u_V, double dt_s)
{
    static const double NO_STOPS[2] = {-INFINITY, INFINITY};
    const double when[2] = {0.0, dt_s};
    real_advance(&MOTOR, at, u_V, when, NO_STOPS);
}
#else
/* Between reversals the velocity of a plain motor tends exponentially to one value. */
static void advance(real_state *at, double u_V, double dt_s)
{
    const double pull_V = u_V + MOTOR.bias_V;
    double left_s = dt_s;
    while (left_s > 0.0) {
        const bool rises = at->v > 0.0 || (!(at->v < 0.0) && pull_V > 0.0);
        const double target = MOTOR.K_rad_s_V * (rises ? pull_V - MOTOR.fc_V : pull_V + MOTOR.fc_V);
        if (fabs(at->v) <= 0.0 && (rises ? target <= 0.0 : target >= 0.0)) {
            return; /* friction holds it */
        }
        const double share = at->v / target;
        const double stops_s = share < 0.0 ? MOTOR.tau_s * log(1.0 - share) : INFINITY;
        const double h = fmin(left_s, stops_s);
        const double keep = exp(-h / MOTOR.tau_s);
        at->y += target * h + MOTOR.tau_s * (at->v - target) * (1.0 - keep);
        at->v = stops_s <= left_s ? 0.0 : target + (at->v - target) * keep;
        left_s -= h;
    }
}
#endif

/* The drive that was asked for at a tick; 0 V before the first. */
static double asked_at(const rig_controller *c, long tick)
{
    return tick < 0 ? 0.0 : c->asked_V[tick % RIG_WAITING_MOST];
}

bool rig_controller_start(rig_controller *c, double period_s)
{
    c->period_s = period_s;
    c->k1_1_s = RIG_MOTOR_K1_1_S;
    c->k2_1_s2 = RIG_MOTOR_K2_1_S2;
    c->waiting = (int)(RIG_MOTOR_DELAY_S / period_s);
    c->late_s = RIG_MOTOR_DELAY_S - c->waiting * period_s;
    c->tick = 0;
    c->acting_V = 0.0;
    c->last_V = 0.0;
    return c->waiting < RIG_WAITING_MOST - 1;
}

double rig_controller_step(rig_controller *c, double reading_rad, const rig_reference *to)
{
    const double y_rad = position(reading_rad);
    if (c->tick == 0) {
        real_start(&MOTOR, &c->at, y_rad);
    } else {
        advance(&c->at, c->acting_V, c->late_s);
        c->acting_V = asked_at(c, c->tick - 1 - c->waiting);
        advance(&c->at, c->acting_V, c->period_s - c->late_s);
    }
    const double error_rad = y_rad - c->at.y;
    real_put(&MOTOR, &c->at, c->at.v + RIG_MOTOR_OBSERVER_V_1_S * error_rad, c->at.y + RIG_MOTOR_OBSERVER_Y * error_rad);

    real_state then = c->at; /* when the drive that is computed now comes to the motor */
    advance(&then, c->acting_V, c->late_s);
    for (int i = c->waiting; i > 0; i--) {
        advance(&then, asked_at(c, c->tick - i), c->period_s);
    }
    if (MOTOR.lag_s > 0.0) { /* a stage that lags acts as if so much later */
        advance(&then, c->last_V, MOTOR.lag_s);
    }
    c->last_V = rig_linearising_drive_V(then.v, then.y, to, c->k1_1_s, c->k2_1_s2);
    c->asked_V[c->tick % RIG_WAITING_MOST] = c->last_V;
    c->tick++;
    return c->last_V;
}
