/* A tracking controller for an identified motor: an observer that moves as the motor does, and the drive that its law
 * asks for. The motor's numbers are in rig_motor.h, its motion in real_motor.c. No heap, no recursion.
 *
 * Where double has four bytes, as on an AVR, all is computed in them.
 */
#ifndef RIG_CONTROLLER_H
#define RIG_CONTROLLER_H

#include "real_motor.h"

#include <stdbool.h>

enum { RIG_WAITING_MOST = 8 }; /* drives that may be on their way to the motor */

/* Where the shaft is to be, rad, and its first and second derivative. */
typedef struct {
    double y_rad, v_rad_s, a_rad_s2;
} rig_reference;

typedef struct {
    double period_s, k1_1_s, k2_1_s2; /* set by rig_controller_start; the gains may be changed */
    double late_s;                    /* part of the delay that is less than a period */
    int waiting;                      /* whole periods of it */
    long tick;
    double acting_V, last_V;
    double asked_V[RIG_WAITING_MOST]; /* the last drives, by tick */
    real_state at;                    /* when the last reading was taken */
} rig_controller;

/* Drive, V, that gives the acceleration against all forces at this velocity and position. `direction`: in which friction
 * acts against the drive; only its sign counts, and 0 is none. */
double rig_drive_V(double v_rad_s, double y_rad, double acceleration_rad_s2, double direction);

/* Drive, V, of feedback linearisation: the reference's acceleration, with its errors of velocity and position fed back. */
double rig_linearising_drive_V(double v_rad_s, double y_rad, const rig_reference *to, double k1_1_s, double k2_1_s2);

/* Makes ready for the first tick, with a shaft at rest under 0 V and the gains of rig_motor.h. False: the delay is
 * longer than RIG_WAITING_MOST - 1 periods. The observer's gains are for RIG_MOTOR_PERIOD_S. */
bool rig_controller_start(rig_controller *c, double period_s);

/* One tick: from what the sensor shows, rad, the drive, V, to send now. `to`: the reference RIG_MOTOR_AHEAD_S from now. */
double rig_controller_step(rig_controller *c, double reading_rad, const rig_reference *to);

#endif
