#include "timer1.h"

#include <math.h>
#include <stddef.h>

#define NORMAL 0u
#define PWM_TO_ICR1 8u /* WGM13 alone */
#define NO_PRESCALER 1u
#define LARGEST 0xFFFFu
#define ALIKE 3u /* periods after a write, from which on all are the same */

enum { NOTHING, TOGGLE, CLEAR, SET }; /* COM1x; in PWM: CLEAR upwards and SET downwards, or SET upwards and CLEAR downwards */

void timer1_reset(timer1 *t, uint64_t cycle)
{
    void (*const changed)(void *) = t->changed;
    void (*const skips)(void *, uint64_t) = t->skips;
    void *const context = t->context;
    *t = (timer1){.changed = changed, .skips = skips, .context = context, .at = cycle};
}

static bool runs(const timer1 *t)
{
    return t->clock == NO_PRESCALER && (t->mode == NORMAL || t->top > 0u);
}

static void match(timer1 *t, unsigned output)
{
    bool level = t->level[output];
    const uint8_t action = t->output[output];
    if (action == NOTHING) {
        return;
    }
    if (t->mode == NORMAL) {
        level = action == TOGGLE ? !level : action == SET;
    } else if (action != TOGGLE) {
        level = (action == SET) != t->down;
    }
    if (level != t->level[output]) {
        t->level[output] = level;
        t->changed(t->context);
    }
}

/* Where a count is reached at which something happens. */
static uint16_t next_count(const timer1 *t)
{
    uint16_t next = t->mode == NORMAL ? LARGEST : t->down ? 0u : t->top;
    for (unsigned i = 0; i < 2u; i++) {
        const uint16_t compare = t->compare[i];
        if (t->down ? compare < t->count && compare > next : compare > t->count && compare < next) {
            next = compare;
        }
    }
    return next;
}

uint64_t timer1_next(const timer1 *t)
{
    if (!runs(t)) {
        return UINT64_MAX;
    }
    const uint16_t next = next_count(t);
    const uint64_t far = t->down ? (uint64_t)(t->count - next) : (uint64_t)(next - t->count);
    return t->at + (far > 0u ? far : 1u);
}

static void reach(timer1 *t, uint16_t count)
{
    t->count = count;
    if (t->mode != NORMAL && count == 0u) {
        t->down = false;
        t->compare[0] = t->buffer[0];
        t->compare[1] = t->buffer[1];
    } else if (t->mode != NORMAL && count == t->top) {
        t->down = true;
        t->periods = (uint8_t)(t->periods < ALIKE ? t->periods + 1u : ALIKE);
    }
    for (unsigned i = 0; i < 2u; i++) {
        if (t->compare[i] == count) {
            match(t, i);
        }
    }
}

void timer1_advance(timer1 *t, uint64_t cycle)
{
    while (t->at < cycle && runs(t)) {
        const bool wraps = t->mode == NORMAL && t->count == LARGEST;
        const uint16_t next = wraps ? 0u : next_count(t);
        const uint64_t far = wraps ? 1u : t->down ? (uint64_t)(t->count - next) : (uint64_t)(next - t->count);
        if (t->at + far > cycle) {
            const uint16_t moved = (uint16_t)(cycle - t->at);
            t->count = (uint16_t)(t->down ? t->count - moved : t->count + moved);
            break;
        }
        t->at += far;
        reach(t, next);
        if (t->periods == ALIKE && t->down && t->count == t->top) {
            const uint64_t period = 2u * (uint64_t)t->top;
            const uint64_t skipped = (cycle - t->at) / period * period;
            t->at += skipped;
            t->skips(t->context, skipped);
        }
    }
    t->at = t->at < cycle ? cycle : t->at;
}

static void write_compare(timer1 *t, unsigned output, uint16_t value)
{
    if (t->mode == NORMAL) {
        t->compare[output] = value;
    } else {
        t->buffer[output] = value;
    }
}

static const char *write_pair(timer1 *t, uint16_t address, uint16_t value)
{
    if (address == OCR1AL) {
        write_compare(t, 0, value);
    } else if (address == OCR1BL) {
        write_compare(t, 1, value);
    } else if (address == TCNT1L) {
        if (t->mode != NORMAL) {
            return "TCNT1 written in a PWM mode, section 16.7.3";
        }
        t->count = value;
    } else if (t->mode != PWM_TO_ICR1) {
        return "ICR1 written in a mode that does not have it as TOP, section 16.6";
    } else if (runs(t)) {
        return "ICR1, which is not buffered, written while the counter runs, section 16.9.5";
    } else {
        t->top = value;
    }
    return NULL;
}

static const char *write_mode(timer1 *t, unsigned mode, unsigned clock)
{
    t->mode = (uint8_t)mode;
    t->clock = (uint8_t)clock;
    t->down = t->mode != NORMAL && t->down;
    if ((t->mode != NORMAL && t->mode != PWM_TO_ICR1) || t->clock > NO_PRESCALER) {
        return "Timer1 in a mode, or with a prescaler, that this emulator does not have";
    }
    return NULL;
}

const char *timer1_write(timer1 *t, uint64_t cycle, uint16_t address, uint8_t value)
{
    timer1_advance(t, cycle);
    t->periods = 0;
    switch (address) {
    case TCCR1A:
        t->output[0] = value >> 6;
        t->output[1] = (value >> 4) & 3u;
        t->changed(t->context);
        return write_mode(t, (t->mode & 0xCu) | (value & 3u), t->clock);
    case TCCR1B:
        return write_mode(t, ((value >> 1) & 0xCu) | (t->mode & 3u), value & 7u);
    case TCNT1H:
    case ICR1H:
    case OCR1AH:
    case OCR1BH:
        t->temporary = value;
        t->temporary_of = (uint8_t)address;
        return NULL;
    default: {
        const bool in_order = t->temporary_of == address + 1u;
        const char *broken = write_pair(t, address, (uint16_t)(value | (t->temporary << 8)));
        t->temporary_of = 0;
        return in_order ? broken : "low byte of a 16-bit register written before its high byte, section 16.3";
    }
    }
}

bool timer1_has_pin(const timer1 *t, unsigned output)
{
    return t->output[output] != NOTHING;
}

bool timer1_stands(const timer1 *t)
{
    return t->mode != NORMAL && !runs(t);
}

double timer1_share(const timer1 *t, unsigned output)
{
    if (t->mode == NORMAL || !runs(t)) {
        return t->level[output] ? 1.0 : 0.0;
    }
    const double high = fmin((double)t->buffer[output] / (double)t->top, 1.0);
    return t->output[output] == SET ? 1.0 - high : high;
}
