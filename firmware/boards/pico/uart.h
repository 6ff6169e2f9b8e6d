/* The serial port, both ways by interrupts and queues. */
#ifndef RIG_PICO_UART_H
#define RIG_PICO_UART_H

#include <stdbool.h>
#include <stdint.h>

void uart_init(void);

/* Whether a received byte waits. */
bool uart_has_byte(void);

/* Takes the oldest received byte, and when the tick of its arrival was due (clock_tick_us); false if there is none. */
bool uart_take(uint8_t *byte, uint32_t *tick_us);

/* Queues all bytes; none, if they do not fit: a host that asks faster than the wire can answer loses replies. */
void uart_send(const uint8_t *bytes, uint8_t n);

#endif
