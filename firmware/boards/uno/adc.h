/* The converter, by its interrupt: a round of conversions a millisecond, begun by the clock.
 *
 * The round's first conversion is the position, on a grid of exactly one tick: the control tick's. The others keep position (and tachometer and supply) fresh for whoever asks in between: never older than 0.35 ms.
 */
#ifndef RIG_UNO_ADC_H
#define RIG_UNO_ADC_H

#include <stdbool.h>
#include <stdint.h>

#define ADC_MAX 1023u
#define ADC_SUPPLY_SHIFT 2 /* to 8 bits: behind a divider by 4 the 5 V are 20 V */

void adc_init(void);

/* Interrupts masked. */
void adc_begin_round(void);

typedef struct {
    uint16_t counts;
    uint32_t t_us; /* device time at which the sample was taken */
} adc_sample;

/* The position on the tick's grid, and the newest one; 0 counts before the first. */
adc_sample adc_tick_sample(void);
adc_sample adc_newest_sample(void);

/* The newest reading; 0 before the first. */
uint16_t adc_tachometer(void);
uint16_t adc_supply(void);

/* Whether a round's first conversion has been done since the last call. */
bool adc_take_tick(void);

#endif
