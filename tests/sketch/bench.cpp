/* Runs a sketch on this machine, in virtual time, on the emulated bench's motor with an encoder of 1440 counts a turn.
 * What the sketch prints goes to stdout. Arguments: tau_s, K_rad_s_V, fc_V, supply_V, swapped (1: encoder's wires).
 * Each micros() takes 4 us. PWM is its mean: IN1 less IN2.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

extern "C" {
#include "bench.h"
}
#include "Arduino.h"

static const double COUNTS_PER_TURN = 1440.0;
static const double LONGEST_S = 30.0;
enum { PIN_A = 2, PIN_B = 3, PIN_IN1 = 9, PIN_IN2 = 10, PINS = 14 };

volatile uint8_t TCCR1B;
SerialPort Serial;

static bench_params motor;
static double supply_V, v_rad_per_s, y_rad;
static bool swapped;
static unsigned long clock_us;
static long shown_counts;
static int duty[PINS], level[PINS];
static void (*handlers[2])(void);
static bool masked, pending[2], started, ended;

static void show(long counts)
{
    /* A leads B where the counts rise */
    static const int A[] = {0, 1, 1, 0}, B[] = {0, 0, 1, 1};
    const int phase = (int)(((counts % 4) + 4) % 4);
    const int a = swapped ? B[phase] : A[phase], b = swapped ? A[phase] : B[phase];
    const bool edges[2] = {a != level[PIN_A], b != level[PIN_B]};
    level[PIN_A] = a;
    level[PIN_B] = b;
    for (int k = 0; k < 2; k++) {
        if (edges[k] && handlers[k] != NULL) {
            if (masked) {
                pending[k] = true;
            } else {
                handlers[k]();
            }
        }
    }
}

static void pass(unsigned long us)
{
    const double u_V = supply_V * (duty[PIN_IN1] - duty[PIN_IN2]) / 255.0;
    bench_motion(&motor, &v_rad_per_s, &y_rad, u_V, 1e-6 * (double)us);
    clock_us += us;
    const long counts = (long)floor(y_rad / (2.0 * M_PI) * COUNTS_PER_TURN);
    while (shown_counts != counts) {
        shown_counts += shown_counts < counts ? 1 : -1;
        show(shown_counts);
    }
}

void pinMode(uint8_t, uint8_t) {}
int digitalRead(uint8_t pin) { return level[pin]; }
void analogWrite(uint8_t pin, int value) { duty[pin] = value; }
void noInterrupts() { masked = true; }

unsigned long micros()
{
    pass(4);
    return clock_us;
}

void interrupts()
{
    masked = false;
    for (int k = 0; k < 2; k++) {
        if (pending[k]) {
            pending[k] = false;
            handlers[k]();
        }
    }
}

int digitalPinToInterrupt(uint8_t pin) { return pin - PIN_A; }
void attachInterrupt(uint8_t number, void (*handler)(void), int) { handlers[number] = handler; }

void SerialPort::begin(unsigned long) {}

int SerialPort::read()
{
    pass(100);
    if (started) {
        ended = true; /* it waits for the next start */
        return -1;
    }
    started = true;
    return 's';
}

void SerialPort::print(char c) { printf("%c", c); }
void SerialPort::print(int n) { printf("%d", n); }
void SerialPort::print(long n) { printf("%ld", n); }
void SerialPort::print(unsigned long n) { printf("%lu", n); }
void SerialPort::println(const char *text) { printf("%s\r\n", text); }
void SerialPort::println(long n) { printf("%ld\r\n", n); }

int main(int count, char **words)
{
    if (count != 6) {
        return 2;
    }
    bench_defaults(&motor);
    motor.tau_s = atof(words[1]);
    motor.K_rad_s_V = atof(words[2]);
    motor.fc_plus_V = motor.fc_minus_V = motor.fs_plus_V = motor.fs_minus_V = atof(words[3]);
    motor.stop_low_rad = -1e9;
    motor.stop_high_rad = 1e9;
    supply_V = atof(words[4]);
    swapped = atoi(words[5]) != 0;
    setup();
    while (!ended && 1e-6 * (double)clock_us < LONGEST_S) {
        loop();
    }
    return 0;
}
