/* One way of a serial wire in virtual time: one byte goes after another, and has arrived when its last bit has. */
#ifndef RIG_WIRE_H
#define RIG_WIRE_H

#include <stdbool.h>
#include <stdint.h>

#define WIRE_BYTES 4096u /* that it holds; a power of two */

typedef struct {
    uint8_t byte[WIRE_BYTES];
    int64_t arrives_ns[WIRE_BYTES];
    uint32_t head, count;
    int64_t last_ns; /* arrival of the byte last sent */
} wire;

/* Sends a byte that takes `byte_ns`, now or after those on the way. False: the wire is full, the byte is lost. */
bool wire_put(wire *w, int64_t now_ns, int64_t byte_ns, uint8_t byte);

/* The same for many. Returns how many it took. */
uint32_t wire_put_all(wire *w, int64_t now_ns, int64_t byte_ns, const uint8_t *bytes, uint32_t n);

/* When the next byte arrives; INT64_MAX: none is on the way. */
int64_t wire_next_ns(const wire *w);

/* When what a reader waits for arrives: `until` 1: the next byte; 2: the next zero byte, which ends a frame; INT64_MAX: none
 * is on the way, or another `until`. */
int64_t wire_arrival_ns(const wire *w, int32_t until);

/* The next byte, of which there must be one. */
uint8_t wire_take(wire *w);

/* Up to `n` bytes that have arrived by now. Returns how many. */
uint32_t wire_take_arrived(wire *w, int64_t now_ns, uint8_t *bytes, uint32_t n);

#endif
