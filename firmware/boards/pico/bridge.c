#include "bridge.h"

#include <stdbool.h>

#include "wiring.h"

/* The slice counts all the time. At rest the pins have the level of SIO; a zero gives them back to it, at once. What the
 * slice is compared with comes into force as the counter wraps to 0 (4.5.2.3): so a drive that begins has it wrap, and only
 * then the pin shows it. Else the pin might show the rest of a drive before. */
#define TOP (BRIDGE_FULL - 1u)
#define PINS (BIT(PIN_PWM_A) | BIT(PIN_PWM_B))

#if RIG_BRIDGE == BRIDGE_PWM_DIR

#define HIGH_AT_REST 0u
#define DRIVES FUNCTION_PWM

#elif RIG_BRIDGE == BRIDGE_IN1_IN2

/* Both inputs high short the motor; driving lets one of them go low for its share of the time. */
#define HIGH_AT_REST PINS
#define DRIVES (FUNCTION_PWM | OUTPUT_INVERTED)

#else
#error "RIG_BRIDGE must be BRIDGE_PWM_DIR or BRIDGE_IN1_IN2"
#endif

static uint32_t driving; /* the pin that drives; 0: none */

static inline void off(void)
{
    REG(GPIO_CTRL(PIN_PWM_A)) = FUNCTION_SIO;
    REG(GPIO_CTRL(PIN_PWM_B)) = FUNCTION_SIO;
    REG(PWM_CH0_CC) = 0;
    driving = 0;
}

static inline void drive_by(uint32_t pin, uint32_t compare)
{
    REG(PWM_CH0_CC) = compare;
    if (driving != pin) { /* else in force from the next period on */
        REG(PWM_CH0_CTR) = TOP;
        REG(GPIO_CTRL(pin)) = DRIVES; /* cycles later: the counter has wrapped */
        driving = pin;
    }
}

#if RIG_BRIDGE == BRIDGE_PWM_DIR

static inline void drive(uint32_t size, bool reverse)
{
    REG(reverse ? SIO_GPIO_OUT_SET : SIO_GPIO_OUT_CLR) = BIT(PIN_PWM_B);
    drive_by(PIN_PWM_A, size);
}

#else

static inline void drive(uint32_t size, bool reverse)
{
    uint32_t pin = PIN_PWM_B;
    if (reverse) {
        pin = PIN_PWM_A;
    }
    if (driving != pin) {
        off();
    }
    drive_by(pin, reverse ? size : size << 16);
}

#endif

void bridge_init(void)
{
    REG(PWM_CH0_TOP) = TOP;
    REG(PWM_CH0_CC) = 0;
    REG(PWM_CH0_CSR) = PWM_EN;
    REG(SIO_GPIO_OUT_CLR) = PINS;
    REG(SIO_GPIO_OE_SET) = PINS;
    wire_pin(PIN_PWM_A, PAD_OUTPUT, FUNCTION_SIO); /* low, as the pull-downs have held it until here */
    wire_pin(PIN_PWM_B, PAD_OUTPUT, FUNCTION_SIO);
    REG(SIO_GPIO_OUT_SET) = HIGH_AT_REST; /* both in one step: one alone would be full drive */
    driving = 0;
}

void bridge_drive(int16_t units)
{
    if (units == 0) {
        off();
    } else {
        drive((uint32_t)(units < 0 ? -units : units), units < 0);
    }
}
