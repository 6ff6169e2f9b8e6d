/* Timer1 by the rules of its data sheet (section 16), edge by edge, as far as a bridge needs it: normal mode, and PWM of
 * correct phase and frequency with ICR1 as TOP, both without prescaler. Where the data sheet leaves something open it is
 * taken the worse way. Neither emulator of the chip knows all of these rules by itself:
 *   - ICR1 can be written only in a mode that has it as TOP; with a TOP of 0 the counter stands still;
 *   - OCR1x is double buffered in PWM, and its buffer comes into force at BOTTOM; that a write in normal mode reaches the
 *     buffer, too, is not said: it does not here;
 *   - an output's level OC1x is kept while no pin shows it, and only a match changes it;
 *   - the high bytes of all 16-bit registers share one temporary one.
 */
#ifndef RIG_TIMER1_H
#define RIG_TIMER1_H

#include <stdbool.h>
#include <stdint.h>

/* Addresses in data space. */
enum {
    TCCR1A = 0x80, TCCR1B = 0x81, TCNT1L = 0x84, TCNT1H = 0x85, ICR1L = 0x86, ICR1H = 0x87,
    OCR1AL = 0x88, OCR1AH = 0x89, OCR1BL = 0x8A, OCR1BH = 0x8B
};

typedef struct timer1 timer1;
struct timer1 {
    /* An output's level changed at `cycle`, which `at` says. */
    void (*changed)(void *context);
    /* It passes over so many cycles, whole periods that are all alike. */
    void (*skips)(void *context, uint64_t cycles);
    void *context;
    uint64_t at; /* cycle that it has been advanced to */
    uint8_t mode, clock, temporary, temporary_of, periods;
    uint8_t output[2]; /* COM1A, COM1B */
    bool level[2];     /* OC1A, OC1B */
    bool down;
    uint16_t count, top, compare[2], buffer[2];
};

void timer1_reset(timer1 *t, uint64_t cycle);

/* Everything that happens before `cycle`. */
void timer1_advance(timer1 *t, uint64_t cycle);

/* The next cycle at which an output may change; UINT64_MAX: none, while it stands still. */
uint64_t timer1_next(const timer1 *t);

/* A byte written at `cycle`. NULL, or the rule that it breaks. */
const char *timer1_write(timer1 *t, uint64_t cycle, uint16_t address, uint8_t value);

/* Whether the pin shows the timer's output, 0 or 1, and not the port. */
bool timer1_has_pin(const timer1 *t, unsigned output);

/* Whether it is in a PWM mode and stands still: a pulse has not begun, or does not end. */
bool timer1_stands(const timer1 *t);

/* Share of the time for which that output is high, from the next period on. */
double timer1_share(const timer1 *t, unsigned output);

#endif
