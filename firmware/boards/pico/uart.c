#include "uart.h"

#include "clock.h"
#include "cpu.h"
#include "wiring.h"

/* In 64ths: 4.2 */
#define DIVISOR ((CLOCK_HZ / 16u * 64u + (RIG_BAUD) / 2u) / (RIG_BAUD))
#if DIVISOR < 64u || CLOCK_HZ / 16u * 64u / DIVISOR > (RIG_BAUD) + (RIG_BAUD) / 100u
#error "this baud rate cannot be made from 125 MHz to 1 %"
#endif

/* Without its FIFOs: the port has an interrupt for each byte, which therefore is known when it arrived (P3). With them the
 * last bytes of a frame would wait for 32 bit times. The interrupt has ten bit times to come. */
#define QUEUE 256u /* so that indices wrap by themselves; a relay's end sends two blocks of 66 bytes and a reply */

/* One side only writes `in`, the other only `out`, each a single byte: nothing to mask. */
typedef struct {
    volatile uint8_t in;
    volatile uint8_t out;
    volatile uint8_t byte[QUEUE];
} queue;

static queue received;
static queue to_send;
static volatile uint32_t received_in[QUEUE]; /* tick; a host that fills the wire has a byte wait */

void uart0_interrupt(void);

void uart_init(void)
{
    wire_pin(PIN_TX, PAD_OUTPUT, FUNCTION_UART);
    wire_pin(PIN_RX, PAD_CONTACT, FUNCTION_UART); /* pulled up: nothing is heard where nothing is plugged in */
    REG(UART0_IBRD) = DIVISOR >> 6;
    REG(UART0_FBRD) = DIVISOR & 63u;
    REG(UART0_LCR_H) = UART_LCR_H_8_BITS; /* after the divisor, which it brings into force */
    REG(UART0_CR) = UART_CR_UARTEN | UART_CR_TXE | UART_CR_RXE;
    REG(UART0_IMSC) = UART_RX | UART_TX;
    REG(NVIC_ISER) = BIT(IRQ_UART0);
}

/* The port asks for the next byte only after it has had one: the first of a frame is given to it unasked. */
static void send_next(void)
{
    const uint8_t out = to_send.out;
    if (out == to_send.in) {
        REG(UART0_ICR) = UART_TX;
    } else if ((REG(UART0_FR) & UART_FR_TXFF) == 0u) {
        REG(UART0_DR) = to_send.byte[out];
        to_send.out = (uint8_t)(out + 1u);
    } else {
        /* it asks when there is room */
    }
}

void uart0_interrupt(void)
{
    while ((REG(UART0_FR) & UART_FR_RXFE) == 0u) {
        const uint8_t byte = (uint8_t)REG(UART0_DR);
        const uint8_t next = (uint8_t)(received.in + 1u);
        if (next != received.out) { /* else it is lost, and the frame's CRC tells */
            received.byte[received.in] = byte;
            received_in[received.in] = clock_tick_us();
            received.in = next;
        }
    }
    send_next();
}

bool uart_has_byte(void)
{
    return received.in != received.out;
}

bool uart_take(uint8_t *byte, uint32_t *tick_us)
{
    const uint8_t out = received.out;
    if (out == received.in) {
        return false;
    }
    *byte = received.byte[out];
    *tick_us = received_in[out];
    received.out = (uint8_t)(out + 1u);
    return true;
}

void uart_send(const uint8_t *bytes, uint8_t n)
{
    uint8_t in = to_send.in;
    const uint8_t room = (uint8_t)(to_send.out - (unsigned)in - 1u);
    if (n == 0u || n > room) {
        return;
    }
    for (uint8_t i = 0; i < n; i++) {
        to_send.byte[in] = bytes[i];
        in++;
    }
    to_send.in = in; /* whole frames only */
    REG(NVIC_ICER) = BIT(IRQ_UART0);
    cpu_barrier();
    send_next();
    REG(NVIC_ISER) = BIT(IRQ_UART0);
}
