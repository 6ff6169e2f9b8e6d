/* Any bytes into the frame receiver, and any content through the encoder: held to the reference. */
#include "reference.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* Whatever comes in: the same frames as the reference finds, and each other non-empty one counted as dropped. */
static void any_bytes(const uint8_t *data, size_t size)
{
    static frame_receiver rx;
    static reference_line line;
    uint8_t content[FRAME_CONTENT_MAX];
    uint16_t dropped = 0;
    frame_receiver_init(&rx);
    line.n = 0;
    for (size_t i = 0; i < size; i++) {
        const bool ends_one = data[i] == 0u && line.n > 0u;
        const size_t expected = reference_receive(&line, data[i], content);
        const uint8_t got = frame_receive(&rx, data[i]);
        REQUIRE(got == expected);
        REQUIRE(memcmp(rx.buffer, content, got) == 0);
        dropped = (uint16_t)(dropped + (ends_one && got == 0u ? 1u : 0u));
        REQUIRE(rx.dropped == dropped);
    }
}

/* The first two bytes say where a byte of the frame is damaged, and how; the others are content. */
static void any_content(const uint8_t *data, size_t size)
{
    uint8_t wire[FRAME_WIRE_MAX], content[FRAME_CONTENT_MAX];
    const size_t length = size - 2u > FRAME_CONTENT_MAX ? FRAME_CONTENT_MAX : size - 2u;
    const uint8_t n = frame_encode(data + 2, (uint8_t)length, wire);
    if (length == 0u) {
        REQUIRE(n == 0u);
        return;
    }
    REQUIRE(n == length + 4u && memchr(wire, 0, n) == wire + n - 1);
    if (length >= FRAME_HEADER) {
        REQUIRE(reference_decode(wire, n - 1u, content) == length && memcmp(content, data + 2, length) == 0);
        any_bytes(wire, n);
    }
    wire[data[0] % n] ^= data[1];
    any_bytes(wire, n);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    any_bytes(data, size);
    if (size >= 2u) {
        any_content(data, size);
    }
    return 0;
}
