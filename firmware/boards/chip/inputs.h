/* E-stop and end switches: contacts to ground that are closed while all is well, so that a broken wire stops. */
#ifndef RIG_CHIP_INPUTS_H
#define RIG_CHIP_INPUTS_H

#include <stdbool.h>
#include <stdint.h>

void inputs_init(void);

/* Whether the e-stop has opened since inputs_take last saw it; no drive may pass meanwhile. */
bool inputs_have_stopped(void);

/* Bits of rig_input now; the e-stop's also if it was open since the last call. */
uint8_t inputs_take(void);

#endif
