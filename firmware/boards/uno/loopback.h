/* A bare board looks at its own outputs, through three wires between pins: wiring.h. The core says when.
 *
 * An interrupt of both wires' ends counts rising edges and notes the time of the last. It takes a fifth of
 * the chip's time, so it is on only while the loop-back lasts. A share is counted by looking again and again, without it.
 */
#ifndef RIG_UNO_LOOPBACK_H
#define RIG_UNO_LOOPBACK_H

#include "rig_core.h"

/* In each tick. */
void loopback_tick(void);

extern const rig_loopback_board LOOPBACK;

#endif
