/* The stroke test's law, against decisions worked out by hand and against a second reading of a plan. */
#include <string.h>

#include "check.h"
#include "strokes.h"

static strokes s;

static void plan(int8_t polarity, unsigned n, const stroke *of)
{
    memset(&s, 0x55, sizeof s); /* whatever was there */
    strokes_clear(&s);
    for (unsigned i = 0; i < n; i++) {
        CHECK(stroke_is_valid(&of[i]));
        strokes_add(&s, &of[i]);
    }
    strokes_begin(&s, polarity);
}

static void test_each_drives_until_its_turning_point(void)
{
    static const stroke two[] = {{600, 1000, 50}, {400, 1000, -70}};
    plan(1, 2, two);
    CHECK(strokes_step(&s, 500) == 50);
    CHECK(strokes_step(&s, 599) == 50);
    CHECK(strokes_step(&s, 600) == -70); /* at the turning point it is over */
    CHECK(strokes_step(&s, 650) == -70);
    CHECK(strokes_step(&s, 401) == -70);
    CHECK(strokes_step(&s, 399) == 0);
    CHECK(strokes_step(&s, 500) == 0 && s.at == 2); /* and nothing comes after the last */
}

static void test_negative_polarity_mirrors_it(void)
{
    static const stroke two[] = {{400, 1000, 50}, {600, 1000, -70}}; /* positive drive lowers the counts */
    plan(-1, 2, two);
    CHECK(strokes_step(&s, 500) == 50);
    CHECK(strokes_step(&s, 401) == 50);
    CHECK(strokes_step(&s, 400) == -70);
    CHECK(strokes_step(&s, 599) == -70);
    CHECK(strokes_step(&s, 600) == 0);
}

static void test_one_that_does_not_get_there_ends_after_its_time(void)
{
    static const stroke two[] = {{600, 3, 50}, {400, 2, -70}};
    plan(1, 2, two);
    for (int k = 0; k < 3; k++) {
        CHECK(strokes_step(&s, 500) == 50);
    }
    for (int k = 0; k < 2; k++) {
        CHECK(strokes_step(&s, 500) == -70);
    }
    CHECK(strokes_step(&s, 500) == 0);
}

/* A stroke whose turning point lies behind the shaft already drives for one tick at most; the very first for none. */
static void test_one_ends_in_a_tick_at_most(void)
{
    static const stroke three[] = {{400, 9, 50}, {450, 9, 60}, {600, 9, 70}};
    plan(1, 3, three);
    CHECK(strokes_step(&s, 500) == 60);
    CHECK(strokes_step(&s, 500) == 70);
    CHECK(strokes_step(&s, 500) == 70);
}

static void test_what_is_no_stroke(void)
{
    static const stroke wrong[] = {{600, 100, 0}, {600, 0, 50}, {600, STROKE_TICKS_MAX + 1u, 50}};
    static const stroke right[] = {{600, 1, 1}, {-5, STROKE_TICKS_MAX, INT16_MIN}};
    for (unsigned i = 0; i < 3u; i++) {
        CHECK(!stroke_is_valid(&wrong[i]));
    }
    for (unsigned i = 0; i < 2u; i++) {
        CHECK(stroke_is_valid(&right[i]));
    }
}

static void test_an_empty_plan_drives_nothing(void)
{
    plan(1, 0, NULL);
    CHECK(strokes_step(&s, 500) == 0);
}

static uint32_t random_state = 1;

static unsigned below(unsigned n)
{
    random_state = random_state * 1664525u + 1013904223u;
    return (random_state >> 12) % n;
}

/* Any plan on any readings, in 64 bits: which stroke drives follows from how often one has ended. */
static void test_any_plan(void)
{
    for (int round = 0; round < 300; round++) {
        stroke of[STROKES_MAX];
        const unsigned n = 1u + below(STROKES_MAX);
        const int8_t polarity = below(2) != 0u ? 1 : -1;
        for (unsigned i = 0; i < n; i++) {
            const int16_t drive = (int16_t)(1 + (int)below(300));
            of[i].drive = below(2) != 0u ? drive : (int16_t)-drive;
            of[i].turn = (int32_t)(480u + below(60));
            of[i].ticks = (uint16_t)(1u + below(20));
        }
        plan(polarity, n, of);
        unsigned now = 0;
        int64_t driven = 0;
        for (int k = 0; k < 300; k++) {
            const int64_t counts = 470 + (int64_t)below(80);
            if (now < n) {
                const int64_t towards = of[now].drive * polarity > 0 ? 1 : -1;
                if (towards * (counts - of[now].turn) >= 0 || driven == of[now].ticks) {
                    now++;
                    driven = 0;
                }
            }
            CHECK(strokes_step(&s, (int32_t)counts) == (now < n ? of[now].drive : 0));
            driven++;
        }
    }
}

int main(void)
{
    test_each_drives_until_its_turning_point();
    test_negative_polarity_mirrors_it();
    test_one_that_does_not_get_there_ends_after_its_time();
    test_one_ends_in_a_tick_at_most();
    test_what_is_no_stroke();
    test_an_empty_plan_drives_nothing();
    test_any_plan();
    return report("strokes");
}
