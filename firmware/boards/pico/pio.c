#include "pio.h"

#include "rp2040.h"

#define PATIENCE 100u /* looks at the FIFO, some 8 us; a program comes round in a tenth of one */

void pio_load(uint32_t block, uint32_t at, const uint32_t *program, uint32_t length)
{
    for (uint32_t i = 0; i < length; i++) {
        REG(block + PIO_INSTR_MEM(at + i)) = program[i];
    }
}

void pio_start(pio_machine machine, uint32_t pin, uint32_t first, uint32_t last)
{
    const uint32_t block = machine.block;
    REG(block + PIO_SM_CLKDIV(machine.number)) = PIO_FULL_SPEED;
    REG(block + PIO_SM_EXECCTRL(machine.number)) = PIO_JMP_PIN_IS(pin) | PIO_WRAP(first, last);
    REG(block + PIO_SM_SHIFTCTRL(machine.number)) = PIO_SHIFT_LEFT;
    REG(block + PIO_SM_PINCTRL(machine.number)) = PIO_IN_BASE(pin);
    SET_BITS(block + PIO_CTRL, BIT(machine.number));
}

/* The FIFO keeps the oldest words: all that are there go, and the next one is new. */
bool pio_newest(pio_machine machine, uint32_t *word)
{
    const uint32_t fifo = machine.block + PIO_RXF(machine.number);
    const uint32_t empty = PIO_RXEMPTY(machine.number);
    uint32_t old = (REG(machine.block + PIO_FLEVEL) >> PIO_RX_LEVEL(machine.number)) & 0xFu;
    while (old > 0u) {
        (void)REG(fifo);
        old--;
    }
    uint32_t status = empty;
    for (uint32_t i = 0; i < PATIENCE && (status & empty) != 0u; i++) {
        status = REG(machine.block + PIO_FSTAT);
    }
    if ((status & empty) != 0u) {
        return false;
    }
    *word = REG(fifo);
    return true;
}

bool pio_take_flag(uint32_t block, uint32_t flag)
{
    const bool raised = (REG(block + PIO_IRQ_FLAGS) & BIT(flag)) != 0u;
    if (raised) {
        REG(block + PIO_IRQ_FLAGS) = BIT(flag);
    }
    return raised;
}
