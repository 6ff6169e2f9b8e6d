/* The converter: 12 bits in 2 us, one conversion at a time. */
#ifndef RIG_PICO_ADC_H
#define RIG_PICO_ADC_H

#include <stdbool.h>
#include <stdint.h>

#define ADC_MAX 4095u
#define ADC_SUPPLY_SHIFT 4 /* to 8 bits: behind a divider by 6 the 3.3 V are 20 V */

typedef struct {
    uint16_t counts; /* 0 is a rail: nothing arms before the first conversion */
    uint32_t t_us;   /* device time at which the sample was taken */
} adc_sample;

void adc_init(void);

/* Converts what is wired: the tick's. False: the converter does not answer, or says that it failed. */
bool adc_take_all(void);

/* Converts the position now; the tick must not come between. The last one where the converter does not answer. */
adc_sample adc_newest_sample(void);

/* What adc_take_all found; 0 before. */
adc_sample adc_tick_sample(void);
uint16_t adc_tachometer(void);
uint16_t adc_supply(void);

#endif
