/* The serial port, both ways by interrupts and queues. */
#ifndef RIG_UNO_UART_H
#define RIG_UNO_UART_H

#include <stdbool.h>
#include <stdint.h>

void uart_init(void);

/* Whether a received byte waits. */
bool uart_has_byte(void);

/* Takes the oldest received byte, and the tick (clock_tick) in which it arrived; false if there is none. */
bool uart_take(uint8_t *byte, uint8_t *tick);

/* Queues all bytes; none, if they do not fit: a host that asks faster than the wire can answer loses replies. */
void uart_send(const uint8_t *bytes, uint8_t n);

/* Sends nothing until uart_resume_sending, which is given what this returned. For an interrupt: the main loop, which
 * may send, does not run meanwhile. */
uint8_t uart_pause_sending(void);
void uart_resume_sending(uint8_t control);

#endif
