/* Which pin of the Uno is what. All outputs are inputs while the chip is in reset: pull-downs at the bridge hold it off.
 *
 *     A0  PC0  potentiometer              D2  PD2  encoder, channel A (INT0; ENCODER=1, instead of the potentiometer)
 *                                         D3  PD3  encoder, channel B (INT1; ENCODER=1)
 *                                         D4  PD4  e-stop, closed to ground; open stops
 *     A1  PC1  tachometer (TACHOMETER=1)  D5  PD5  end switch at falling counts, closed to ground (END_SWITCHES=1)
 *     A2  PC2  motor supply / 4           D6  PD6  end switch at rising counts, closed to ground (END_SWITCHES=1)
 *              (SUPPLY=1)                 D13 PB5  LED: lit while armed, blinks while a fault is latched
 *
 *     BRIDGE=PWM_DIR                      BRIDGE=IN1_IN2
 *     D9  PB1  PWM (OC1A)                 D9  PB1  IN1 (OC1A)
 *     D8  PB0  direction                  D10 PB2  IN2 (OC1B)
 *
 * Loop-back, on a bare board alone: D9 to A3 (PC3), D8 or D10 to A4 (PC4), D4 to A5 (PC5).
 */
#ifndef RIG_UNO_WIRING_H
#define RIG_UNO_WIRING_H

#include <avr/io.h>
#include <stdint.h>

#define BIT(n) ((uint8_t)(1u << (n)))

#define BOARD_ID RIG_BOARD_UNO

#define BRIDGE_PWM_DIR 1 /* as enum rig_bridge, for the preprocessor */
#define BRIDGE_IN1_IN2 2

#define PIN_DIRECTION BIT(PB0)
#define PIN_OC1A BIT(PB1)
#define PIN_OC1B BIT(PB2)
#define PIN_LED BIT(PB5)
#if RIG_BRIDGE == BRIDGE_PWM_DIR
#define OTHER 0u /* bit of port B */
#else
#define OTHER 2u
#endif

#define PIN_WIRE_A BIT(PC3)
#define PIN_WIRE_B BIT(PC4)
#define PIN_ESTOP_WIRE BIT(PC5)

#define PIN_ENCODER_A BIT(PD2)
#define PIN_ENCODER_B BIT(PD3)
#define PIN_ESTOP BIT(PD4)
#define PIN_END_LOW BIT(PD5)
#define PIN_END_HIGH BIT(PD6)

#define CONVERTS (!(RIG_ENCODER) || (RIG_TACHOMETER) || (RIG_SUPPLY)) /* anything for the converter to do */
#define CHANNEL_POSITION 0u
#define CHANNEL_TACHOMETER 1u
#define CHANNEL_SUPPLY 2u

/* One bit of a low port is one instruction, which no interrupt can split. */
static inline void set_bits(volatile uint8_t *port, uint8_t bits)
{
    *port = (uint8_t)(*port | bits);
}

static inline void clear_bits(volatile uint8_t *port, uint8_t bits)
{
    *port = (uint8_t)(*port & (uint8_t)~bits);
}

#endif
