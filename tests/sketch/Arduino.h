/* The calls of the Arduino core that the sketch in docs/examples uses, by their names and types there, and no others. */
#ifndef ARDUINO_H
#define ARDUINO_H

#include <stdint.h>

typedef uint8_t byte;

enum { LOW = 0, HIGH = 1, CHANGE = 1, OUTPUT = 1, INPUT_PULLUP = 2 };

extern volatile uint8_t TCCR1B;

void pinMode(uint8_t pin, uint8_t mode);
int digitalRead(uint8_t pin);
void analogWrite(uint8_t pin, int value);
unsigned long micros(void);
void noInterrupts(void);
void interrupts(void);
int digitalPinToInterrupt(uint8_t pin);
void attachInterrupt(uint8_t number, void (*handler)(void), int mode);

struct SerialPort {
    void begin(unsigned long baud);
    int read(void);
    void print(char c);
    void print(int n);
    void print(long n);
    void print(unsigned long n);
    void println(const char *text);
    void println(long n);
};
extern SerialPort Serial;

void setup(void);
void loop(void);

#endif
