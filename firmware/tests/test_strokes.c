/* The stroke test's law, against decisions worked out by hand. tests/hil holds it to the host's law, tick for tick. */
#include <limits.h>
#include <string.h>

#include "check.h"
#include "strokes.h"

#define CENTRE 512
#define STROKE_TICKS 20
#define STILL_TICKS 5
#define STILL_COUNTS 4

static strokes s;

static strokes_setup to_and_fro(int32_t high, int32_t low)
{
    const strokes_setup setup = {{{high, 50}, {low, -70}}, CENTRE, STROKE_TICKS, STILL_TICKS, STILL_COUNTS, 2, 1};
    return setup;
}

static void start(const strokes_setup *setup)
{
    CHECK(strokes_are_valid(setup));
    memset(&s, 0x55, sizeof s); /* whatever was there */
    s.setup = *setup;
    strokes_begin(&s);
}

static void start_between(int32_t high, int32_t low)
{
    const strokes_setup setup = to_and_fro(high, low);
    start(&setup);
}

static void test_again_and_again_to_the_turning_points(void)
{
    start_between(600, 400);
    for (int round = 0; round < 3; round++) {
        CHECK(strokes_step(&s, 500) == 50);
        CHECK(strokes_step(&s, 599) == 50);
        CHECK(strokes_step(&s, 600) == -70); /* at the turning point it is over */
        CHECK(strokes_step(&s, 650) == -70);
        CHECK(strokes_step(&s, 401) == -70);
        CHECK(strokes_step(&s, 399) == 50);
    }
}

static void test_negative_polarity_mirrors_it(void)
{
    strokes_setup setup = to_and_fro(400, 600); /* positive drive lowers the counts */
    setup.polarity = -1;
    start(&setup);
    CHECK(strokes_step(&s, 520) == 50);
    CHECK(strokes_step(&s, 401) == 50);
    CHECK(strokes_step(&s, 400) == -70);
    CHECK(strokes_step(&s, 599) == -70);
    CHECK(strokes_step(&s, 600) == 50);
}

static void test_the_first_stroke_is_inward(void)
{
    for (int8_t polarity = -1; polarity <= 1; polarity = (int8_t)(polarity + 2)) {
        strokes_setup setup = polarity > 0 ? to_and_fro(600, 400) : to_and_fro(400, 600);
        setup.polarity = polarity;
        start(&setup);
        CHECK(strokes_step(&s, CENTRE + 1) == (polarity > 0 ? -70 : 50));
        start(&setup);
        CHECK(strokes_step(&s, CENTRE - 1) == (polarity > 0 ? 50 : -70));
        start(&setup);
        CHECK(strokes_step(&s, CENTRE) == 50); /* at the centre: the plan's first */
    }
}

static void test_one_ends_in_a_tick_at_most(void)
{
    const strokes_setup setup = {
        {{450, 50}, {550, -60}, {600, 70}, {400, -80}}, CENTRE, STROKE_TICKS, STILL_TICKS, STILL_COUNTS, 4, 1};
    start(&setup);
    CHECK(strokes_step(&s, 505) == -60); /* the first was over already */
    CHECK(strokes_step(&s, 505) == 70);
    CHECK(strokes_step(&s, 505) == 70);
}

/* A shaft that moves, too slowly: STROKE_TICKS + 1 ticks, then the other way, then nothing. */
static void test_two_in_a_row_that_take_too_long_end_it(void)
{
    start_between(600, 400);
    int32_t counts = 500;
    for (int k = 0; k <= STROKE_TICKS; k++, counts++) {
        CHECK(strokes_step(&s, counts) == 50);
    }
    for (int k = 0; k <= STROKE_TICKS; k++, counts++) {
        CHECK(strokes_step(&s, counts) == -70);
    }
    CHECK(strokes_step(&s, counts) == 0);
    for (int k = 0; k < 100; k++) {
        CHECK(strokes_step(&s, k % 2 == 0 ? 300 : 700) == 0); /* whatever it reads from now on */
    }
}

/* A reading that stands still, to within noise: STILL_TICKS + 1 ticks of each stroke. */
static void test_two_in_a_row_without_motion_end_it(void)
{
    start_between(600, 400);
    for (int k = 0; k <= STILL_TICKS; k++) {
        CHECK(strokes_step(&s, 500 + k % STILL_COUNTS) == 50);
    }
    for (int k = 0; k <= STILL_TICKS + 1; k++) {
        CHECK(strokes_step(&s, 500 + k % STILL_COUNTS) == -70);
    }
    CHECK(strokes_step(&s, 500) == 0);
}

static void test_motion_begins_the_standstill_anew(void)
{
    start_between(600, 400);
    int32_t counts = 500;
    for (int k = 0; k < STROKE_TICKS; k++) {
        counts += k % STILL_TICKS == 0 ? STILL_COUNTS : 0;
        CHECK(strokes_step(&s, counts) == 50);
    }
}

static void test_one_that_fails_alone_is_forgiven(void)
{
    start_between(600, 400);
    for (int round = 0; round < 5; round++) {
        for (int k = 0; k <= STILL_TICKS; k++) {
            CHECK(strokes_step(&s, 500) == 50);
        }
        CHECK(strokes_step(&s, 500) == -70);
        CHECK(strokes_step(&s, 400) == 50);
    }
}

static void test_what_is_no_plan(void)
{
    strokes_setup setup = to_and_fro(600, 400);
    CHECK(strokes_are_valid(&setup));
    for (uint8_t n = 0; n < 12u; n++) {
        for (uint8_t i = 0; i < STROKES_MAX; i++) {
            setup.plan[i].drive = i % 2u == 0u ? 1 : -1;
        }
        setup.n = n;
        CHECK(strokes_are_valid(&setup) == (n == 2u || n == 4u || n == 6u || n == 8u));
    }
    setup.n = 4;
    static const int16_t wrong[] = {0, 1, INT16_MAX};
    for (uint8_t i = 0; i < 4u; i++) {
        for (unsigned w = 0; w < 3u; w++) {
            strokes_setup other = setup;
            other.plan[i].drive = (int16_t)(i % 2u == 0u ? -wrong[w] : wrong[w]); /* like its neighbours' */
            CHECK(!strokes_are_valid(&other));
        }
    }
    strokes_setup other = setup;
    other.stroke_ticks = 0;
    CHECK(!strokes_are_valid(&other));
    other = setup;
    other.still_ticks = 0;
    CHECK(!strokes_are_valid(&other));
    other = setup;
    other.still_counts = 0;
    CHECK(!strokes_are_valid(&other));
    other = to_and_fro(INT32_MAX, INT32_MIN);
    other.plan[1].drive = INT16_MIN;
    CHECK(strokes_are_valid(&other));
}

/* The ends of what an encoder may count: nothing overflows, which the sanitizers watch. */
static void test_the_farthest_readings(void)
{
    strokes_setup setup = to_and_fro(INT32_MAX, INT32_MIN);
    setup.centre = INT32_MIN;
    start(&setup);
    CHECK(strokes_step(&s, INT32_MIN) == 50);
    CHECK(strokes_step(&s, INT32_MAX) == -70);
    CHECK(strokes_step(&s, INT32_MAX) == -70);
    CHECK(strokes_step(&s, INT32_MIN + 1) == -70);
    CHECK(strokes_step(&s, INT32_MIN) == 50);
}

/* The longest times: neither count of ticks wraps. */
/* Neither count of ticks wraps. */
static void test_the_longest_times(void)
{
    strokes_setup setup = to_and_fro(600, 400);
    setup.stroke_ticks = STROKES_TICKS_MAX;
    setup.still_ticks = STROKES_TICKS_MAX;
    start(&setup);
    for (unsigned k = 0; k <= 2u * STROKES_TICKS_MAX + 1u; k++) {
        CHECK(strokes_step(&s, 500) == (k <= STROKES_TICKS_MAX ? 50 : -70));
    }
    CHECK(strokes_step(&s, 500) == 0);
    setup.stroke_ticks++;
    CHECK(!strokes_are_valid(&setup));
    setup.stroke_ticks--;
    setup.still_ticks = UINT16_MAX;
    CHECK(!strokes_are_valid(&setup));
}

int main(void)
{
    test_again_and_again_to_the_turning_points();
    test_negative_polarity_mirrors_it();
    test_the_first_stroke_is_inward();
    test_one_ends_in_a_tick_at_most();
    test_two_in_a_row_that_take_too_long_end_it();
    test_two_in_a_row_without_motion_end_it();
    test_motion_begins_the_standstill_anew();
    test_one_that_fails_alone_is_forgiven();
    test_what_is_no_plan();
    test_the_farthest_readings();
    test_the_longest_times();
    return report("strokes");
}
