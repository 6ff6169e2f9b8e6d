#include "adc.h"

#include "clock.h"
#include "wiring.h"

#define PATIENCE 100u /* looks at the converter, some 8 us; a conversion takes 2 */

static adc_sample newest;
static volatile uint16_t tachometer;
static volatile uint16_t motor_supply;

static bool convert(uint32_t channel, uint16_t *counts)
{
    REG(ADC_CS) = ADC_EN | ADC_AINSEL(channel) | ADC_START_ONE;
    uint32_t status = 0;
    for (uint32_t i = 0; i < PATIENCE && (status & ADC_READY) == 0u; i++) {
        status = REG(ADC_CS);
    }
    if ((status & ADC_READY) == 0u || (status & ADC_ERR) != 0u) {
        return false;
    }
    *counts = (uint16_t)REG(ADC_RESULT);
    return true;
}

static bool take_position(void)
{
    adc_sample fresh;
    fresh.t_us = clock_us();
    if (!convert(CHANNEL_POSITION, &fresh.counts)) {
        return false;
    }
    newest = fresh;
    return true;
}

void adc_init(void)
{
    REG(PADS_GPIO(PIN_POSITION)) = PAD_ANALOGUE;
    REG(PADS_GPIO(PIN_TACHOMETER)) = PAD_ANALOGUE;
    REG(PADS_GPIO(PIN_SUPPLY)) = PAD_ANALOGUE;
    REG(ADC_CS) = ADC_EN;
    while ((REG(ADC_CS) & ADC_READY) == 0u) {
    }
}

bool adc_take_all(void)
{
    uint16_t counts = 0;
    if (!RIG_ENCODER && !take_position()) {
        return false;
    }
    if (RIG_TACHOMETER) {
        if (!convert(CHANNEL_TACHOMETER, &counts)) {
            return false;
        }
        tachometer = counts;
    }
    if (RIG_SUPPLY) {
        if (!convert(CHANNEL_SUPPLY, &counts)) {
            return false;
        }
        motor_supply = counts;
    }
    return true;
}

adc_sample adc_newest_sample(void)
{
    (void)take_position();
    return newest;
}

adc_sample adc_tick_sample(void)
{
    return newest;
}

uint16_t adc_tachometer(void)
{
    return tachometer;
}

uint16_t adc_supply(void)
{
    return motor_supply;
}
