#include "strokes.h"

static bool is_time(uint16_t ticks)
{
    return ticks >= 1u && ticks <= STROKES_TICKS_MAX; /* so that no count of ticks wraps */
}

bool strokes_are_valid(const strokes_setup *setup)
{
    if (setup->n < 2u || setup->n > STROKES_MAX || setup->n % 2u != 0u || !is_time(setup->stroke_ticks) ||
        !is_time(setup->still_ticks) || setup->still_counts < 1u) {
        return false;
    }
    const bool first_is_positive = setup->plan[0].drive > 0;
    for (uint8_t i = 0; i < setup->n; i++) {
        const int16_t drive = setup->plan[i].drive;
        const bool wants_positive = (i % 2u == 0u) == first_is_positive;
        if (wants_positive ? drive <= 0 : drive >= 0) {
            return false;
        }
    }
    return true;
}

void strokes_begin(strokes *s)
{
    s->low = 0;
    s->high = 0;
    s->driven = 0;
    s->still = 0;
    s->at = 0;
    s->failed = 0;
    s->is_first = true;
    s->is_fresh = true;
}

static bool raises(const strokes *s, uint8_t at)
{
    return (s->setup.plan[at].drive > 0) == (s->setup.polarity > 0);
}

static bool has_turned(const strokes *s, int32_t counts)
{
    const int32_t turn = s->setup.plan[s->at].turn;
    return raises(s, s->at) ? counts >= turn : counts <= turn;
}

static bool stands_still(strokes *s, int32_t counts)
{
    if (counts < s->low || s->is_fresh) {
        s->low = counts;
    }
    if (counts > s->high || s->is_fresh) {
        s->high = counts;
    }
    const uint32_t span = (uint32_t)s->high - (uint32_t)s->low;
    if (s->is_fresh || span >= s->setup.still_counts) {
        s->low = counts;
        s->high = counts;
        s->still = 0;
    } else {
        s->still++;
    }
    s->is_fresh = false;
    return s->still > s->setup.still_ticks;
}

static void begin_next(strokes *s)
{
    s->at++;
    if (s->at >= s->setup.n) {
        s->at = 0;
    }
    s->driven = 0;
    s->is_fresh = true;
}

int16_t strokes_step(strokes *s, int32_t counts)
{
    if (s->failed >= STROKES_FAILED_MAX) {
        return 0;
    }
    if (s->is_first) {
        s->is_first = false;
        const bool is_outward = raises(s, 0) ? counts > s->setup.centre : counts < s->setup.centre;
        s->at = is_outward ? 1u : 0u;
    } else {
        s->driven++;
    }
    const bool is_still = stands_still(s, counts);
    if (has_turned(s, counts)) {
        s->failed = 0;
        begin_next(s);
    } else if (is_still || s->driven > s->setup.stroke_ticks) {
        s->failed++;
        begin_next(s);
    } else {
        /* it drives on */
    }
    return s->failed >= STROKES_FAILED_MAX ? (int16_t)0 : s->setup.plan[s->at].drive;
}
