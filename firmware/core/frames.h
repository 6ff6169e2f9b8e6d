/* Frames on the serial wire: COBS(packet) followed by 0x00.
 *
 * packet = version u8 | type u8 | seq u16 | body | crc16 u16, little-endian, at most 64 bytes.
 * The CRC is CRC-16/IBM-3740 (init 0xFFFF, polynomial 0x1021) over everything before it.
 * "content" below is the packet without its CRC.
 */
#ifndef RIG_FRAMES_H
#define RIG_FRAMES_H

#include <stdbool.h>
#include <stdint.h>

#define FRAME_PACKET_MAX 64u
#define FRAME_HEADER 4u /* version, type, seq */
#define FRAME_CRC 2u
#define FRAME_CONTENT_MAX (FRAME_PACKET_MAX - FRAME_CRC)
#define FRAME_ENCODED_MAX (FRAME_PACKET_MAX + 1u) /* COBS adds one byte to fewer than 255 */
#define FRAME_WIRE_MAX (FRAME_ENCODED_MAX + 1u)   /* and the 0x00 */

uint16_t frame_crc16(const uint8_t *bytes, uint8_t n);

/* Writes the frame of `n` bytes of content, 1 to FRAME_CONTENT_MAX. Returns the bytes written, 0 if n is out of range. */
uint8_t frame_encode(const uint8_t *content, uint8_t n, uint8_t wire[FRAME_WIRE_MAX]);

/* Collects bytes into frames. `dropped` counts the frames that were not valid, modulo 2^16. */
typedef struct {
    uint8_t buffer[FRAME_ENCODED_MAX];
    uint8_t length;
    bool overflow;
    uint16_t dropped;
} frame_receiver;

void frame_receiver_init(frame_receiver *rx);

/* Takes one byte. Returns the length of the content (at least FRAME_HEADER) when the byte completes a valid
 * frame, else 0. The content then stands in rx->buffer until the next call. */
uint8_t frame_receive(frame_receiver *rx, uint8_t byte);

#endif
