#include "bench.h"

#include <errno.h>
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "plain_motor.h"

/* ---- motion ---- */

static const double LEAST_SHARE = 1e-6; /* of the time connected: its braking is beyond any measurement */

/* Viscous friction lowers gain and time constant alike. */
static double viscous_share(const bench_params *p)
{
    return 1.0 + p->K_rad_s_V * p->viscous_V_s_rad;
}

/* When within a segment, which goes one way, it has gone from `start` to `stop`: bisection to the last bit. */
static double time_to(const plain_motor *m, const plain_segment *s, const double *c, plain_state start, double stop)
{
    double before = 0.0;
    double after = s->duration_s;
    for (;;) {
        const double middle = 0.5 * (before + after);
        if (middle <= before || middle >= after) {
            return after;
        }
        if (fabs(plain_within(m, s, c, start, middle).y - start.y) < fabs(stop - start.y)) {
            before = middle;
        } else {
            after = middle;
        }
    }
}

void bench_motion(const bench_params *p, double *v, double *y, double u_V, double dt_s)
{
    const double share = viscous_share(p);
    const plain_motor m = {
        p->tau_s / share, p->K_rad_s_V / share, p->fc_plus_V,      p->fc_minus_V,
        p->fs_plus_V,     p->fs_minus_V,        p->stribeck_rad_s, p->bias_V,
    };
    const double drive_V = u_V + p->bias_V;
    double c[SERIES];
    while (dt_s > 0.0) {
        const plain_state start = {*v, *y, 0.0};
        const plain_segment s = plain_next_segment(&m, *v, drive_V, dt_s, c);
        if (*v == 0.0 &&
            (s.sign == 0.0 || (s.sign > 0.0 && *y >= p->stop_high_rad) || (s.sign < 0.0 && *y <= p->stop_low_rad))) {
            return; /* held by friction or pressed against a stop, as long as the drive stays */
        }
        const plain_state end = plain_after(&m, &s, c, start);
        const bool outward_high = end.y > p->stop_high_rad;
        if (outward_high || end.y < p->stop_low_rad) {
            const double stop = outward_high ? p->stop_high_rad : p->stop_low_rad;
            dt_s -= time_to(&m, &s, c, start, stop);
            *y = stop;
            *v = 0.0;
            continue;
        }
        *v = end.v;
        *y = end.y;
        dt_s -= s.duration_s;
    }
}

bool bench_is_faulty(const bench *b)
{
    return b->armed_t_s >= 0.0 && b->t_s >= b->armed_t_s + b->p.fault_after_s;
}

/* Behind a bridge that lets the motor run free while PWM is low: rig/model/bench.py has the equation. */
static void coast(bench *b, double u_V, double dt_s)
{
    const double share = fmax(fabs(u_V) / (b->p.supply_V - b->p.bridge_drop_V), LEAST_SHARE);
    bench_params connected = b->p;
    connected.tau_s /= share;
    connected.fc_plus_V /= share;
    connected.fc_minus_V /= share;
    connected.fs_plus_V /= share;
    connected.fs_minus_V /= share;
    connected.viscous_V_s_rad /= share;
    connected.bias_V /= share;
    bench_motion(&connected, &b->v_rad_per_s, &b->y_rad, u_V / share, dt_s);
}

static void move_to(bench *b, double t_s)
{
    const double dt_s = t_s - b->t_s;
    if (b->p.coasting != 0) {
        coast(b, bench_motor_V(b), dt_s);
    } else if (b->p.parts == 0) {
        bench_motion(&b->p, &b->v_rad_per_s, &b->y_rad, bench_motor_V(b), dt_s);
    } else {
        const double when[2] = {b->armed_t_s >= 0.0 ? b->t_s - b->armed_t_s : 0.0, dt_s}; /* drift runs from arming */
        const double stops[2] = {b->p.stop_low_rad, b->p.stop_high_rad};
        real_put(&b->p.real, &b->real, b->v_rad_per_s, b->y_rad);
        real_advance(&b->p.real, &b->real, bench_motor_V(b), when, stops);
        b->v_rad_per_s = b->real.v;
        b->y_rad = b->real.y;
    }
    b->t_s = t_s;
}

void bench_advance_to(bench *b, double t_s)
{
    const double begins_s = b->armed_t_s + b->p.fault_after_s;
    if (b->armed_t_s >= 0.0 && b->t_s < begins_s && begins_s < t_s) {
        move_to(b, begins_s);
    }
    if (b->t_s < t_s) {
        move_to(b, t_s);
    }
}

/* ---- noise: splitmix64 and Box-Muller, the same on every machine ---- */

static uint64_t next_random(bench *b)
{
    b->random_state += 0x9E3779B97F4A7C15ull;
    uint64_t x = b->random_state;
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9ull;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBull;
    return x ^ (x >> 31);
}

static double uniform(bench *b)
{
    return ((double)(next_random(b) >> 11) + 0.5) * 0x1p-53; /* inside (0, 1) */
}

static double gauss(bench *b)
{
    if (b->has_spare) {
        b->has_spare = false;
        return b->spare_gauss;
    }
    const double radius = sqrt(-2.0 * log(uniform(b)));
    const double angle = 6.283185307179586477 * uniform(b);
    b->spare_gauss = radius * sin(angle);
    b->has_spare = true;
    return radius * cos(angle);
}

/* ---- what the board sees ---- */

static const double NOISY_COUNTS = 25.0;

static int32_t quantise(double counts, int32_t counts_max)
{
    const double rounded = floor(counts + 0.5);
    return rounded < 0.0 ? 0 : rounded > (double)counts_max ? counts_max : (int32_t)rounded;
}

/* The position that an ideal sensor shows. */
static double shown_rad(bench *b)
{
    const bench_params *p = &b->p;
    if (p->parts == 0) {
        return b->y_rad;
    }
    real_put(&p->real, &b->real, b->v_rad_per_s, b->y_rad);
    return real_reading(&p->real, b->real.x);
}

int32_t bench_position_counts(bench *b)
{
    const bench_params *p = &b->p;
    const int32_t wiring = bench_is_faulty(b) ? p->sensor_wiring : BENCH_SENSOR_OK;
    if (wiring == BENCH_SENSOR_BROKEN_LOW) {
        return 0;
    }
    if (wiring == BENCH_SENSOR_BROKEN_HIGH) {
        return p->counts_max;
    }
    if (wiring == BENCH_SENSOR_STUCK && b->stuck_counts >= 0) {
        return b->stuck_counts;
    }
    const double added_rad = wiring == BENCH_SENSOR_NOISY ? NOISY_COUNTS * fabs(p->rad_per_count) : 0.0;
    const double deviation_rad = p->noise_rad + added_rad;
    const double noise_rad = deviation_rad > 0.0 ? deviation_rad * gauss(b) : 0.0;
    const double from_centre = (shown_rad(b) + p->offset_rad + noise_rad) / p->rad_per_count;
    const double sign = wiring == BENCH_SENSOR_REVERSED ? -1.0 : 1.0;
    int32_t counts = quantise(p->centre_counts + sign * from_centre, p->counts_max);
    if (wiring == BENCH_SENSOR_JUMPED) {
        counts = (counts + (p->counts_max + 1) / 4) % (p->counts_max + 1);
    }
    b->stuck_counts = wiring == BENCH_SENSOR_STUCK ? counts : -1;
    return counts;
}

int64_t bench_encoder_steps(bench *b, double *to_next)
{
    const bench_params *p = &b->p;
    const bool is_reversed = bench_is_faulty(b) && p->sensor_wiring == BENCH_SENSOR_REVERSED;
    const double scale = is_reversed ? -p->rad_per_count : p->rad_per_count;
    const double at = p->centre_counts + (shown_rad(b) + p->offset_rad) / scale + 0.5;
    const double below = floor(at);
    *to_next = b->v_rad_per_s / scale > 0.0 ? below + 1.0 - at : at - below;
    return (int64_t)below;
}

unsigned bench_encoder_levels(bench *b, int64_t steps)
{
    const int32_t wiring = bench_is_faulty(b) ? b->p.sensor_wiring : BENCH_SENSOR_OK;
    const unsigned phase = (unsigned)((steps + (wiring == BENCH_SENSOR_JUMPED ? 2 : 0)) & 3);
    const unsigned levels = (phase == 1u || phase == 2u ? 1u : 0u) | (phase >= 2u ? 2u : 0u);
    const unsigned still = wiring == BENCH_SENSOR_STUCK     ? 3u
                           : wiring == BENCH_SENSOR_STILL   ? 2u
                           : wiring == BENCH_SENSOR_STILL_A ? 1u
                                                            : 0u;
    if (still == 0u) {
        b->held_levels = -1;
        return levels;
    }
    if (b->held_levels < 0) {
        b->held_levels = (int32_t)levels;
    }
    return (levels & ~still) | ((unsigned)b->held_levels & still);
}

bool bench_estop_is_open(const bench *b)
{
    return b->t_s < b->p.estop_open_s;
}

bool bench_end_is_open(const bench *b, bool at_rising_counts)
{
    const bench_params *p = &b->p;
    if (p->end_low_rad == 0.0 && p->end_high_rad == 0.0) {
        return false;
    }
    return at_rising_counts == (p->rad_per_count > 0.0) ? b->y_rad > p->end_high_rad : b->y_rad < p->end_low_rad;
}

int32_t bench_tachometer_counts(const bench *b)
{
    const bench_params *p = &b->p;
    if (p->tachometer_rad_s_per_count == 0.0) {
        return -1;
    }
    const double motor_rad_s = b->v_rad_per_s * p->gear_ratio;
    return quantise(p->tachometer_zero_counts + motor_rad_s / p->tachometer_rad_s_per_count, p->counts_max);
}

double bench_pin_V(const bench *b)
{
    return (double)b->pin_units / (double)b->p.drive_counts * b->p.supply_V;
}

/* What the bridge gives for the drive at the pin. */
static double bridge_V(const bench *b)
{
    const bench_params *p = &b->p;
    const double dead = b->pin_units > 0 ? p->dead_band_plus : p->dead_band_minus;
    const double passed = (fabs((double)b->pin_units) / (double)p->drive_counts - dead) / (1.0 - dead);
    if (b->pin_units == 0 || passed <= 0.0) {
        return 0.0;
    }
    const double volts = passed * (p->supply_V - p->bridge_drop_V);
    return (b->pin_units > 0) == (p->reversed == 0) ? volts : -volts;
}

double bench_motor_V(const bench *b)
{
    switch (bench_is_faulty(b) ? b->p.drive_wiring : BENCH_DRIVE_OK) {
    case BENCH_DRIVE_REVERSED:
        return -bridge_V(b);
    case BENCH_DRIVE_DEAD:
        return 0.0;
    case BENCH_DRIVE_STUCK_ON:
        return 0.25 * b->p.supply_V;
    default:
        return bridge_V(b);
    }
}

/* ---- what is done to the bench ---- */

void bench_real(const bench_params *p, real_motor *m, real_state *at)
{
    const double share = viscous_share(p);
    const double above_V = p->fs_plus_V - p->fc_plus_V;
    const bool falls = p->stribeck_rad_s > 0.0 && above_V > 0.0;
    *m = p->real;
    m->tau_s = p->tau_s / share;
    m->K_rad_s_V = p->K_rad_s_V / share;
    m->fc_V = 0.5 * (p->fc_plus_V + p->fc_minus_V);
    m->bias_V = p->bias_V - 0.5 * (p->fc_plus_V - p->fc_minus_V);
    m->static_V = falls ? 0.0 : above_V;
    m->stribeck_V = falls ? above_V : 0.0;
    m->stribeck_rad_s = falls ? p->stribeck_rad_s : 0.0;
    real_start(m, at, p->start_rad);
}

void bench_init(bench *b, const bench_params *p)
{
    memset(b, 0, sizeof *b);
    b->p = *p;
    bench_real(p, &b->p.real, &b->real);
    b->y_rad = p->start_rad;
    b->armed_t_s = -1.0;
    b->stuck_counts = -1;
    b->held_levels = -1;
    b->random_state = p->seed;
}

void bench_set_drive(bench *b, int32_t units)
{
    b->pin_units = units;
}

void bench_arm(bench *b)
{
    if (b->armed_t_s < 0.0) {
        b->armed_t_s = b->t_s;
    }
}

/* ---- parameters ---- */

void bench_defaults(bench_params *p)
{
    memset(p, 0, sizeof *p);
    p->tau_s = 0.17;
    p->K_rad_s_V = 6.5;
    p->stop_low_rad = -2.6;
    p->stop_high_rad = 2.6;
    p->rad_per_count = 4.2 / 1024.0;
    p->centre_counts = 512.0;
    p->supply_V = 12.0;
    p->gear_ratio = 1.0;
    p->counts_max = 1023;
    p->drive_counts = 799;
    p->seed = 1;
    p->real.half_travel_rad = 1.0;
    p->real.duration_s = 60.0;
}

/* Of the motor's numbers those of its parts: the others are the bench's own. */
#define OPTION_MOTOR(name)
#define OPTION_PART(name) {#name, REAL, offsetof(bench_params, real.name)},
#define OPTION(name, of, is_linear, least, below) OPTION_##of(name)
#define IN_RANGE_MOTOR(name, least, below)
#define IN_RANGE_PART(name, least, below) \
    if (!(p->real.name >= (least) && p->real.name < (below))) { \
        return #name " must be at least " #least " and below " #below; \
    }
#define IN_RANGE(name, of, is_linear, least, below) IN_RANGE_##of(name, least, below)

enum kind { REAL, INTEGER, UNSIGNED, DRIVE_WIRING, SENSOR_WIRING };

static const struct {
    const char *name;
    enum kind kind;
    size_t at;
} OPTIONS[] = {
    {"tau-s", REAL, offsetof(bench_params, tau_s)},
    {"K-rad-s-V", REAL, offsetof(bench_params, K_rad_s_V)},
    {"fc-plus-V", REAL, offsetof(bench_params, fc_plus_V)},
    {"fc-minus-V", REAL, offsetof(bench_params, fc_minus_V)},
    {"fs-plus-V", REAL, offsetof(bench_params, fs_plus_V)},
    {"fs-minus-V", REAL, offsetof(bench_params, fs_minus_V)},
    {"stribeck-rad-s", REAL, offsetof(bench_params, stribeck_rad_s)},
    {"viscous-V-s-rad", REAL, offsetof(bench_params, viscous_V_s_rad)},
    {"bias-V", REAL, offsetof(bench_params, bias_V)},
    {"start-rad", REAL, offsetof(bench_params, start_rad)},
    {"stop-low-rad", REAL, offsetof(bench_params, stop_low_rad)},
    {"stop-high-rad", REAL, offsetof(bench_params, stop_high_rad)},
    {"rad-per-count", REAL, offsetof(bench_params, rad_per_count)},
    {"centre-counts", REAL, offsetof(bench_params, centre_counts)},
    {"counts-max", INTEGER, offsetof(bench_params, counts_max)},
    {"encoder", INTEGER, offsetof(bench_params, encoder)},
    {"end-low-rad", REAL, offsetof(bench_params, end_low_rad)},
    {"end-high-rad", REAL, offsetof(bench_params, end_high_rad)},
    {"estop-open-s", REAL, offsetof(bench_params, estop_open_s)},
    {"noise-rad", REAL, offsetof(bench_params, noise_rad)},
    {"offset-rad", REAL, offsetof(bench_params, offset_rad)},
    {"supply-V", REAL, offsetof(bench_params, supply_V)},
    {"drive-counts", INTEGER, offsetof(bench_params, drive_counts)},
    {"bridge-drop-V", REAL, offsetof(bench_params, bridge_drop_V)},
    {"dead-band-plus", REAL, offsetof(bench_params, dead_band_plus)},
    {"dead-band-minus", REAL, offsetof(bench_params, dead_band_minus)},
    {"coasting", INTEGER, offsetof(bench_params, coasting)},
    {"reversed", INTEGER, offsetof(bench_params, reversed)},
    {"tachometer-rad-s-per-count", REAL, offsetof(bench_params, tachometer_rad_s_per_count)},
    {"tachometer-zero-counts", REAL, offsetof(bench_params, tachometer_zero_counts)},
    {"gear-ratio", REAL, offsetof(bench_params, gear_ratio)},
    {"clock-error-ppm", REAL, offsetof(bench_params, clock_error_ppm)},
    {"clock-start-us", UNSIGNED, offsetof(bench_params, clock_start_us)},
    {"seed", UNSIGNED, offsetof(bench_params, seed)},
    {"drive", DRIVE_WIRING, offsetof(bench_params, drive_wiring)},
    {"sensor", SENSOR_WIRING, offsetof(bench_params, sensor_wiring)},
    {"fault-after-s", REAL, offsetof(bench_params, fault_after_s)},
    {"parts", INTEGER, offsetof(bench_params, parts)},
    REAL_MOTOR_NUMBERS(OPTION)
    {"centre-rad", REAL, offsetof(bench_params, real.centre_rad)},
    {"half-travel-rad", REAL, offsetof(bench_params, real.half_travel_rad)},
    {"drift-over-s", REAL, offsetof(bench_params, real.duration_s)},
};

enum { OPTION_COUNT = sizeof OPTIONS / sizeof OPTIONS[0] };

static const char *const DRIVE_NAMES[] = {"ok", "reversed", "dead", "stuck_on", NULL};
static const char *const SENSOR_NAMES[] = {"ok", "reversed", "broken_low", "broken_high", "stuck", "jumped", "noisy", "still", "still_a", NULL};

static const char *set_name(int32_t *field, const char *const *names, const char *value)
{
    for (int32_t i = 0; names[i] != NULL; i++) {
        if (strcmp(names[i], value) == 0) {
            *field = i;
            return NULL;
        }
    }
    return "no such wiring";
}

static const char *set_real(double *field, const char *value)
{
    char *end;
    const double number = strtod(value, &end);
    if (end == value || *end != '\0' || !isfinite(number)) {
        return "not a finite number";
    }
    *field = number;
    return NULL;
}

static const char *set_integer(void *field, enum kind kind, const char *value)
{
    char *end;
    errno = 0;
    const long long number = strtoll(value, &end, 10);
    const long long most = kind == UNSIGNED ? (long long)UINT32_MAX : 65535;
    if (end == value || *end != '\0' || errno != 0 || number < 0 || number > most) {
        return "not a whole number in range";
    }
    if (kind == UNSIGNED) {
        *(uint32_t *)field = (uint32_t)number;
    } else {
        *(int32_t *)field = (int32_t)number;
    }
    return NULL;
}

const char *bench_option(bench_params *p, const char *name, const char *value)
{
    for (unsigned i = 0; i < OPTION_COUNT; i++) {
        if (strcmp(OPTIONS[i].name, name) != 0) {
            continue;
        }
        void *field = (char *)p + OPTIONS[i].at;
        switch (OPTIONS[i].kind) {
        case REAL:
            return set_real(field, value);
        case DRIVE_WIRING:
            return set_name(field, DRIVE_NAMES, value);
        case SENSOR_WIRING:
            return set_name(field, SENSOR_NAMES, value);
        default:
            return set_integer(field, OPTIONS[i].kind, value);
        }
    }
    return "no such option";
}

const char *bench_rewire(bench *b, const char *drive, const char *sensor)
{
    bench_params wanted = b->p;
    const char *wrong = bench_option(&wanted, "drive", drive);
    if (wrong == NULL) {
        wrong = bench_option(&wanted, "sensor", sensor);
    }
    if (wrong == NULL) {
        wanted.fault_after_s = 0.0;
        b->p = wanted;
        bench_arm(b);
    }
    return wrong;
}

const char *bench_check(const bench_params *p)
{
    if (!(p->tau_s > 0.0 && p->K_rad_s_V > 0.0)) {
        return "tau-s and K-rad-s-V must be > 0";
    }
    if (!(p->fc_plus_V >= 0.0 && p->fc_minus_V >= 0.0)) {
        return "friction levels must be >= 0";
    }
    if (!(p->fs_plus_V >= p->fc_plus_V && p->fs_minus_V >= p->fc_minus_V)) {
        return "static friction must be at least the moving friction";
    }
    if (!(p->stribeck_rad_s >= 0.0 && p->viscous_V_s_rad >= 0.0)) {
        return "stribeck-rad-s and viscous-V-s-rad must be >= 0";
    }
    if (!(p->stop_low_rad < p->stop_high_rad && p->stop_low_rad <= p->start_rad && p->start_rad <= p->stop_high_rad)) {
        return "start-rad must lie between stop-low-rad and stop-high-rad";
    }
    if (p->rad_per_count == 0.0 || !(p->noise_rad >= 0.0) || p->counts_max < 1) {
        return "rad-per-count must not be 0, noise-rad >= 0, counts-max >= 1";
    }
    if (!(p->supply_V > 0.0) || p->drive_counts < 1 || p->drive_counts > 32767) {
        return "supply-V must be > 0, drive-counts 1 to 32767";
    }
    if (!(p->bridge_drop_V >= 0.0 && p->bridge_drop_V < p->supply_V) || p->reversed > 1) {
        return "bridge-drop-V must be >= 0 and below supply-V, reversed 0 or 1";
    }
    if (p->coasting > 1 || (p->coasting == 1 && p->parts != 0)) {
        return "coasting must be 0 or 1, and 0 where the motor has parts";
    }
    if (!(p->dead_band_plus >= 0.0 && p->dead_band_plus < 1.0 && p->dead_band_minus >= 0.0 && p->dead_band_minus < 1.0)) {
        return "dead bands are duties in [0, 1)";
    }
    if (p->encoder > 1 || p->end_low_rad > p->end_high_rad) {
        return "encoder must be 0 or 1, end-low-rad at most end-high-rad";
    }
    if (!(p->gear_ratio > 0.0) || !(p->fault_after_s >= 0.0)) {
        return "gear-ratio must be > 0, fault-after-s >= 0";
    }
    if (p->parts > 1 || !(p->real.half_travel_rad > 0.0 && p->real.duration_s > 0.0)) {
        return "parts must be 0 or 1, half-travel-rad and drift-over-s > 0";
    }
    REAL_MOTOR_NUMBERS(IN_RANGE)
    if (!(fabs(p->clock_error_ppm) <= 50000.0)) {
        return "clock-error-ppm must be within 50000";
    }
    return NULL;
}
