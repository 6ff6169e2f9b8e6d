/* What a host sends: a request as the bytes on the wire; and numbers in frames. */
#ifndef RIG_REQUEST_H
#define RIG_REQUEST_H

#include <string.h>

#include "frames.h"

/* `wire` takes FRAME_WIRE_MAX bytes; `body` may be NULL where `n` is 0. Returns how many there are to send. */
static inline uint8_t encode_request(uint8_t version, uint8_t type, uint16_t seq, const uint8_t *body, uint8_t n, uint8_t *wire)
{
    uint8_t content[FRAME_CONTENT_MAX] = {version, type, (uint8_t)(seq & 0xFF), (uint8_t)(seq >> 8)};
    if (n > 0) {
        memcpy(content + FRAME_HEADER, body, n);
    }
    return frame_encode(content, (uint8_t)(FRAME_HEADER + n), wire);
}

static inline uint16_t u16(const uint8_t *at)
{
    return (uint16_t)(at[0] | (at[1] << 8));
}

static inline uint32_t u32(const uint8_t *at)
{
    return u16(at) | ((uint32_t)u16(at + 2) << 16);
}

static inline uint8_t *put16(uint8_t *at, int value)
{
    at[0] = (uint8_t)((unsigned)value & 0xFFu);
    at[1] = (uint8_t)(((unsigned)value >> 8) & 0xFFu);
    return at + 2;
}

static inline uint8_t *put32(uint8_t *at, uint32_t value)
{
    return put16(put16(at, (int)(value & 0xFFFFu)), (int)(value >> 16));
}

#endif
