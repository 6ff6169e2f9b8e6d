#include "inputs.h"

#include <avr/interrupt.h>
#include <util/atomic.h>

#include "bridge.h"
#include "rig_core.h"
#include "wiring.h"

static volatile bool stopped;

static bool estop_is_open(void)
{
    return (PIND & PIN_ESTOP) != 0u;
}

void inputs_init(void)
{
    set_bits(&PORTD, (uint8_t)(PIN_ESTOP | (RIG_END_SWITCHES ? PIN_END_LOW | PIN_END_HIGH : 0u))); /* pull-ups */
    PCMSK2 = BIT(PCINT20);
    PCICR = BIT(PCIE2);
}

/* The core latches the fault in its next tick; the bridge does not wait for that. */
ISR(PCINT2_vect)
{
    if (estop_is_open()) {
        bridge_drive(0);
        stopped = true;
    }
}

bool inputs_have_stopped(void)
{
    return stopped;
}

uint8_t inputs_take(void)
{
    uint8_t bits = 0;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        if (stopped || estop_is_open()) {
            bits = RIG_INPUT_ESTOP;
        }
        stopped = estop_is_open();
    }
#if RIG_END_SWITCHES
    const uint8_t pins = PIND;
    if ((pins & PIN_END_LOW) != 0u) {
        bits |= (uint8_t)RIG_INPUT_END_LOW;
    }
    if ((pins & PIN_END_HIGH) != 0u) {
        bits |= (uint8_t)RIG_INPUT_END_HIGH;
    }
#endif
    return bits;
}
