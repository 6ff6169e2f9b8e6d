/* Rows of a running relay, one a tick, collected into blocks for the wire.
 *
 * The tick fills one block while the other waits to be sent; nothing here waits or encodes. Where a block is not sent
 * before the next is full, the next one is lost: its number is missing on the wire, which the host takes for a fault.
 * The tick may interrupt the sender: `waiting` alone passes between them.
 */
#ifndef RIG_BLOCKS_H
#define RIG_BLOCKS_H

#include <stdbool.h>
#include <stdint.h>

#define BLOCK_ROWS_MAX 10u
#define BLOCK_JITTER_US 100u /* a row that is farther off the grid of its block begins a new one */

typedef struct {
    uint32_t t_first_us;
    uint16_t number; /* counted from 0, modulo 2^16 */
    uint16_t delay_us;
    uint8_t status;
    uint8_t fault;
    uint8_t n;
    uint16_t counts[BLOCK_ROWS_MAX];
    int16_t drive[BLOCK_ROWS_MAX];
} block;

typedef struct {
    block pair[2];
    uint8_t filling;       /* the other one waits, or is free */
    volatile bool waiting;
    uint8_t rows;          /* of a full block */
    uint16_t period_us;
} blocks;

/* Begins at number 0 with an empty block. `rows` is 1 to BLOCK_ROWS_MAX. */
void blocks_init(blocks *b, uint8_t rows, uint16_t period_us);

/* The block that rows go into now: where status, fault and delay are noted. */
block *blocks_filling(blocks *b);

/* Whether a row of this time would not fit the block: it must be closed first. */
bool blocks_breaks_grid(const blocks *b, uint32_t t_us);

/* Adds a row. Returns whether the block is full: it must be closed then. */
bool blocks_add(blocks *b, uint32_t t_us, uint16_t counts, int16_t drive);

/* Hands the block over to be sent, full or not, and begins the next. */
void blocks_close(blocks *b);

/* The block to be sent, or NULL; blocks_sent gives it free. */
const block *blocks_waiting(const blocks *b);
void blocks_sent(blocks *b);

#endif
