#include "strokes.h"

void strokes_clear(strokes *s)
{
    s->n = 0;
    s->at = 0;
}

void strokes_add(strokes *s, const stroke *next)
{
    s->plan[s->n] = *next;
    s->n++;
}

bool stroke_is_valid(const stroke *one)
{
    return one->drive != 0 && one->ticks >= 1u && one->ticks <= STROKE_TICKS_MAX;
}

void strokes_begin(strokes *s, int8_t polarity)
{
    s->polarity = polarity;
    s->at = 0;
    s->ticks = 0;
}

static bool is_over(const strokes *s, const stroke *now, int32_t counts)
{
    const bool raises = (now->drive > 0) == (s->polarity > 0);
    const bool has_turned = raises ? counts >= now->turn : counts <= now->turn;
    return has_turned || s->ticks >= now->ticks;
}

int16_t strokes_step(strokes *s, int32_t counts)
{
    if (s->at < s->n && is_over(s, &s->plan[s->at], counts)) {
        s->at++;
        s->ticks = 0;
    }
    if (s->at >= s->n) {
        return 0;
    }
    s->ticks++;
    return s->plan[s->at].drive;
}
