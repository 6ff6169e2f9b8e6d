#include "board.h"

#include <stddef.h>

#include "adc.h"
#include "bridge.h"
#include "clock.h"
#include "encoder.h"
#include "inputs.h"
#include "loopback.h"
#include "uart.h"
#include "wiring.h"

#define CONVERTED ((RIG_TACHOMETER ? (uint8_t)RIG_FEATURE_TACHOMETER : 0u) | (RIG_SUPPLY ? (uint8_t)RIG_FEATURE_SUPPLY : 0u))
#if RIG_ENCODER
#define FEATURES (CONVERTED | (uint8_t)RIG_FEATURE_ENCODER)
#else
#define FEATURES CONVERTED
#endif

volatile bool in_tick;

static uint32_t micros(void *context)
{
    (void)context;
    return clock_us();
}

#if RIG_ENCODER

static int32_t position(void *context, uint32_t *t_us)
{
    (void)context;
    const encoder_sample sample = in_tick ? encoder_tick_sample() : encoder_newest_sample();
    *t_us = sample.t_us;
    return sample.counts;
}

static void set_position(void *context, int32_t counts)
{
    (void)context;
    encoder_set(counts);
}

static uint8_t encoder_troubles(void *context)
{
    (void)context;
    return encoder_take_troubles();
}

#else

static int32_t position(void *context, uint32_t *t_us)
{
    (void)context;
    const adc_sample sample = in_tick ? adc_tick_sample() : adc_newest_sample();
    *t_us = sample.t_us;
    return (int32_t)sample.counts;
}

#endif

static uint16_t tach_counts(void *context)
{
    (void)context;
    return RIG_TACHOMETER ? adc_tachometer() : (uint16_t)RIG_TACH_NONE;
}

static void transmit(void *context, const uint8_t *bytes, uint8_t n)
{
    (void)context;
    uart_send(bytes, n);
}

static uint8_t inputs(void *context)
{
    (void)context;
    return inputs_take();
}

static uint8_t supply(void *context)
{
    (void)context;
    return (uint8_t)(adc_supply() >> ADC_SUPPLY_SHIFT);
}

static void hold_tick(void *context)
{
    (void)context;
    clock_hold_tick();
}

static void release_tick(void *context)
{
    (void)context;
    clock_release_tick();
}

const rig_board BOARD = {
    .context = NULL,
    .micros = micros,
    .position = position,
    .tach_counts = tach_counts,
    .set_drive = board_set_drive,
    .transmit = transmit,
    .inputs = inputs,
    .build = RIG_BUILD,
    .counts_max = RIG_ENCODER ? 0 : (int32_t)ADC_MAX,
    .drive_full = BRIDGE_FULL,
    .board_id = BOARD_ID,
    .bridge = (uint8_t)RIG_BRIDGE,
    .features = FEATURES,
    .arrived_us = board_arrived_us,
    .supply = RIG_SUPPLY ? supply : NULL,
#if RIG_ENCODER
    .set_position = set_position,
    .encoder_troubles = encoder_troubles,
#endif
    .loopback = &LOOPBACK,
    .hold_tick = hold_tick,
    .release_tick = release_tick,
};
