/* Rows of a running relay, one a tick, collected into blocks for the wire.
 *
 * A ring with one writer, the tick, and one reader, who sends: the tick fills one block while the others wait to be
 * sent; nothing here waits or encodes. Where there is no room for one more, the block is lost: its number is missing on
 * the wire, which the host takes for a fault. A block that waits is the reader's alone until blocks_sent; the calls
 * themselves must not come between one another (rig_board.hold_tick).
 */
#ifndef RIG_BLOCKS_H
#define RIG_BLOCKS_H

#include <stdbool.h>
#include <stdint.h>

#define BLOCK_ROWS_MAX 10u
#define BLOCKS_WAITING 2u /* at most: one that is full, and the one that ends the relay */
#define BLOCK_JITTER_US 100u /* a row that is farther off the grid of its block begins a new one */

typedef struct {
    uint32_t t_first_us;
    uint32_t session;
    int32_t first; /* counts of the first row */
    uint16_t number; /* counted from 0, modulo 2^16 */
    uint16_t delay_us;
    uint8_t status;
    uint8_t fault;
    uint8_t n;
    int16_t from_first[BLOCK_ROWS_MAX]; /* counts */
    int16_t drive[BLOCK_ROWS_MAX];
} block;

typedef struct {
    block ring[BLOCKS_WAITING + 1u];
    uint8_t in;   /* of the block that is filled */
    uint8_t out;  /* of the oldest that waits; none does where it is `in` */
    uint8_t rows; /* of a full block */
    uint16_t period_us;
} blocks;

/* Begins at number 0 with an empty block. `rows` is 1 to BLOCK_ROWS_MAX. */
void blocks_init(blocks *b, uint8_t rows, uint16_t period_us);

/* The block that rows go into now: where status, fault and delay are noted. */
block *blocks_filling(blocks *b);

/* Whether a row of this time, or so far from the first, would not fit the block: it must be closed first. */
bool blocks_breaks_off(const blocks *b, uint32_t t_us, int32_t counts);

/* Adds a row. Returns whether the block is full: it must be closed then. */
bool blocks_add(blocks *b, uint32_t t_us, int32_t counts, int16_t drive);

/* Hands the block over to be sent, full or not, and begins the next. */
void blocks_close(blocks *b);

/* The oldest block to be sent, or NULL; blocks_sent gives it free. */
const block *blocks_waiting(const blocks *b);
void blocks_sent(blocks *b);

#endif
