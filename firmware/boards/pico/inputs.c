#include "inputs.h"

#include "bridge.h"
#include "cpu.h"
#include "loopback.h"
#include "rig_core.h"
#include "wiring.h"

static volatile bool stopped;

void io_bank0_interrupt(void);

static bool is_open(uint32_t pin)
{
    return (REG(SIO_GPIO_IN) & BIT(pin)) != 0u;
}

void inputs_init(void)
{
    wire_pin(PIN_ESTOP, PAD_CONTACT, FUNCTION_SIO);
    if (RIG_END_SWITCHES) {
        wire_pin(PIN_END_LOW, PAD_CONTACT, FUNCTION_SIO);
        wire_pin(PIN_END_HIGH, PAD_CONTACT, FUNCTION_SIO);
    }
    REG(IO_PROC0_INTE1) = EDGE_HIGH(PIN_ESTOP);
    REG(NVIC_IPR3) = SECOND_OF_IO_BANK0; /* edges that storm in do not keep received bytes waiting */
    REG(NVIC_ISER) = BIT(IRQ_IO_BANK0);
}

/* The core latches the fault in its next tick; the bridge does not wait for that. The edge is kept by the chip: it counts
 * even if the contact is closed again. */
void io_bank0_interrupt(void)
{
    if ((REG(IO_PROC0_INTS1) & EDGE_HIGH(PIN_ESTOP)) != 0u) {
        REG(IO_INTR1) = EDGE_HIGH(PIN_ESTOP);
        bridge_drive(0);
        stopped = true;
    }
    if (REG(IO_PROC0_INTS2) != 0u) {
        loopback_take_edge();
    }
}

bool inputs_have_stopped(void)
{
    return stopped;
}

uint8_t inputs_take(void)
{
    uint8_t bits = 0;
    const uint32_t before = cpu_hold_interrupts();
    const bool open = is_open(PIN_ESTOP);
    if (stopped || open) {
        bits = (uint8_t)RIG_INPUT_ESTOP;
    }
    stopped = open;
    cpu_restore_interrupts(before);
    if (RIG_END_SWITCHES) {
        bits |= (uint8_t)((is_open(PIN_END_LOW) ? (unsigned)RIG_INPUT_END_LOW : 0u) |
                          (is_open(PIN_END_HIGH) ? (unsigned)RIG_INPUT_END_HIGH : 0u));
    }
    return bits;
}
