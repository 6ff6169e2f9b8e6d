/* Runs an exported controller over the ticks of ticks.h, and gives out each drive as the bytes of a double: on a host to
 * its output, on an AVR (whose double has four bytes) to the register GPIOR0. GPIOR1 is 1 while a tick is computed. */
#include "rig_controller.h"
#include "rig_motor.h"

#include "ticks.h" /* TICKS, and TICK[][4]: reading, and reference: position, velocity, acceleration */

#include <string.h>

#ifdef __AVR__
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>

static void give(const unsigned char *bytes, unsigned n)
{
    for (unsigned i = 0; i < n; i++) {
        GPIOR0 = bytes[i];
    }
}

static void computing(unsigned char is)
{
    GPIOR1 = is;
}
#else
#include <stdio.h>

static void give(const unsigned char *bytes, unsigned n)
{
    (void)fwrite(bytes, 1, n, stdout);
}

static void computing(unsigned char is)
{
    (void)is;
}
#endif

static double number(int tick, int column)
{
#ifdef __AVR__
    return pgm_read_float(&TICK[tick][column]);
#else
    return TICK[tick][column];
#endif
}

int main(void)
{
    static rig_controller c;
    if (!rig_controller_start(&c, RIG_MOTOR_PERIOD_S)) {
        return 1;
    }
    for (int i = 0; i < TICKS; i++) {
        const rig_reference to = {number(i, 1), number(i, 2), number(i, 3)};
        const double reading = number(i, 0);
        computing(1);
        const double u = rig_controller_step(&c, reading, &to);
        computing(0);
        unsigned char bytes[sizeof u];
        memcpy(bytes, &u, sizeof u);
        give(bytes, sizeof u);
    }
#ifdef __AVR__
    cli();
    sleep_enable();
    sleep_cpu();
#endif
    return 0;
}
