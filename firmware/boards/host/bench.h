/* The physical bench around the board, in C doubles: motor, mechanical stops, potentiometer, tachometer, drive
 * stage, and the faults it can be wired with. The same bench stands in Python in rig/model/bench.py;
 * tests/backends/serial holds the two together.
 *
 *     tau dv/dt + v = K (u + b - f(v)),   dy/dt = v
 *
 * has a closed form between the instants at which the drive changes, the velocity crosses zero or the shaft meets
 * a stop, so there is no integration step and no integration error; under Stribeck friction it is a chain of Taylor
 * polynomials. The motor's own motion is in motor/plain_motor.c and motor/real_motor.c.
 */
#ifndef RIG_BENCH_H
#define RIG_BENCH_H

#include <stdbool.h>
#include <stdint.h>

#include "real_motor.h"

enum bench_drive_wiring { BENCH_DRIVE_OK, BENCH_DRIVE_REVERSED, BENCH_DRIVE_DEAD, BENCH_DRIVE_STUCK_ON };

enum bench_sensor_wiring {
    BENCH_SENSOR_OK,
    BENCH_SENSOR_REVERSED,
    BENCH_SENSOR_BROKEN_LOW,
    BENCH_SENSOR_BROKEN_HIGH,
    BENCH_SENSOR_STUCK,
    BENCH_SENSOR_JUMPED, /* across its dead zone: a quarter of the range farther, round and round; an encoder: two edges */
    BENCH_SENSOR_NOISY,  /* 25 counts */
    BENCH_SENSOR_STILL,  /* channel B of an encoder stands still */
    BENCH_SENSOR_STILL_A /* channel A does */
};

typedef struct {
    double tau_s, K_rad_s_V;
    double fc_plus_V, fc_minus_V; /* friction while moving towards +y and -y, >= 0 */
    double fs_plus_V, fs_minus_V; /* level to break away, >= the moving level */
    double stribeck_rad_s;        /* speed over which static friction falls to moving friction; 0: at rest only */
    double viscous_V_s_rad;       /* >= 0 */
    double bias_V;
    double start_rad, stop_low_rad, stop_high_rad;
    double rad_per_count, centre_counts, noise_rad, offset_rad; /* potentiometer; negative: readings fall */
    double supply_V, bridge_drop_V;         /* the drop: lost while it drives */
    double dead_band_plus, dead_band_minus; /* duty up to which the bridge passes nothing, by sign of the units */
    double tachometer_rad_s_per_count, tachometer_zero_counts, gear_ratio; /* 0 rad/s a count: no tachometer */
    double end_low_rad, end_high_rad; /* beyond them an end switch is open; both 0: there are none */
    double estop_open_s;     /* from power on: a hand tries the e-stop; encoder alone */
    double fault_after_s;    /* from the first arming until the wiring's faults begin */
    double clock_error_ppm;  /* of the device's clock */
    int32_t counts_max;      /* largest reading of the ADC, both channels */
    int32_t encoder;         /* 1: the position is an encoder's, without noise and without an end */
    int32_t drive_counts;    /* units at full duty */
    int32_t coasting;        /* 1: the bridge lets the motor run free while PWM is low, as an L298 with PWM on its enable */
    int32_t reversed;        /* 1: positive units turn the shaft to falling positions */
    uint32_t clock_start_us; /* of the device's clock at a reset */
    uint32_t seed;           /* of the noise */
    int32_t drive_wiring, sensor_wiring;
    int32_t parts;           /* 1: the motor has those of `real`, whose tau_s to stribeck_rad_s bench_init fills in */
    real_motor real;
} bench_params;

void bench_defaults(bench_params *p);

/* Sets a parameter from text: `name` as in the struct with '-' for '_', a part's as in real_motor, also "drive" and "sensor" for the wiring.
 * Returns NULL, or what is wrong in words. */
const char *bench_option(bench_params *p, const char *name, const char *value);

/* NULL, or what is wrong with the parameters as a whole. */
const char *bench_check(const bench_params *p);

typedef struct {
    bench_params p;
    double t_s, v_rad_per_s, y_rad;
    real_state real;       /* with parts; v and y are those above */
    double armed_t_s;      /* of the first arming; negative before it */
    int32_t pin_units;     /* drive at the pin, before the wiring */
    int32_t stuck_counts;  /* reading that a stuck sensor holds; negative: none yet */
    int32_t held_levels;   /* of an encoder's channels, since its fault; negative: no fault */
    uint64_t random_state;
    double spare_gauss;    /* second of a pair of normal numbers */
    bool has_spare;
} bench;

/* `p` must have passed bench_check. */
void bench_init(bench *b, const bench_params *p);

/* Moves the bench on to `t_s`; a time that is past changes nothing. */
void bench_advance_to(bench *b, double t_s);

void bench_set_drive(bench *b, int32_t units);
void bench_arm(bench *b); /* starts the clock of fault_after_s, the first time only */
bool bench_is_faulty(const bench *b);

/* Wires drive and sensor otherwise from now on, by the names of bench_option. NULL, or what is wrong: no change. */
const char *bench_rewire(bench *b, const char *drive, const char *sensor);

double bench_pin_V(const bench *b);   /* what the board puts out: duty times supply */
double bench_motor_V(const bench *b); /* what arrives at the motor */
int32_t bench_position_counts(bench *b);

/* Quarters of an encoder's period since its zero, and where the next is: how far, in quarters, to the edge in the
 * direction of motion. */
int64_t bench_encoder_steps(bench *b, double *to_next);
/* Levels of its channels there, with the wiring's faults: 1 for A, 2 for B. Forward is A before B. */
unsigned bench_encoder_levels(bench *b, int64_t steps);

/* Contacts that are open now. */
bool bench_estop_is_open(const bench *b);
bool bench_end_is_open(const bench *b, bool at_rising_counts);

int32_t bench_tachometer_counts(const bench *b); /* negative: there is none */

/* The motor with its parts, at rest at the start, for those who move it themselves. */
void bench_real(const bench_params *p, real_motor *m, real_state *at);

/* One motion under constant voltage at the motor, stops included: what bench_advance_to is made of, without parts. */
void bench_motion(const bench_params *p, double *v, double *y, double u_V, double dt_s);

#endif
