/* State machines of the PIO blocks, each of which watches pins by a program of its own, at the speed of the system clock. A
 * program tells a word each time that it comes round; nobody waits for it.
 */
#ifndef RIG_PICO_PIO_H
#define RIG_PICO_PIO_H

#include <stdbool.h>
#include <stdint.h>

/* Instructions (3.4). Those with `to` go to that address. */
#define PIO_JMP(to) (to)
#define PIO_JMP_X_DECREMENT(to) (0x0040u | (to)) /* if X is not 0; X falls by 1 in any case */
#define PIO_JMP_PIN(to) (0x00C0u | (to))         /* if the machine's pin is high */
#define PIO_IN_PINS(bits) (0x4000u | (bits))     /* into ISR from the right, the machine's pin first */
#define PIO_IN_Y(bits) (0x4040u | (bits))
#define PIO_PUSH 0x8000u /* ISR to the FIFO, unless that is full; then it is 0 */
#define PIO_MOV_X_NOT_X 0xA029u
#define PIO_MOV_Y_ISR 0xA046u
#define PIO_MOV_PC_ISR 0xA0A6u
#define PIO_MOV_ISR_X 0xA0C1u
#define PIO_IRQ(flag) (0xC000u | (flag)) /* raised until the processor lowers it */

typedef struct {
    uint32_t block; /* PIO0 or PIO1 */
    uint32_t number;
} pio_machine;

/* Into the block's memory, from an address on. */
void pio_load(uint32_t block, uint32_t at, const uint32_t *program, uint32_t length);

/* From address 0; after `last` comes `first`. */
void pio_start(pio_machine machine, uint32_t pin, uint32_t first, uint32_t last);

/* A word that the program has told since the call began; false if it tells none. */
bool pio_newest(pio_machine machine, uint32_t *word);

/* Whether a flag of PIO_IRQ has been raised since the last call. */
bool pio_take_flag(uint32_t block, uint32_t flag);

#endif
