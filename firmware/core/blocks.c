#include "blocks.h"

#include <stddef.h>

static void begin(block *next, uint16_t number)
{
    next->t_first_us = 0;
    next->session = 0;
    next->first = 0;
    next->number = number;
    next->delay_us = 0;
    next->status = 0;
    next->fault = 0;
    next->n = 0;
}

static uint8_t behind(uint8_t at)
{
    return at < BLOCKS_WAITING ? (uint8_t)(at + 1u) : 0u;
}

void blocks_init(blocks *b, uint8_t rows, uint16_t period_us)
{
    b->in = 0;
    b->out = 0;
    b->rows = rows;
    b->period_us = period_us;
    begin(&b->ring[0], 0);
}

block *blocks_filling(blocks *b)
{
    return &b->ring[b->in];
}

/* Modulo 2^32, which the wire's 16 bits must hold. */
static bool is_far(int32_t counts, int32_t first)
{
    const uint32_t away = (uint32_t)counts - (uint32_t)first;
    return away > 0x7FFFUL && away < 0xFFFF8000UL;
}

bool blocks_breaks_off(const blocks *b, uint32_t t_us, int32_t counts)
{
    const block *now = &b->ring[b->in];
    if (now->n == 0u) {
        return false;
    }
    const uint32_t due_us = now->t_first_us + (uint32_t)now->n * b->period_us;
    const uint32_t off_us = t_us - due_us; /* modulo 2^32: early is a very large number */
    return (off_us > BLOCK_JITTER_US && off_us < (uint32_t)0u - BLOCK_JITTER_US) || is_far(counts, now->first);
}

bool blocks_add(blocks *b, uint32_t t_us, int32_t counts, int16_t drive)
{
    block *now = &b->ring[b->in];
    if (now->n == 0u) {
        now->t_first_us = t_us;
        now->first = counts;
    }
    now->from_first[now->n] = (int16_t)(counts - now->first);
    now->drive[now->n] = drive;
    now->n++;
    return now->n >= b->rows;
}

void blocks_close(blocks *b)
{
    const uint16_t number = (uint16_t)(b->ring[b->in].number + 1u);
    const uint8_t next = behind(b->in);
    if (next != b->out) {
        b->in = next;
    } /* else nobody has sent the others: this one is lost */
    begin(&b->ring[b->in], number);
}

const block *blocks_waiting(const blocks *b)
{
    return b->out != b->in ? &b->ring[b->out] : NULL;
}

void blocks_sent(blocks *b)
{
    b->out = behind(b->out);
}
