/* A bare board looks at its own outputs, through three wires between pins: wiring.h. The core says when.
 *
 * The pins' interrupt counts the rising edges at both wires' ends and notes the time of the last, while the loop-back
 * lasts. A share is counted by looking again and again.
 */
#ifndef RIG_PICO_LOOPBACK_H
#define RIG_PICO_LOOPBACK_H

#include "rig_core.h"

extern const rig_loopback_board LOOPBACK;

/* An edge of either end, from the pins' interrupt. */
void loopback_take_edge(void);

#endif
