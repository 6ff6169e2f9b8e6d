/* A motor with real parts, in C doubles: what rig/model/real_step.py is in Python, function by function; tests/emulate
 * holds the two together. docs/theory.md 12.1 has the equations.
 */
#ifndef RIG_REAL_MOTOR_H
#define RIG_REAL_MOTOR_H

/* The numbers of RealMotor and of Frame, by their names there. */
typedef struct {
    double tau_s, K_rad_s_V, fc_V, bias_V;
    double dead_band_V, gain_by_sign, sag_per_V, lag_s;
    double viscous_by_direction_V_s_rad, static_V, stribeck_V, stribeck_rad_s, drag_V_s2_rad2, bristle_V_rad;
    double force_sin_V, force_cos_V, friction_sin_V, friction_cos_V;
    double cogging_sin_V, cogging_cos_V, cogging_per_rad;
    double backlash_rad;
    double linearity_sin1_rad, linearity_cos1_rad, linearity_sin2_rad, linearity_cos2_rad;
    double drift;
    double centre_rad, half_travel_rad, start_s, duration_s;
} real_motor;

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

/* What the sensor shows where its side is at `x`. */
double real_reading(const real_motor *m, double x);

#endif
