/* What the sensor of a motor with parts reads under a recorded drive, and the derivatives (docs/theory.md 12.4). */
#ifndef RIG_REAL_READINGS_H
#define RIG_REAL_READINGS_H

#include <stdint.h>

#include "real_motor.h"

/* edge_s, u_V   edges, non-decreasing, and the drives that act from them on; before the first edge the drive is that
 *               edge's. At least one
 * t_s           of the rows, increasing, at least one
 * first, starts first row of each piece, increasing from 0 on; and four numbers of each: velocity, position, side of the
 *               play, -1 to 1, and how far the bristles are bent, -1 to 1; 0: they balance the drive
 */
typedef struct {
    const double *edge_s, *u_V, *t_s;
    const int64_t *first;
    const double *starts;
    int64_t edges, rows, pieces;
} real_record;

/* Columns behind those of the motor's numbers: velocity and position at the start of the row's own piece; and sine and
 * cosine of waves of the force over position that the motor has not. */
enum { REAL_V0 = REAL_NUMBERS, REAL_Y0, REAL_WAVES };

/* which    number of the motor of each column of the Jacobian, REAL_V0, REAL_Y0, or from REAL_WAVES on a wave
 * orders   of the waves, 1/rad
 * work     room for REAL_WORK(columns, waves) numbers
 */
typedef struct {
    const int64_t *which;
    const double *orders;
    double *work;
    int64_t columns, waves;
} real_columns;

enum { REAL_COLUMN_ROWS = 12, REAL_STAGE_ROWS = 11 };
#define REAL_WORK(columns, waves) (REAL_COLUMN_ROWS * (columns) + REAL_STAGE_ROWS * (REAL_WAVES + 2 * (waves)))

/* Fills the readings (rows) and their Jacobian (rows, columns), which without columns is left out. All are nan for a
 * motor that runs away, or that is so stiff that it takes too many steps. */
void real_readings(const real_motor *m, const real_record *record, const real_columns *columns, double *y_rad, double *jacobian);

/* Velocity that the motor would tend to in the direction `sign` (+1 or -1) if all forces stayed as they are at `t_s`. */
double real_target(const real_motor *m, double sign, const real_state *at, double t_s);

#endif
