/* The H-bridge: 20 kHz trailing-edge PWM from slice 0, sign and magnitude, slow decay.
 *
 * 0 units are a true zero: the pins stand still. No pulse is longer than its share of a period, the first one neither.
 */
#ifndef RIG_PICO_BRIDGE_H
#define RIG_PICO_BRIDGE_H

#include <stdint.h>

#define BRIDGE_FULL 6250u /* units at full duty: 125 MHz / 6250 = 20 kHz */

void bridge_init(void);

/* -BRIDGE_FULL to BRIDGE_FULL, interrupts masked. In force within one PWM period, 0 at once. */
void bridge_drive(int16_t units);

#endif
