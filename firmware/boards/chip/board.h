/* The board as the core sees it: what Uno and Pico have in common. */
#ifndef RIG_CHIP_BOARD_H
#define RIG_CHIP_BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "rig_core.h"

extern const rig_board BOARD;
extern volatile bool in_tick; /* the core asks for the position on the grid of the ticks */

/* Of the board's own main.c. */
uint32_t board_arrived_us(void *context);
void board_set_drive(void *context, int16_t units);

#endif
