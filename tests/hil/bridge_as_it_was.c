#include "bridge.h"

#include <stdbool.h>

#include "wiring.h"

#define PWM_ON_OC1A BIT(COM1A1) /* high while the counter is below OCR1A */
#define PWM_ON_OC1B BIT(COM1B1)

#if RIG_BRIDGE == BRIDGE_PWM_DIR

#define PINS ((uint8_t)(PIN_OC1A | PIN_DIRECTION))

static void off(void)
{
    TCCR1A = 0; /* PWM low: the pin's own level */
    OCR1A = 0;
}

static void on(uint16_t size, bool reverse)
{
    if (reverse != ((PORTB & PIN_DIRECTION) != 0u)) {
        TCCR1A = 0; /* the direction turns while the bridge is off */
        if (reverse) {
            set_bits(&PORTB, PIN_DIRECTION);
        } else {
            clear_bits(&PORTB, PIN_DIRECTION);
        }
    }
    OCR1A = size;
    TCCR1A = PWM_ON_OC1A;
}

#elif RIG_BRIDGE == BRIDGE_IN1_IN2

#define PINS ((uint8_t)(PIN_OC1A | PIN_OC1B))

/* Both inputs high short the motor; driving lets one of them go low for its share of the time. */
static void off(void)
{
    set_bits(&PORTB, PINS);
    TCCR1A = 0;
}

static void on(uint16_t size, bool reverse)
{
    if (reverse) {
        OCR1A = (uint16_t)(BRIDGE_FULL - size);
        TCCR1A = PWM_ON_OC1A;
    } else {
        OCR1B = (uint16_t)(BRIDGE_FULL - size);
        TCCR1A = PWM_ON_OC1B;
    }
}

#else
#error "RIG_BRIDGE must be BRIDGE_PWM_DIR or BRIDGE_IN1_IN2"
#endif

void bridge_init(void)
{
    off();
    ICR1 = BRIDGE_FULL;
    TCCR1B = (uint8_t)(BIT(WGM13) | BIT(CS10)); /* phase and frequency correct, top ICR1, no prescaler */
    set_bits(&DDRB, PINS);
}

void bridge_drive(int16_t units)
{
    if (units == 0) {
        off();
    } else {
        on((uint16_t)(units < 0 ? -units : units), units < 0);
    }
}
