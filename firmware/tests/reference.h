/* Frames read a second way, for the fuzzers to hold the firmware's reading to: a whole frame at a time, the CRC bit by
 * bit, and nothing shared with core/frames.c but the sizes. */
#ifndef RIG_REFERENCE_H
#define RIG_REFERENCE_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "frames.h"

/* Stops the program, and with it the fuzzer, on a broken promise. */
#define REQUIRE(condition)                                                        \
    do {                                                                          \
        if (!(condition)) {                                                       \
            fprintf(stderr, "%s:%d: broken: %s\n", __FILE__, __LINE__, #condition); \
            abort();                                                              \
        }                                                                         \
    } while (0)

static unsigned reference_crc(const uint8_t *bytes, size_t n)
{
    unsigned crc = 0xFFFFu;
    for (size_t bit = 0; bit < 8u * n; bit++) {
        const unsigned in = ((unsigned)bytes[bit / 8u] >> (7u - bit % 8u)) & 1u;
        const unsigned out = (crc >> 15) & 1u;
        crc = (crc << 1) & 0xFFFFu;
        if (in != out) {
            crc ^= 0x1021u;
        }
    }
    return crc;
}

/* The content of the frame in `n` bytes before its 0x00, or 0 if it is not valid. */
static size_t reference_decode(const uint8_t *bytes, size_t n, uint8_t content[FRAME_CONTENT_MAX])
{
    uint8_t packet[FRAME_ENCODED_MAX];
    size_t length = 0;
    if (n > FRAME_ENCODED_MAX) {
        return 0;
    }
    for (size_t code_at = 0; code_at < n; code_at += bytes[code_at]) {
        if (code_at + bytes[code_at] > n) {
            return 0; /* points past the end */
        }
        if (code_at > 0u) {
            packet[length++] = 0; /* between two groups; none is of 254 bytes here */
        }
        memcpy(packet + length, bytes + code_at + 1, bytes[code_at] - 1u);
        length += bytes[code_at] - 1u;
    }
    if (length < FRAME_HEADER + FRAME_CRC) {
        return 0;
    }
    length -= FRAME_CRC;
    if (reference_crc(packet, length) != packet[length] + 256u * packet[length + 1u]) {
        return 0;
    }
    memcpy(content, packet, length);
    return length;
}

/* Collects bytes up to a 0x00, as many as come. */
typedef struct {
    uint8_t bytes[FRAME_WIRE_MAX]; /* one more than a frame may have */
    size_t n;
} reference_line;

/* Takes one byte; the length of the content when it completes a valid frame, else 0. */
static size_t reference_receive(reference_line *line, uint8_t byte, uint8_t content[FRAME_CONTENT_MAX])
{
    if (byte != 0u) {
        if (line->n < sizeof line->bytes) {
            line->bytes[line->n++] = byte;
        }
        return 0;
    }
    const size_t length = reference_decode(line->bytes, line->n, content);
    line->n = 0;
    return length;
}

#endif
