#include <stdlib.h>
#include <string.h>

#include "check.h"
#include "frames.h"

/* Feeds bytes; returns the content's length of the last valid frame, and counts the valid frames. */
static uint8_t feed(frame_receiver *rx, const uint8_t *bytes, size_t n, unsigned *frames, uint8_t *content)
{
    uint8_t last = 0;
    for (size_t i = 0; i < n; i++) {
        const uint8_t length = frame_receive(rx, bytes[i]);
        if (length != 0u) {
            (*frames)++;
            last = length;
            memcpy(content, rx->buffer, length);
        }
    }
    return last;
}

static void test_crc(void)
{
    CHECK(frame_crc16((const uint8_t *)"123456789", 9) == 0x29B1u); /* the catalogue's check value */
    CHECK(frame_crc16((const uint8_t *)"", 0) == 0xFFFFu);
}

/* Frames worked out by hand: the stuffing around zeros. */
static void test_vectors(void)
{
    uint8_t wire[FRAME_WIRE_MAX];
    /* READ, seq 1: 01 04 01 00 + CRC 0x1D85 (by Python's binascii.crc_hqx) */
    const uint8_t content[] = {0x01, 0x04, 0x01, 0x00};
    const uint16_t crc = 0x1D85u;
    const uint8_t n = frame_encode(content, 4, wire);
    CHECK(n == 8);
    CHECK(wire[0] == 4 && wire[1] == 1 && wire[2] == 4 && wire[3] == 1); /* three bytes, then the zero */
    CHECK(wire[4] == 3 && wire[5] == (crc & 0xFFu) && wire[6] == crc >> 8 && wire[7] == 0);
    /* all zeros: each becomes a code of 1 */
    const uint8_t zeros[4] = {0, 0, 0, 0};
    CHECK(frame_encode(zeros, 4, wire) == 8);
    CHECK(wire[0] == 1 && wire[1] == 1 && wire[2] == 1 && wire[3] == 1 && wire[4] == 3);
    CHECK(frame_encode(zeros, 0, wire) == 0);
    uint8_t big[FRAME_CONTENT_MAX + 1u] = {0};
    CHECK(frame_encode(big, sizeof big, wire) == 0);
}

static void test_round_trip(void)
{
    srand(7);
    for (unsigned length = FRAME_HEADER; length <= FRAME_CONTENT_MAX; length++) {
        for (unsigned repeat = 0; repeat < 40; repeat++) {
            uint8_t content[FRAME_CONTENT_MAX], got[FRAME_CONTENT_MAX], wire[FRAME_WIRE_MAX];
            frame_receiver rx;
            unsigned frames = 0;
            for (unsigned i = 0; i < length; i++) {
                content[i] = (uint8_t)(rand() % 3 == 0 ? 0 : rand());
            }
            const uint8_t n = frame_encode(content, (uint8_t)length, wire);
            CHECK(n == length + 4u);
            CHECK(memchr(wire, 0, n) == wire + n - 1); /* the only zero ends the frame */
            frame_receiver_init(&rx);
            CHECK(feed(&rx, wire, n, &frames, got) == length);
            CHECK(frames == 1 && rx.dropped == 0 && memcmp(content, got, length) == 0);
        }
    }
}

static void test_damage(void)
{
    const uint8_t content[] = {1, 5, 9, 0, 0x2C, 0x01};
    uint8_t wire[FRAME_WIRE_MAX], got[FRAME_CONTENT_MAX];
    const uint8_t n = frame_encode(content, sizeof content, wire);
    for (unsigned byte = 0; byte + 1u < n; byte++) {
        for (unsigned value = 0; value < 256; value++) {
            if (value == wire[byte]) {
                continue;
            }
            frame_receiver rx;
            unsigned frames = 0;
            uint8_t bad[FRAME_WIRE_MAX];
            memcpy(bad, wire, n);
            bad[byte] = (uint8_t)value;
            frame_receiver_init(&rx);
            (void)feed(&rx, bad, n, &frames, got);
            CHECK(frames == 0); /* any one byte */
            CHECK(rx.dropped >= 1);
            (void)feed(&rx, wire, n, &frames, got);
            CHECK(frames == 1); /* the next one is understood */
        }
    }
    for (uint8_t cut = 1; cut + 1u < n; cut++) { /* bytes lost at the front, then a whole frame */
        frame_receiver rx;
        unsigned frames = 0;
        frame_receiver_init(&rx);
        (void)feed(&rx, wire + cut, (size_t)(n - cut), &frames, got);
        CHECK(frames == 0 && rx.dropped == 1);
        (void)feed(&rx, wire, n, &frames, got);
        CHECK(frames == 1);
    }
}

static void test_garbage(void)
{
    const uint8_t content[] = {1, 4, 3, 0};
    uint8_t wire[FRAME_WIRE_MAX], got[FRAME_CONTENT_MAX];
    const uint8_t n = frame_encode(content, sizeof content, wire);
    frame_receiver rx;
    unsigned frames = 0;
    frame_receiver_init(&rx);
    for (unsigned i = 0; i < 5000; i++) { /* far longer than the buffer, no zero in it */
        CHECK(frame_receive(&rx, (uint8_t)(1 + i % 255)) == 0);
    }
    CHECK(frame_receive(&rx, 0) == 0 && rx.dropped == 1);
    CHECK(feed(&rx, wire, n, &frames, got) == sizeof content && frames == 1);
    const uint8_t spare[3] = {0, 0, 0};
    CHECK(feed(&rx, spare, 3, &frames, got) == 0 && rx.dropped == 1); /* spare zeros are no frames */
    const uint8_t past_end[] = {9, 1, 2, 0};
    CHECK(feed(&rx, past_end, sizeof past_end, &frames, got) == 0 && rx.dropped == 2);
    const uint8_t too_short[] = {4, 1, 4, 3, 0};
    CHECK(feed(&rx, too_short, sizeof too_short, &frames, got) == 0 && rx.dropped == 3);
    srand(11);
    for (unsigned i = 0; i < 200000; i++) {
        const uint8_t length = frame_receive(&rx, (uint8_t)rand());
        CHECK(length == 0 || length <= FRAME_CONTENT_MAX);
    }
    frames = 0;
    (void)frame_receive(&rx, 0);
    CHECK(feed(&rx, wire, n, &frames, got) == sizeof content && frames == 1);
}

/* One byte longer than the longest frame: dropped, and nothing is written past the buffer (sanitizer). */
static void test_oversize(void)
{
    frame_receiver rx;
    frame_receiver_init(&rx);
    for (unsigned i = 0; i < FRAME_ENCODED_MAX + 1u; i++) {
        (void)frame_receive(&rx, 0x41);
    }
    CHECK(rx.overflow);
    CHECK(frame_receive(&rx, 0) == 0 && rx.dropped == 1 && !rx.overflow);

    /* the longest frame is taken; with one byte more before its end it is not, though its beginning is whole */
    uint8_t content[FRAME_CONTENT_MAX], wire[FRAME_WIRE_MAX], got[FRAME_CONTENT_MAX];
    unsigned frames = 0;
    memset(content, 0x55, sizeof content);
    const uint8_t n = frame_encode(content, sizeof content, wire);
    CHECK(n == FRAME_WIRE_MAX);
    CHECK(feed(&rx, wire, n, &frames, got) == sizeof content);
    (void)feed(&rx, wire, n - 1u, &frames, got);
    CHECK(frame_receive(&rx, 0x55) == 0 && frame_receive(&rx, 0) == 0 && rx.dropped == 2 && frames == 1);
}

int main(void)
{
    test_crc();
    test_vectors();
    test_round_trip();
    test_damage();
    test_garbage();
    test_oversize();
    return report("frames");
}
