#include "bridge.h"

#include <stdbool.h>

#include "wiring.h"

/* The slice counts all the time. A zero takes it off the pins, which are told what to show instead, at once. What it is
 * compared with comes into force as the counter wraps to 0 (4.5.2.3): so a drive that begins has it wrap, and only then
 * the pin shows it. Else the pin might show the rest of a drive before. */
#define TOP (BRIDGE_FULL - 1u)

/* A pin's control at rest and while it drives. */
#if RIG_BRIDGE == BRIDGE_PWM_DIR

#define A_AT_REST (FUNCTION_PWM | OUTPUT_LOW)
#define A_DRIVES FUNCTION_PWM
#define B_AT_REST FUNCTION_SIO /* the direction */

#elif RIG_BRIDGE == BRIDGE_IN1_IN2

/* Both inputs high short the motor; driving lets one of them go low for its share of the time. */
#define A_AT_REST (FUNCTION_PWM | OUTPUT_HIGH)
#define A_DRIVES (FUNCTION_PWM | OUTPUT_INVERTED)
#define B_AT_REST A_AT_REST
#define B_DRIVES A_DRIVES

#else
#error "RIG_BRIDGE must be BRIDGE_PWM_DIR or BRIDGE_IN1_IN2"
#endif

static uint32_t driving; /* the pin that drives; 0: none */

static inline void off(void)
{
    REG(GPIO_CTRL(PIN_PWM_A)) = A_AT_REST;
    REG(GPIO_CTRL(PIN_PWM_B)) = B_AT_REST;
    REG(PWM_CH0_CC) = 0;
    driving = 0;
}

static inline void drive_by(uint32_t pin, uint32_t control, uint32_t compare)
{
    REG(PWM_CH0_CC) = compare;
    if (driving != pin) { /* else in force from the next period on */
        REG(PWM_CH0_CTR) = TOP;
        REG(GPIO_CTRL(pin)) = control; /* cycles later: the counter has wrapped */
        driving = pin;
    }
}

#if RIG_BRIDGE == BRIDGE_PWM_DIR

static inline void drive(uint32_t size, bool reverse)
{
    REG(reverse ? SIO_GPIO_OUT_SET : SIO_GPIO_OUT_CLR) = BIT(PIN_PWM_B);
    drive_by(PIN_PWM_A, A_DRIVES, size);
}

static inline void init_direction(void)
{
    REG(SIO_GPIO_OUT_CLR) = BIT(PIN_PWM_B);
    REG(SIO_GPIO_OE_SET) = BIT(PIN_PWM_B);
}

#else

static inline void drive(uint32_t size, bool reverse)
{
    const uint32_t pin = reverse ? PIN_PWM_A : PIN_PWM_B;
    if (driving != pin) {
        off();
    }
    drive_by(pin, reverse ? A_DRIVES : B_DRIVES, reverse ? size : size << 16);
}

static inline void init_direction(void)
{
}

#endif

void bridge_init(void)
{
    REG(PWM_CH0_TOP) = TOP;
    REG(PWM_CH0_CC) = 0;
    REG(PWM_CH0_CSR) = PWM_EN;
    init_direction();
    wire_pin(PIN_PWM_A, PAD_OUTPUT, A_AT_REST); /* last: until here pull-downs hold the bridge off */
    wire_pin(PIN_PWM_B, PAD_OUTPUT, B_AT_REST);
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
