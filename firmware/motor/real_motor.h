/* A motor with its parts: its motion from one event to the next (docs/theory.md 12.1, 12.2 and 12.3).
 *
 *     tau dv/dt + v = K (w + bias - G(y) - F - beta |v| - c v |v|),    dy/dt = v,    reading = S(x)
 *
 * w is the drive behind its stage, G a force over the position, F the friction, x the position behind the backlash, and
 * S the sensor's linearity. A part whose numbers are 0 is not there. With load friction, a supply that has a resistance or
 * a bridge that does not brake the torque takes the place of w:
 *
 *     p + (1 - r) v/K,    p = (w - (1 - r) v/K) / (1 + rho w^2),    F larger by L |p + l G|
 *
 * where the share r of 1/K is viscous friction, and the rest is back-EMF. A bridge passes (1 - f) p where w is
 * 0, and (1 - b) p where p w <= 0, but beside a lag. One that lets the motor run free between its pulses connects it for
 * |w|/U of the time: the back-EMF in p is (1 - c (1 - |w|/U)) (1 - r) v/K.
 *
 * Between two events an exponential Runge-Kutta method of fourth order (Cox and Matthews, J. Comput. Phys. 176, 2002)
 * takes v and p = y + tau v. Where the right side is linear in v and time, as it is without parts, one stage is exact. An
 * event is an edge of the drive, a reversal, a shaft that breaks away from rest, or a torque that turns where a law sees it.
 */
#ifndef RIG_REAL_MOTOR_H
#define RIG_REAL_MOTOR_H

/* The numbers, in the order of every vector and Jacobian of them: name, whether it is of a PART or of every MOTOR, whether
 * the motion between two events stays linear, the least that it may be, and what it has to be below.
 * rig/core/motor_numbers.py says what each is; tools/motor_numbers.py makes this list of it. */
#define REAL_MOTOR_NUMBERS(NUMBER) \
    NUMBER(tau_s, MOTOR, 1, 0.0, INFINITY) \
    NUMBER(K_rad_s_V, MOTOR, 1, 0.0, INFINITY) \
    NUMBER(fc_V, MOTOR, 1, 0.0, INFINITY) \
    NUMBER(bias_V, MOTOR, 1, -INFINITY, INFINITY) \
    NUMBER(delay_s, MOTOR, 1, -INFINITY, INFINITY) \
    NUMBER(dead_band_V, PART, 1, 0.0, INFINITY) \
    NUMBER(gain_by_sign, PART, 1, -1.0, 1.0) \
    NUMBER(sag_per_V, PART, 1, 0.0, INFINITY) \
    NUMBER(lag_s, PART, 0, 0.0, INFINITY) \
    NUMBER(viscous_by_direction_V_s_rad, PART, 1, -INFINITY, INFINITY) \
    NUMBER(static_V, MOTOR, 1, 0.0, INFINITY) \
    NUMBER(stribeck_V, MOTOR, 0, 0.0, INFINITY) \
    NUMBER(stribeck_rad_s, MOTOR, 0, 0.0, INFINITY) \
    NUMBER(drag_V_s2_rad2, PART, 0, 0.0, INFINITY) \
    NUMBER(bristle_V_rad, PART, 0, 0.0, INFINITY) \
    NUMBER(force_sin_V, PART, 0, -INFINITY, INFINITY) \
    NUMBER(force_cos_V, PART, 0, -INFINITY, INFINITY) \
    NUMBER(friction_sin_V, PART, 0, -INFINITY, INFINITY) \
    NUMBER(friction_cos_V, PART, 0, -INFINITY, INFINITY) \
    NUMBER(cogging_sin_V, PART, 0, -INFINITY, INFINITY) \
    NUMBER(cogging_cos_V, PART, 0, -INFINITY, INFINITY) \
    NUMBER(cogging_per_rad, PART, 0, 0.0, INFINITY) \
    NUMBER(backlash_rad, PART, 1, 0.0, INFINITY) \
    NUMBER(linearity_sin1_rad, PART, 1, -INFINITY, INFINITY) \
    NUMBER(linearity_cos1_rad, PART, 1, -INFINITY, INFINITY) \
    NUMBER(linearity_sin2_rad, PART, 1, -INFINITY, INFINITY) \
    NUMBER(linearity_cos2_rad, PART, 1, -INFINITY, INFINITY) \
    NUMBER(drift, PART, 1, -INFINITY, INFINITY) \
    NUMBER(load_friction, PART, 1, 0.0, 1.0) \
    NUMBER(load_outside, PART, 1, 0.0, INFINITY) \
    NUMBER(viscous_share, PART, 1, 0.0, 1.0) \
    NUMBER(source_per_V2, PART, 1, 0.0, INFINITY) \
    NUMBER(runs_free, PART, 1, 0.0, 1.2) \
    NUMBER(no_brake, PART, 1, 0.0, 1.2) \
    NUMBER(free_between, PART, 1, 0.0, 1.2) \
    NUMBER(full_drive_V, PART, 1, 0.0, INFINITY)

/* The last four are the frame that parts over position and time refer to: constants of a fit. `delay_s` is for those who
 * know when a drive acts: no function here applies it but the readings of a record. */
#define REAL_MOTOR_FIELD(name, of, is_linear, least, below) double name;
typedef struct {
    REAL_MOTOR_NUMBERS(REAL_MOTOR_FIELD)
    double centre_rad, half_travel_rad, start_s, duration_s;
} real_motor;

/* Places of the numbers. */
#define REAL_MOTOR_PLACE(name, of, is_linear, least, below) AT_##name,
enum { REAL_MOTOR_NUMBERS(REAL_MOTOR_PLACE) REAL_NUMBERS };

/* Velocity and position of the motor's side of the backlash, friction of the bristles, drive behind its stage, and
 * position of the sensor's side. */
typedef struct {
    double v, y, f, w, x;
} real_state;

/* At rest at `y` under 0 V. */
void real_start(const real_motor *m, real_state *at, double y);

/* Sets velocity and position of the motor's side; the sensor's side follows as far as the play makes it. */
void real_put(const real_motor *m, real_state *at, double v, double y);

/* From when[0], s, on, for when[1], s, under the constant drive `u_V`, between the stops, rad. */
void real_advance(const real_motor *m, real_state *at, double u_V, const double when[2], const double stops[2]);

/* Force over position, and the level of the friction in motion at `speed`, at the start, V. */
double real_force(const real_motor *m, double y);
double real_level(const real_motor *m, double speed, double y);
double real_level_at_rest(const real_motor *m, double y); /* that the drive must pass to move the motor from rest */

/* Drive behind dead band, gain by sign and sag, in this order, before the lag. */
double real_staged(const real_motor *m, double u_V);

/* What the sensor shows where its side is at `x`. */
double real_reading(const real_motor *m, double x);

#endif
