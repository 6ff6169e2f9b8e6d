/* What a host sends: a request as the bytes on the wire. */
#ifndef RIG_REQUEST_H
#define RIG_REQUEST_H

#include <string.h>

#include "frames.h"

/* `wire` takes FRAME_WIRE_MAX bytes; `body` may be NULL where `n` is 0. Returns how many there are to send. */
static uint8_t encode_request(uint8_t version, uint8_t type, uint16_t seq, const uint8_t *body, uint8_t n, uint8_t *wire)
{
    uint8_t content[FRAME_CONTENT_MAX] = {version, type, (uint8_t)(seq & 0xFF), (uint8_t)(seq >> 8)};
    if (n > 0) {
        memcpy(content + FRAME_HEADER, body, n);
    }
    return frame_encode(content, (uint8_t)(FRAME_HEADER + n), wire);
}

#endif
