#include "relay.h"

bool relay_is_valid(const relay_setup *setup)
{
    return setup->centre >= -RELAY_CENTRE_MAX && setup->centre <= RELAY_CENTRE_MAX && setup->z_bound >= 1 &&
           setup->z_bound <= RELAY_Z_MAX && (setup->direction == 1 || setup->direction == -1);
}

bool relay_reaches(const relay_setup *setup, int32_t counts)
{
    const int32_t middle = setup->centre / RELAY_COUNT;
    return counts >= middle - RELAY_REACH_MAX && counts <= middle + RELAY_REACH_MAX;
}

void relay_init(relay *r, const relay_setup *setup)
{
    r->setup = *setup;
    r->y = 0;
    r->z = 0;
    r->sign_y = 0;
    r->sign_z = 0;
    r->bound_reached = false;
}

static int8_t keep_sign(int32_t value, int8_t before)
{
    if (value > 0) {
        return 1;
    }
    return value < 0 ? (int8_t)-1 : before;
}

static int32_t within(int32_t value, int32_t bound)
{
    if (value > bound) {
        return bound;
    }
    return value < -bound ? -bound : value;
}

/* |y| <= 2^24 wherever the relay reaches, so |z + y + y| <= 2^30 + 2^25. */
static void integrate(relay *r, int32_t y)
{
    const int32_t sum = r->z + r->y + y;
    r->z = within(sum, r->setup.z_bound);
    if (r->z != sum) {
        r->bound_reached = true;
    }
}

int16_t relay_step(relay *r, int32_t counts)
{
    const int32_t above = counts * RELAY_COUNT - r->setup.centre;
    const int32_t y = r->setup.direction > 0 ? above : -above;
    if (r->sign_y == 0) {
        r->sign_y = y >= 0 ? 1 : -1;
        r->sign_z = r->sign_y;
    } else {
        integrate(r, y);
    }
    r->y = y;
    r->sign_y = keep_sign(y, r->sign_y);
    r->sign_z = keep_sign(r->z, r->sign_z);
    return r->setup.drive[(r->sign_y > 0 ? 0 : 2) + (r->sign_z > 0 ? 0 : 1)];
}
