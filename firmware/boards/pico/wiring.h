/* Which pin of the Pico is what. In reset all pins are inputs with the chip's own pull-down of some 50 kOhm; pull-downs at
 * the bridge hold it off for certain.
 *
 *     GP26 (31)  potentiometer, of 3V3           GP14 (19)  e-stop, closed to ground; open stops
 *     GP27 (32)  tachometer (TACHOMETER=1)       GP12 (16)  end switch at falling counts, closed to ground (END_SWITCHES=1)
 *     GP28 (34)  motor supply / 6 (SUPPLY=1)     GP13 (17)  end switch at rising counts, closed to ground (END_SWITCHES=1)
 *     GP0   (1)  serial port, to the adapter     GP25       LED: lit while armed, blinks while a fault is latched
 *     GP1   (2)  serial port, from the adapter   GP2, GP3 (4, 5)  encoder, channels A and B (ENCODER=1, instead of the
 *                                                potentiometer)
 *
 *     BRIDGE=PWM_DIR                             BRIDGE=IN1_IN2
 *     GP16 (21)  PWM (slice 0, A)                GP16 (21)  IN1 (slice 0, A)
 *     GP17 (22)  direction                       GP17 (22)  IN2 (slice 0, B)
 *
 * Loop-back, on a bare board alone: GP16 to GP18 (24), GP17 to GP19 (25), GP14 to GP15 (20).
 *
 * In brackets the numbers on the board. No pin takes more than 3.3 V.
 */
#ifndef RIG_PICO_WIRING_H
#define RIG_PICO_WIRING_H

#define BOARD_ID RIG_BOARD_PICO

#include "rp2040.h"

#define BRIDGE_PWM_DIR 1 /* as enum rig_bridge, for the preprocessor */
#define BRIDGE_IN1_IN2 2

#define PIN_TX 0u
#define PIN_RX 1u
#define PIN_ENCODER_A 2u
#define PIN_ENCODER_B 3u
#define PIN_END_LOW 12u
#define PIN_END_HIGH 13u
#define PIN_ESTOP 14u
#define PIN_ESTOP_WIRE 15u
#define PIN_PWM_A 16u
#define PIN_PWM_B 17u
#define PIN_WIRE_A 18u
#define PIN_WIRE_B 19u
#define PIN_QUIET_SUPPLY 23u /* high: the board's 3.3 V have less ripple, and the converter less noise */
#define PIN_LED 25u
#define PIN_POSITION 26u
#define PIN_TACHOMETER 27u
#define PIN_SUPPLY 28u

#define CHANNEL_POSITION 0u
#define CHANNEL_TACHOMETER 1u
#define CHANNEL_SUPPLY 2u

#define EDGES_OF_WIRES (BOTH_EDGES(PIN_WIRE_A - 16u) | BOTH_EDGES(PIN_WIRE_B - 16u))
#define CLOCK_HZ 125000000u

/* A pad that pulls up, for a contact or a line that is high at rest; one that drives; one that closes a contact; one that
 * only measures. */
#define PAD_CONTACT (PAD_INPUT | PAD_PULL_UP | PAD_SCHMITT)
#define PAD_OUTPUT (PAD_INPUT | PAD_PULL_DOWN | PAD_SCHMITT | PAD_4_MA)
#define PAD_WEAK (PAD_INPUT | PAD_SCHMITT | PAD_4_MA)
#define PAD_ANALOGUE PAD_OUTPUT_DISABLED

static inline void wire_pin(uint32_t pin, uint32_t pad, uint32_t control)
{
    REG(PADS_GPIO(pin)) = pad;
    REG(GPIO_CTRL(pin)) = control;
}

#endif
