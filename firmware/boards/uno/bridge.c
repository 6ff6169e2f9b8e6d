#include "bridge.h"

#include <stdbool.h>

#include "wiring.h"

#define BRIDGE_PWM_DIR 1
#define BRIDGE_IN1_IN2 2

/* Each of Timer1's outputs has a level of its own, OC1x: a pin shows it from the moment it is given to the timer, and only
 * a compare match changes it. So at 0 units the timer stands still in normal mode with both at the level of no drive, and
 * each drive begins from there: no pulse is left over from the one before. Why in this order: docs/firmware.md. */
#define RUNS BIT(CS10)  /* no prescaler */
#define PWM BIT(WGM13)  /* phase and frequency correct, top ICR1 */
#define ON_OC1A BIT(COM1A1) /* high while the counter is below OCR1A */
#define ON_OC1B BIT(COM1B1)

#if RIG_BRIDGE == BRIDGE_PWM_DIR

#define PINS ((uint8_t)(PIN_OC1A | PIN_DIRECTION))
#define HIGH_AT_REST 0u
#define MATCH_RESTS ON_OC1A /* in normal mode a match sets it low */
#define FORCE_MATCH BIT(FOC1A)

#elif RIG_BRIDGE == BRIDGE_IN1_IN2

/* Both inputs high short the motor; driving lets one of them go low for its share of the time. */
#define PINS ((uint8_t)(PIN_OC1A | PIN_OC1B))
#define HIGH_AT_REST PINS
#define MATCH_RESTS ((uint8_t)(BIT(COM1A1) | BIT(COM1A0) | BIT(COM1B1) | BIT(COM1B0))) /* sets them high */
#define FORCE_MATCH ((uint8_t)(BIT(FOC1A) | BIT(FOC1B)))

#else
#error "RIG_BRIDGE must be BRIDGE_PWM_DIR or BRIDGE_IN1_IN2"
#endif

static void off(void)
{
    TCCR1B = RUNS; /* normal mode, in which a match can be forced */
    TCCR1A = MATCH_RESTS;
    TCCR1C = FORCE_MATCH; /* 0 V from here */
    TCCR1A = 0;           /* the pins' own level, the same */
    TCCR1B = 0;
    TCNT1 = 0;
}

static void set_compare(uint16_t counts)
{
    OCR1A = counts;
    OCR1B = counts;
}

static void on(uint8_t output, uint16_t counts)
{
    if (TCCR1A == output) {
        set_compare(counts); /* it drives already: in force from the next period on */
        return;
    }
    if (TCCR1A != 0u) {
        off(); /* the other output drives */
    }
    set_compare(counts); /* in normal mode: in force at once */
    TCCR1B = PWM;
    set_compare(counts); /* now their buffers, which come into force with the next period */
    ICR1 = BRIDGE_FULL;
    TCCR1B = (uint8_t)(PWM | RUNS);
    TCCR1A = output;
}

#if RIG_BRIDGE == BRIDGE_PWM_DIR

static void drive(uint16_t size, bool reverse)
{
    if (reverse != ((PORTB & PIN_DIRECTION) != 0u)) {
        off(); /* the direction turns while the bridge is off */
        if (reverse) {
            set_bits(&PORTB, PIN_DIRECTION);
        } else {
            clear_bits(&PORTB, PIN_DIRECTION);
        }
    }
    on(ON_OC1A, size);
}

#else

static void drive(uint16_t size, bool reverse)
{
    on(reverse ? ON_OC1A : ON_OC1B, (uint16_t)(BRIDGE_FULL - size));
}

#endif

void bridge_init(void)
{
    off();
    set_bits(&PORTB, HIGH_AT_REST);
    set_bits(&DDRB, PINS); /* last: until here pull-downs hold the bridge off */
}

void bridge_drive(int16_t units)
{
    if (units == 0) {
        off();
    } else {
        drive((uint16_t)(units < 0 ? -units : units), units < 0);
    }
}
