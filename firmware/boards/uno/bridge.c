#include "bridge.h"

#include <stdbool.h>

#include "wiring.h"

/* Each of Timer1's outputs has a level of its own, OC1x: a pin shows it from the moment it is given to the timer, and only
 * a compare match changes it. So each drive begins at BOTTOM, in the middle of a pulse: whichever level is left over from
 * the drive before, the first match ends it in time. Why in this order: docs/firmware.md. */
#define RUNS BIT(CS10) /* no prescaler */
#define PWM BIT(WGM13) /* phase and frequency correct, top ICR1 */

/* An output that drives while the counter is below OCR1x. */
#if RIG_BRIDGE == BRIDGE_PWM_DIR

#define PINS ((uint8_t)(PIN_OC1A | PIN_DIRECTION))
#define HIGH_AT_REST 0u
#define OUTPUT_A BIT(COM1A1) /* high while it drives */

#elif RIG_BRIDGE == BRIDGE_IN1_IN2

/* Both inputs high short the motor; driving lets one of them go low for its share of the time. */
#define PINS ((uint8_t)(PIN_OC1A | PIN_OC1B))
#define HIGH_AT_REST PINS
#define OUTPUT_A ((uint8_t)(BIT(COM1A1) | BIT(COM1A0))) /* low while it drives */
#define OUTPUT_B ((uint8_t)(BIT(COM1B1) | BIT(COM1B0)))

#else
#error "RIG_BRIDGE must be BRIDGE_PWM_DIR or BRIDGE_IN1_IN2"
#endif

static inline void off(void)
{
    TCCR1A = 0; /* the pins' own level: 0 V at once */
    TCCR1B = 0; /* normal mode, and it stands still */
    TCNT1 = 0;
}

/* From off. */
static inline void start_pwm(uint8_t output, volatile uint16_t *compare, uint16_t size)
{
    *compare = size; /* in normal mode: in force at once */
    TCCR1B = PWM;
    *compare = size; /* now its buffer, which comes into force with the next period */
    ICR1 = BRIDGE_FULL;
    TCCR1A = output;
    TCCR1B = (uint8_t)(PWM | RUNS); /* last: a match before the pin shows it would be missed, and the pulse go on */
}

#if RIG_BRIDGE == BRIDGE_PWM_DIR

static inline void drive(uint16_t size, bool reverse)
{
    if (reverse) {
        set_bits(&PORTB, PIN_DIRECTION);
    } else {
        clear_bits(&PORTB, PIN_DIRECTION);
    }
    if (TCCR1A != 0u) {
        OCR1A = size; /* it drives already: in force from the next period on */
    } else {
        start_pwm(OUTPUT_A, &OCR1A, size);
    }
}

#else

static inline void drive_by(uint8_t output, volatile uint16_t *compare, uint16_t size)
{
    if (TCCR1A == output) {
        *compare = size; /* it drives already: in force from the next period on */
    } else {
        off();
        start_pwm(output, compare, size);
    }
}

static inline void drive(uint16_t size, bool reverse)
{
    if (reverse) {
        drive_by(OUTPUT_A, &OCR1A, size);
    } else {
        drive_by(OUTPUT_B, &OCR1B, size);
    }
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
