#include "frames.h"

uint16_t frame_crc16(const uint8_t *bytes, uint8_t n)
{
    uint16_t crc = 0xFFFFu;
    for (uint8_t i = 0; i < n; i++) {
        /* eight steps of the division by 0x1021 at once */
        uint8_t x = (uint8_t)((crc >> 8) ^ bytes[i]);
        x = (uint8_t)(x ^ (x >> 4));
        const uint16_t wide = x;
        crc = (uint16_t)((crc << 8) ^ (wide << 12) ^ (wide << 5) ^ wide);
    }
    return crc;
}

uint8_t frame_encode(const uint8_t *content, uint8_t n, uint8_t wire[FRAME_WIRE_MAX])
{
    if (n == 0u || n > FRAME_CONTENT_MAX) {
        return 0;
    }
    const uint16_t crc = frame_crc16(content, n);
    uint8_t code_at = 0; /* where the distance to the next zero belongs */
    uint8_t out = 1;
    for (uint8_t i = 0; i < n + FRAME_CRC; i++) {
        uint8_t byte;
        if (i < n) {
            byte = content[i];
        } else {
            byte = (uint8_t)(i == n ? crc & 0xFFu : crc >> 8);
        }
        if (byte == 0u) {
            wire[code_at] = (uint8_t)(out - code_at);
            code_at = out++;
        } else {
            wire[out++] = byte;
        }
    }
    wire[code_at] = (uint8_t)(out - code_at);
    wire[out++] = 0;
    return out;
}

void frame_receiver_init(frame_receiver *rx)
{
    rx->length = 0;
    rx->overflow = false;
    rx->dropped = 0;
}

/* Decodes `n` bytes in place; no byte of them is zero. Returns the decoded length, 0 if a code points past the end. */
static uint8_t cobs_decode(uint8_t *bytes, uint8_t n)
{
    uint8_t in = 0;
    uint8_t out = 0;
    while (in < n) {
        const uint8_t code = bytes[in++];
        if (code - 1u > (uint8_t)(n - in)) {
            return 0;
        }
        for (uint8_t k = 1; k < code; k++) {
            bytes[out++] = bytes[in++];
        }
        if (in < n) {
            bytes[out++] = 0;
        }
    }
    return out;
}

static uint8_t check(uint8_t *bytes, uint8_t n)
{
    const uint8_t length = cobs_decode(bytes, n);
    if (length < FRAME_HEADER + FRAME_CRC || length > FRAME_PACKET_MAX) {
        return 0;
    }
    const uint8_t content = (uint8_t)(length - FRAME_CRC);
    const uint16_t sent = (uint16_t)(bytes[content] | ((uint16_t)bytes[content + 1u] << 8));
    return sent == frame_crc16(bytes, content) ? content : 0u;
}

uint8_t frame_receive(frame_receiver *rx, uint8_t byte)
{
    if (byte != 0u) {
        if (rx->length < FRAME_ENCODED_MAX) {
            rx->buffer[rx->length++] = byte;
        } else {
            rx->overflow = true; /* longer than any frame: dropped when its end comes */
        }
        return 0;
    }
    const bool empty = rx->length == 0u; /* a spare 0x00, as a host sends to synchronise: not an error */
    const uint8_t content = rx->overflow ? 0u : check(rx->buffer, rx->length);
    rx->length = 0;
    rx->overflow = false;
    if (content == 0u && !empty) {
        rx->dropped++;
    }
    return content;
}
