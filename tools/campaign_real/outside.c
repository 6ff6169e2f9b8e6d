/* The loop of outside.py, which has the equations: small fixed steps, forces frozen at the middle of each. */
#include <math.h>
#include <stdint.h>

/* In the order of Outside. */
typedef struct {
    double share, share_per_rad, share_phase, force_V, force_per_rad, force_phase;
    double mass, spring_per_s, damping, warm, warm_s, by_load, supply, random_V;
} outside;

typedef struct {
    double tau_s, K_rad_s_V, fc_V, bias_V, largest_V;
} plain;

/* `timing`: period, delay of the drive, longest step; `loop`: whether it is closed, its gain, its goal. Each row of `out`
   is time, reading and drive. Returns the mean friction while the shaft turns, without what goes over the
   angle. */
double outside_record(const plain *m, const outside *o, const double timing[3], const double loop[3], const double *levels,
                      const double *force_V, int64_t rows, double *out)
{
    const int64_t steps = (int64_t)fmax(1.0, rint(timing[0] / timing[2]));
    const double h = timing[0] / (double)steps;
    const double resonance = o->spring_per_s * o->spring_per_s;
    double v = 0.0;
    double y = 0.0;
    double u = 0.0;
    double load_v = 0.0;
    double load_y = 0.0;
    double total = 0.0;
    int64_t count = 0;
    for (int64_t k = 0; k < rows; k++) {
        const double t = (double)k * timing[0];
        const double reading = o->mass > 0.0 ? load_y : y;
        double next_u = levels[k];
        if (loop[0] > 0.0) {
            next_u = fmin(fmax(loop[1] * (loop[2] * levels[k] - reading), -m->largest_V), m->largest_V);
        }
        out[3 * k] = t;
        out[3 * k + 1] = reading;
        out[3 * k + 2] = next_u;
        for (int64_t i = 0; i < steps; i++) {
            if ((double)i * h >= timing[1]) {
                u = next_u;
            }
            const double warmth = 1.0 - exp(-(t + (double)i * h) / o->warm_s);
            const double left = 1.0 - 0.5 * o->warm * warmth;
            const double K = m->K_rad_s_V * left;
            double tau = m->tau_s * left;
            const double middle = y + 0.5 * h * v;
            const double force = o->force_V * sin(o->force_per_rad * middle + o->force_phase);
            const double wave = 1.0 + o->share * sin(o->share_per_rad * middle + o->share_phase);
            const double flat = m->fc_V * (1.0 - o->warm * warmth) + o->by_load * fabs(force);
            const double level = flat + m->fc_V * (1.0 - o->warm * warmth) * (wave - 1.0);
            const double current = u - v / K;
            double push = u * current > 0.0 ? u * (1.0 - o->supply * fabs(current) / m->largest_V) : u;
            push += m->bias_V - force + force_V[k];
            if (o->mass > 0.0) {
                /* the coupling's torque, as a voltage: at equal speeds and angles it is 0 */
                const double twist = (y - load_y) * resonance + 2.0 * o->damping * o->spring_per_s * (v - load_v);
                push -= tau * o->mass * (1.0 - o->mass) * twist / K;
                tau *= 1.0 - o->mass;
                load_v += h * (1.0 - o->mass) * twist;
                load_y += h * load_v;
            }
            double sign = v > 0.0 ? 1.0 : -1.0;
            if (v == 0.0) {
                if (fabs(push) <= level) {
                    continue;
                }
                sign = push > 0.0 ? 1.0 : -1.0;
            }
            total += flat;
            count++;
            double next_v = v + (K * (push - sign * level) - v) * -expm1(-h / tau);
            if (v * next_v < 0.0 || (v != 0.0 && next_v * sign < 0.0)) {
                next_v = 0.0;
            }
            y += 0.5 * h * (v + next_v);
            v = next_v;
        }
    }
    return count > 0 ? total / (double)count : 0.0;
}
