/* The loops of departing_motor.py, which has the equations: small fixed steps, forces frozen at the middle of each. */
#include <math.h>
#include <stdint.h>

/* In the order of Departures. */
typedef struct {
    double dead_band_V, gain_by_sign, sag_per_V, lag_s, viscous_V_s_rad, static_V, stribeck_V, stribeck_rad_s;
    double drag_V_s2_rad2, bristle_V_rad, force_V, force_phase_rad, friction_share, friction_phase_rad;
    double cogging_V, cogging_per_rad, cogging_phase_rad, backlash_rad;
    double linearity_rad, linearity_per_rad, linearity_phase_rad, drift, random_V;
} departures;

typedef struct {
    double tau_s, K_rad_s_V, fc_V, bias_V;
} plain;

/* Velocity, position, bend of the bristles, sensor's side of the play, drive behind the lag. */
typedef struct {
    double v, y, bend, held, w;
} shaft;

/* The sensor's side of the play. */
static double played(double y, double held, double play)
{
    if (y - held > 0.5 * play) {
        return y - 0.5 * play;
    }
    return held - y > 0.5 * play ? y + 0.5 * play : held;
}

/* `timing`: time at the begin, duration of the whole record, longest step; `drive`: it, and a random force. */
void departing_advance(const plain *m, const departures *d, const double timing[3], const double drive[2], double span, shaft *at)
{
    const double tau = m->tau_s;
    const double K = m->K_rad_s_V;
    const double beta = d->viscous_V_s_rad;
    const double drag = d->drag_V_s2_rad2;
    const double sigma = d->bristle_V_rad;
    const double strib = d->stribeck_V;
    const double vs = d->stribeck_rad_s;
    const double play = d->backlash_rad;
    const double u = drive[0];
    const double steps = fmax(1.0, ceil(span / timing[2]));
    const double h = span / steps;
    double v = at->v;
    double y = at->y;
    double bend = at->bend;
    double held = at->held;
    double w = at->w;
    double goal = 0.0;
    if (u > d->dead_band_V) {
        goal = u - d->dead_band_V;
    } else if (u < -d->dead_band_V) {
        goal = u + d->dead_band_V;
    }
    goal *= 1.0 + (goal > 0.0 ? d->gain_by_sign : -d->gain_by_sign);
    goal *= 1.0 - d->sag_per_V * fabs(goal);
    const double share = d->lag_s > 0.0 ? exp(-0.5 * h / d->lag_s) : 0.0;
    for (double i = 0.0; i < steps; i += 1.0) {
        const double t = timing[0] + (i + 0.5) * h;
        const double w_mid = goal + (w - goal) * share;
        double left = h;
        w = goal + (w - goal) * share * share;
        for (int part_of_step = 0; part_of_step < 3; part_of_step++) {
            const double ym = y + 0.5 * left * v;
            const double level = m->fc_V * (1.0 + d->drift * (t / timing[1] - 0.5)) *
                                 (1.0 + d->friction_share * sin(ym + d->friction_phase_rad));
            const double push = w_mid + m->bias_V + drive[1] - d->force_V * sin(ym + d->force_phase_rad) -
                                d->cogging_V * sin(d->cogging_per_rad * ym + d->cogging_phase_rad);
            if (sigma > 0.0) { /* bristles: the excess of a Stribeck effect is in their level */
                const double g = level + strib * exp(-fabs(v) / vs);
                const double a = sigma * fabs(v) / g;
                double middle;
                if (a > 1e-9) {
                    const double end = v / a;
                    middle = end + (bend - end) * exp(-0.5 * a * left);
                    bend = end + (bend - end) * exp(-a * left);
                } else {
                    middle = bend + 0.5 * v * left;
                    bend += v * left;
                }
                double acceleration = (K * (push - sigma * middle - beta * fabs(v) - drag * v * fabs(v)) - v) / tau;
                const double vm = v + 0.5 * left * acceleration;
                acceleration = (K * (push - sigma * middle - beta * fabs(vm) - drag * vm * fabs(vm)) - vm) / tau;
                y += left * (v + 0.5 * left * acceleration);
                v += left * acceleration;
                break;
            }
            double sign = 0.0;
            if (v != 0.0) {
                sign = v > 0.0 ? 1.0 : -1.0;
            } else if (push > level + d->static_V + strib) {
                sign = 1.0;
            } else if (push < -(level + d->static_V + strib)) {
                sign = -1.0;
            }
            if (sign == 0.0) {
                break;
            }
            /* speed at the middle, for what depends on it */
            const double f0 = level + strib * exp(-fabs(v) / vs);
            const double a0 = (K * (push - sign * f0 - beta * fabs(v) - drag * v * fabs(v)) - v) / tau;
            double vm = v + 0.5 * left * a0;
            if (vm * sign < 0.0) {
                vm = 0.0;
            }
            const double f = level + strib * exp(-fabs(vm) / vs);
            const double target = K * (push - sign * f - beta * fabs(vm) - drag * vm * fabs(vm));
            const double decay = -expm1(-left / tau);
            const double next_v = v + (target - v) * decay;
            if (v != 0.0 && next_v * sign < 0.0) { /* it comes to rest within the step: go to there, then on from rest */
                const double stop = tau * log1p(-v / target);
                const double part = -expm1(-stop / tau);
                y += target * stop + (v - target) * tau * part;
                v = 0.0;
                left -= stop;
                if (left <= 0.0) {
                    break;
                }
                held = played(y, held, play);
                continue;
            }
            y += target * left + (v - target) * tau * decay;
            v = next_v;
            break;
        }
        held = played(y, held, play);
    }
    *at = (shaft){v, y, bend, held, w};
}

/* A relay test from rest. `timing`: period, delay, step of the reading, begin, whole, longest step; noise and random force
 * (rows); `out` (rows, 5): reading, drive, position, velocity, integral of the reading. */
void departing_relay_test(const plain *m, const departures *d, const double timing[6], const double gains[2], const double *noise, const double *force, int64_t rows, double *out)
{
    const double period = timing[0];
    const double delay = timing[1];
    const double lsb = timing[2];
    shaft at = {0.0, 0.0, 0.0, 0.0, 0.0};
    double u = 0.0;
    double z = 0.0;
    double last = 0.0;
    double sy = 0.0;
    double sz = 0.0;
    for (int64_t k = 0; k < rows; k++) {
        /* the sample */
        at.held = played(at.y, at.held, d->backlash_rad);
        double read = at.held + d->linearity_rad * sin(d->linearity_per_rad * at.held + d->linearity_phase_rad) + noise[k];
        if (lsb > 0.0) {
            read = lsb * floor(read / lsb + 0.5);
        }
        if (k == 0) {
            sy = sz = read >= 0.0 ? 1.0 : -1.0;
        } else {
            z += 0.5 * period * (read + last);
        }
        last = read;
        sy = read > 0.0 ? 1.0 : read < 0.0 ? -1.0 : sy;
        sz = z > 0.0 ? 1.0 : z < 0.0 ? -1.0 : sz;
        const double next = -gains[0] * sy - gains[1] * sz;
        double *const row = out + 5 * k;
        row[0] = read;
        row[1] = next;
        row[2] = at.y;
        row[3] = at.v;
        row[4] = z;
        /* to the next sample: the old drive, then the new one */
        const double begins = timing[3] + (double)k * period;
        const double before[3] = {begins, timing[4], timing[5]};
        const double behind[3] = {begins + delay, timing[4], timing[5]};
        departing_advance(m, d, before, (const double[2]){u, force[k]}, delay, &at);
        u = next;
        departing_advance(m, d, behind, (const double[2]){u, force[k]}, period - delay, &at);
    }
}
