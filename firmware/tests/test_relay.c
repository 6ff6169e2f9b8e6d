/* The dual-channel relay, against decisions worked out by hand and against 64-bit arithmetic. */
#include <string.h>

#include "check.h"
#include "relay.h"

#define CENTRE (512l * RELAY_COUNT)

static relay r;

/* The drive names the state: 1 above and z > 0, 2 above and z < 0, 3 below and z > 0, 4 below and z < 0. */
static relay_setup setup_of(int32_t centre, int32_t z_bound, int8_t direction)
{
    const relay_setup setup = {centre, z_bound, {1, 2, 3, 4}, direction};
    return setup;
}

static void start(int32_t centre, int32_t z_bound, int8_t direction)
{
    const relay_setup setup = setup_of(centre, z_bound, direction);
    CHECK(relay_is_valid(&setup));
    memset(&r, 0x55, sizeof r); /* whatever was there */
    relay_init(&r, &setup);
}

static void test_starts_inward_of_where_it_stands(void)
{
    start(CENTRE, 1000000, 1);
    CHECK(relay_step(&r, 513) == 1 && r.z == 0);
    start(CENTRE, 1000000, 1);
    CHECK(relay_step(&r, 511) == 4 && r.z == 0);
    start(CENTRE, 1000000, 1);
    CHECK(relay_step(&r, 512) == 1); /* exactly at the centre: as above */
    start(CENTRE, 1000000, -1);
    CHECK(relay_step(&r, 513) == 4);
    start(CENTRE, 1000000, -1);
    CHECK(relay_step(&r, 512) == 1); /* above in position, whichever way the counts go */
    start(CENTRE + 1, 1000000, 1);
    CHECK(relay_step(&r, 512) == 4); /* a sixteenth of a count below */
}

static void test_zero_keeps_the_state(void)
{
    start(CENTRE, 1000000, 1);
    CHECK(relay_step(&r, 511) == 4);
    CHECK(relay_step(&r, 512) == 4 && r.z == -16); /* y exactly 0: still below */
    CHECK(relay_step(&r, 513) == 2 && r.z == 0);   /* z exactly 0: still negative */
    CHECK(relay_step(&r, 513) == 1 && r.z == 32);
    CHECK(relay_step(&r, 512) == 1 && r.z == 48);
    CHECK(relay_step(&r, 511) == 3 && r.z == 32);
    CHECK(relay_step(&r, 511) == 3 && r.z == 0); /* still positive */
    CHECK(relay_step(&r, 511) == 4 && r.z == -32);
}

static void test_the_integral_is_exact(void)
{
    int64_t z = 0;
    int64_t before = 0;
    uint32_t random = 12345;
    start(CENTRE + 5, RELAY_Z_MAX, 1);
    for (int k = 0; k < 20000; k++) {
        random = random * 1664525u + 1013904223u;
        const int32_t counts = (int32_t)(400u + (random >> 16) % 224u);
        const int64_t y = (int64_t)counts * 16 - (CENTRE + 5);
        z += k > 0 ? y + before : 0;
        before = y;
        const int16_t drive = relay_step(&r, counts);
        CHECK(r.z == z && r.y == y);
        CHECK((drive <= 2) == (y > 0)); /* the centre is no whole count: y is never 0 */
        CHECK(z == 0 || (drive % 2 == 1) == (z > 0));
    }
    CHECK(!r.bound_reached);
}

static void test_the_integral_stays_within_its_bound(void)
{
    start(CENTRE, 100, 1);
    CHECK(relay_step(&r, 515) == 1 && r.z == 0);
    CHECK(relay_step(&r, 515) == 1 && r.z == 96 && !r.bound_reached);
    CHECK(relay_step(&r, 513) == 1 && r.z == 100 && r.bound_reached);
    CHECK(relay_step(&r, 509) == 3 && r.z == 68);
    CHECK(relay_step(&r, 508) == 4 && r.z == -44);
    CHECK(relay_step(&r, 508) == 4 && r.z == -100);
    CHECK(relay_step(&r, 508) == 4 && r.z == -100);
}

/* As far out as it reaches, largest bound, both sides: the sanitizer sees to it that nothing overflows. */
static void test_extremes(void)
{
    for (int side = 0; side < 2; side++) {
        const int32_t centre = side == 0 ? -RELAY_CENTRE_MAX : RELAY_CENTRE_MAX;
        const int32_t counts = (int32_t)(centre / RELAY_COUNT + (side == 0 ? RELAY_REACH_MAX : -RELAY_REACH_MAX));
        for (int8_t direction = -1; direction <= 1; direction = (int8_t)(direction + 2)) {
            const int sign = (side == 0) == (direction > 0) ? 1 : -1;
            start(centre, RELAY_Z_MAX, direction);
            CHECK(relay_reaches(&r.setup, counts));
            for (int k = 0; k < 2000; k++) {
                CHECK(relay_step(&r, counts) == (sign > 0 ? 1 : 4));
            }
            CHECK(r.z == sign * RELAY_Z_MAX && r.bound_reached);
        }
    }
}

static void test_reach(void)
{
    const relay_setup setup = setup_of(-CENTRE, 1, 1);
    CHECK(relay_reaches(&setup, -512 + RELAY_REACH_MAX) && !relay_reaches(&setup, -512 + RELAY_REACH_MAX + 1));
    CHECK(relay_reaches(&setup, -512 - RELAY_REACH_MAX) && !relay_reaches(&setup, -512 - RELAY_REACH_MAX - 1));
    CHECK(!relay_reaches(&setup, INT32_MAX) && !relay_reaches(&setup, INT32_MIN));
}

static void test_validity(void)
{
    relay_setup setup = setup_of(CENTRE, 1, 1);
    CHECK(relay_is_valid(&setup));
    setup.centre = 0;
    CHECK(relay_is_valid(&setup));
    setup.centre = -RELAY_CENTRE_MAX;
    CHECK(relay_is_valid(&setup));
    setup.centre = -RELAY_CENTRE_MAX - 1;
    CHECK(!relay_is_valid(&setup));
    setup.centre = RELAY_CENTRE_MAX;
    CHECK(relay_is_valid(&setup));
    setup.centre = RELAY_CENTRE_MAX + 1;
    CHECK(!relay_is_valid(&setup));
    setup = setup_of(CENTRE, 0, 1);
    CHECK(!relay_is_valid(&setup));
    setup.z_bound = RELAY_Z_MAX;
    CHECK(relay_is_valid(&setup));
    setup.z_bound = RELAY_Z_MAX + 1;
    CHECK(!relay_is_valid(&setup));
    setup = setup_of(CENTRE, 1, 0);
    CHECK(!relay_is_valid(&setup));
    setup.direction = 2;
    CHECK(!relay_is_valid(&setup));
}

int main(void)
{
    test_starts_inward_of_where_it_stands();
    test_zero_keeps_the_state();
    test_the_integral_is_exact();
    test_the_integral_stays_within_its_bound();
    test_extremes();
    test_reach();
    test_validity();
    return report("relay");
}
