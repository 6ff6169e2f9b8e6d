/* A motor with its parts: its motion from one event to the next (docs/theory.md 12.1, 12.2 and 12.3).
 *
 *     tau dv/dt + v = K (w + bias - G(y) - F - beta |v| - c v |v|),    dy/dt = v,    reading = S(x)
 *
 * w is the drive behind its stage, G a force over the position, F the friction, x the position behind the backlash, and
 * S the sensor's linearity. A part whose numbers are 0 is not there. With load friction or a supply that has a resistance
 * the torque takes the place of w:
 *
 *     p + (1 - r) v/K,    p = (w - (1 - r) v/K) / (1 + rho w^2),    F larger by L |p + l G|
 *
 * where the share r of 1/K is viscous friction, and the rest is back-EMF.
 *
 * Between two events an exponential Runge-Kutta method of fourth order (Cox and Matthews, J. Comput. Phys. 176, 2002)
 * takes v and p = y + tau v. It is exact where the right side is constant, as it is for a motor without parts. An event
 * is an edge of the drive, a reversal, a shaft that breaks away from rest, or a torque that load friction sees turn.
 */
#ifndef RIG_REAL_MOTOR_H
#define RIG_REAL_MOTOR_H

/* The numbers, in the order of every vector and Jacobian of them: rig/model/real_numbers.py says what each is. The last four
 * are the frame that parts over position and time refer to: constants of a fit. `delay_s` is for those who know when a
 * drive acts: no function here applies it but the readings of a record. */
typedef struct {
    double tau_s, K_rad_s_V, fc_V, bias_V, delay_s;
    double dead_band_V, gain_by_sign, sag_per_V, lag_s;
    double viscous_by_direction_V_s_rad, static_V, stribeck_V, stribeck_rad_s, drag_V_s2_rad2, bristle_V_rad;
    double force_sin_V, force_cos_V, friction_sin_V, friction_cos_V;
    double cogging_sin_V, cogging_cos_V, cogging_per_rad;
    double backlash_rad;
    double linearity_sin1_rad, linearity_cos1_rad, linearity_sin2_rad, linearity_cos2_rad;
    double drift;
    double load_friction, load_outside, viscous_share, source_per_V2;
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
double real_level_at_rest(const real_motor *m, double y); /* that the drive must pass to move the motor from rest */

/* Drive behind dead band, gain by sign and sag, in this order, before the lag. */
double real_staged(const real_motor *m, double u_V);

/* What the sensor shows where its side is at `x`. */
double real_reading(const real_motor *m, double x);

#endif
