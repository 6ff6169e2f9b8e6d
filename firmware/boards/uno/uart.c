#include "uart.h"

#include <avr/interrupt.h>

#include "clock.h"
#include "wiring.h"

#define DIVISOR (((F_CPU) / 8u + (RIG_BAUD) / 2u) / (RIG_BAUD)) /* at double speed: 8 clocks a bit */
#if (F_CPU) / 8u * 1000u / DIVISOR > (RIG_BAUD) * 1025UL || (F_CPU) / 8u * 1000u / DIVISOR < (RIG_BAUD) * 975UL
#error "this baud rate cannot be made from 16 MHz to 2.5 %: take 115200 or 1000000"
#endif

#define QUIET ((uint8_t)(BIT(RXCIE0) | BIT(RXEN0) | BIT(TXEN0))) /* receives, and sends nothing */

#define QUEUE 256u /* so that indices wrap by themselves; a relay's end sends two blocks of 66 bytes and a reply */

/* One side only writes `in`, the other only `out`, each a single byte: nothing to mask. */
typedef struct {
    volatile uint8_t in;
    volatile uint8_t out;
    volatile uint8_t byte[QUEUE];
} queue;

static queue received;
static queue to_send;
static volatile uint8_t received_in[QUEUE]; /* tick; a host that fills the wire has a byte wait for up to 4 ms */

void uart_init(void)
{
    const uint16_t divisor = DIVISOR - 1u;
    UCSR0B = 0; /* a boot loader that jumps here has left it on; what it has received is forgotten */
    UCSR0A = BIT(U2X0);
    UBRR0H = (uint8_t)(divisor >> 8);
    UBRR0L = (uint8_t)(divisor & 0xFFu);
    UCSR0C = (uint8_t)(BIT(UCSZ01) | BIT(UCSZ00)); /* 8 bits, no parity, 1 stop bit */
    UCSR0B = QUIET;
}

ISR(USART_RX_vect)
{
    const uint8_t byte = UDR0;
    const uint8_t next = (uint8_t)(received.in + 1u);
    if (next != received.out) { /* else it is lost, and the frame's CRC tells */
        received.byte[received.in] = byte;
        received_in[received.in] = clock_tick();
        received.in = next;
    }
}

bool uart_has_byte(void)
{
    return received.in != received.out;
}

bool uart_take(uint8_t *byte, uint8_t *tick)
{
    const uint8_t out = received.out;
    if (out == received.in) {
        return false;
    }
    *byte = received.byte[out];
    *tick = received_in[out];
    received.out = (uint8_t)(out + 1u);
    return true;
}

ISR(USART_UDRE_vect)
{
    const uint8_t out = to_send.out;
    UDR0 = to_send.byte[out];
    const uint8_t next = (uint8_t)(out + 1u);
    to_send.out = next;
    if (next == to_send.in) {
        UCSR0B = QUIET;
    }
}

void uart_send(const uint8_t *bytes, uint8_t n)
{
    uint8_t in = to_send.in;
    const uint8_t free = (uint8_t)(to_send.out - (unsigned)in - 1u);
    if (n == 0u || n > free) {
        return;
    }
    for (uint8_t i = 0; i < n; i++) {
        to_send.byte[in] = bytes[i];
        in++;
    }
    to_send.in = in; /* whole frames only */
    UCSR0B = (uint8_t)(QUIET | BIT(UDRIE0));
}

uint8_t uart_pause_sending(void)
{
    const uint8_t control = UCSR0B;
    UCSR0B = QUIET;
    return control;
}

void uart_resume_sending(uint8_t control)
{
    UCSR0B = control;
}
