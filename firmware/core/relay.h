/* The dual-channel relay u = -h1 sgn(y) - h2 sgn(z), decided once a tick from the position's raw counts.
 *
 * y is the distance from the centre of travel in 1/16 count, z its trapezoidal integral in 1/32 count tick: both are
 * whole numbers, so that every decision is exact. sgn(0) keeps the state before. The drive of each of the four states
 * comes from the host, which knows dead band and polarity of the bridge: the relay only chooses one. All of it fits
 * 32 bits, with room for one more step at any bound that relay_is_valid lets pass.
 */
#ifndef RIG_RELAY_H
#define RIG_RELAY_H

#include <stdbool.h>
#include <stdint.h>

#define RELAY_COUNT 16 /* y of one count */
#define RELAY_Z_MAX 0x40000000L
#define RELAY_CENTRE_MAX 0x3FFFFFFFL
#define RELAY_REACH_MAX 0xFFFFFL /* counts on either side of the centre */

/* Index of a state's drive: 2 if y is below the centre, + 1 if z is negative. */
enum relay_state { RELAY_ABOVE_POSITIVE, RELAY_ABOVE_NEGATIVE, RELAY_BELOW_POSITIVE, RELAY_BELOW_NEGATIVE };

typedef struct {
    int32_t centre;    /* 1/16 count */
    int32_t z_bound;   /* 1/32 count tick; z stays within +-z_bound */
    int16_t drive[4];  /* drive units, by relay_state */
    int8_t direction;  /* +1 if y rises with the counts, -1 if it falls */
} relay_setup;

typedef struct {
    relay_setup setup;
    int32_t y; /* at the step before */
    int32_t z;
    int8_t sign_y; /* 0 before the first step */
    int8_t sign_z;
    bool bound_reached;
} relay;

/* Whether the numbers are in range: |centre| <= RELAY_CENTRE_MAX, 1 <= z_bound <= RELAY_Z_MAX, direction +-1. */
bool relay_is_valid(const relay_setup *setup);

/* Whether the relay can be run at this position, with room for the numbers that it makes. `setup` must be valid. */
bool relay_reaches(const relay_setup *setup, int32_t counts);

/* Begins anew: z is 0, and at the first step both relays are inward of where the shaft stands. `setup` must be valid. */
void relay_init(relay *r, const relay_setup *setup);

/* Takes this tick's position, one that it reaches; returns its drive. */
int16_t relay_step(relay *r, int32_t counts);

#endif
