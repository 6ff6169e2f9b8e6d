/* The Uno's chip, emulated to the register by libsimavr, with the same exact bench around it as the host board's: in
 * lock step, in virtual time, as a shared library (librig_chip.so; tools/emulated_chips/virtual_chip.py); in real time
 * main.c is a process around it. It runs the very .hex that is flashed. The functions named as in boards/host/virtual.c
 * do the same.
 *
 * For tests only: libsimavr is under the GPL 3, so nothing of this is part of what is installed.
 */
#ifndef RIG_CHIP_H
#define RIG_CHIP_H

#include <stdint.h>

typedef struct virtual_board virtual_board;

/* What a test may look at besides the wire. */
typedef struct {
    double t_s, pin_V, motor_V, y_rad, v_rad_per_s, pin_changed_s;
    /* The shares, masked_us and tick_us are 0 unless it measures. Shares are the most of any millisecond; timed: of
     * clock, tick, converter and contacts, without the serial port; tick_us: of the tick, without the interrupts that
     * come between. The order is that of tools/emulated_chips/truth.py. */
    double awake_share, masked_us, tick_us;
    int32_t led, resets, overruns;
    double interrupt_share, timed_share;
    int32_t crashed, stack_bytes;
} virtual_view;

enum virtual_hang { HANG_MAIN, HANG_ALL, HANG_CLOCK, HANG_CONVERTER, HANG_TICK };
enum virtual_stall { STALL_NONE, STALL_MAIN, STALL_TICK };

virtual_board *virtual_new(void);
void virtual_free(virtual_board *b);

/* As of the bench, and: hex (path), bridge (pwm_dir, in1_in2), dead-time-s, measure (0, 1), bare (no bench, but
 * the wires of a loop-back: 1 of PWM or IN1, 2 of direction or IN2, 4 of the e-stop). NULL, or what is wrong. */
const char *virtual_option(virtual_board *b, const char *name, const char *value);

/* Powers the chip on at time 0; a byte takes the host `byte_ns`. NULL, or what is wrong. */
const char *virtual_start(virtual_board *b, int64_t byte_ns);

/* Runs to `until_ns`, or to what arrives at the host if that is sooner: `until` 1: the next byte; 2: the end of a frame. */
void virtual_run(virtual_board *b, int64_t until_ns, int32_t until);
int64_t virtual_now_ns(const virtual_board *b);

/* The host sends bytes from now on. Returns how many the wire took. */
uint32_t virtual_write(virtual_board *b, const uint8_t *bytes, uint32_t n);

/* Bytes that have arrived at the host by now. */
uint32_t virtual_read(virtual_board *b, uint8_t *bytes, uint32_t n);

void virtual_look(const virtual_board *b, virtual_view *view);

/* Longest time for which the main loop has held back the tick, with the interrupts that came between; 0 unless it
 * measures. */
double virtual_held_us(const virtual_board *b);

/* The first rule of the data sheet for writing registers that the program has broken, in words; "": none so far. */
const char *virtual_broken_rule(const virtual_board *b);

/* Longest time for which the bridge has conducted without a break, since the last call. */
double virtual_longest_pulse_s(virtual_board *b);

/* A reset by anything but the watchdog, which needs no help; then `boot_s` in the boot loader, where pins float. */
void virtual_boot(virtual_board *b, uint8_t cause, double boot_s);

/* Opens or closes a contact at a pin of port D. */
void virtual_contact(virtual_board *b, int32_t pin, int32_t is_open);

/* The main loop stops, with interrupts or without, or an interrupt that it lives by. 0 if that cannot be done. */
int32_t virtual_hang(virtual_board *b, int32_t how);

/* The main loop's next round, or the next tick, takes so much longer; interrupts go on. 0 if that cannot be done. */
int32_t virtual_stall(virtual_board *b, int32_t what, int64_t ns);

/* Wiring faults from now on. NULL, or what is wrong with the names. */
const char *virtual_rewire(virtual_board *b, const char *drive, const char *sensor);

/* Puts the shaft somewhere, as a hand would. */
void virtual_place(virtual_board *b, double y_rad, double v_rad_per_s);

#endif
