/* From boot2 to the main function: the program is copied to memory, and runs there. */
#include <stddef.h>
#include <stdint.h>

#include "rp2040.h"

typedef void (*handler)(void);

/* Made by the linker (pico.ld). */
extern uint32_t _stack_top;
extern uint32_t _program;
extern uint32_t _program_end;
extern const uint32_t _program_in_flash;
extern uint32_t _bss;
extern uint32_t _bss_end;

int main(void);
void start(void);
void hang(void);
void timer_0_interrupt(void);
void io_bank0_interrupt(void);
void uart0_interrupt(void);
void *memcpy(void *to, const void *from, size_t n);
void *memset(void *to, int value, size_t n);

/* A fault of the processor ends here; the hardware watchdog resets the chip. */
void hang(void)
{
    for (;;) {
    }
}

/* In flash, before the program is in memory. volatile: the compiler makes no call to memcpy of it, which is not there yet. */
__attribute__((section(".start"), noreturn)) void start(void)
{
    const volatile uint32_t *from = &_program_in_flash;
    volatile uint32_t *to = &_program;
    while (to != &_program_end) {
        *to = *from;
        to++;
        from++;
    }
    to = &_bss;
    while (to != &_bss_end) {
        *to = 0;
        to++;
    }
    REG(VTOR) = (uint32_t)&_program;
    int (*const program)(void) = main; /* by its address: memory is far from flash */
    (void)program();
    for (;;) {
    }
}

/* What boot2 starts by, and what the processor has from then on. */
__attribute__((section(".start_vectors"), used)) static const handler START[2] = {(handler)&_stack_top, start};

__attribute__((section(".vectors"), used, aligned(256))) static const handler VECTORS[16u + IRQS] = {
    [0] = (handler)&_stack_top,
    [1] = start,
    [2] = hang,
    [3] = hang,
    [16u + IRQ_TIMER_0] = timer_0_interrupt,
    [16u + IRQ_IO_BANK0] = io_bank0_interrupt,
    [16u + IRQ_UART0] = uart0_interrupt,
};

/* The compiler calls these two for copies and zeros; there is no C library. */
void *memcpy(void *to, const void *from, size_t n)
{
    uint8_t *out = to;
    const uint8_t *in = from;
    for (size_t i = 0; i < n; i++) {
        out[i] = in[i];
    }
    return to;
}

void *memset(void *to, int value, size_t n)
{
    uint8_t *out = to;
    for (size_t i = 0; i < n; i++) {
        out[i] = (uint8_t)value;
    }
    return to;
}
