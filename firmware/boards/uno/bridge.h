/* The H-bridge: 20 kHz phase-correct PWM from Timer1, sign and magnitude, slow decay.
 *
 * 0 units are a true zero: the timer is off the pins, which stand still. No pulse is longer than its share of a period,
 * the first one neither.
 */
#ifndef RIG_UNO_BRIDGE_H
#define RIG_UNO_BRIDGE_H

#include <stdint.h>

#define BRIDGE_FULL 400u /* units at full duty: 16 MHz / (2 * 400) = 20 kHz */

void bridge_init(void);

/* -BRIDGE_FULL to BRIDGE_FULL, interrupts masked. In force within one PWM period, 0 at once. */
void bridge_drive(int16_t units);

#endif
