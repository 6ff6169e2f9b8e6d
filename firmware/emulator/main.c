/* The Uno's emulated chip in real time: a process behind a pseudo-terminal (process.h). Its parameters are those of
 * chip.h, and baud, which must be the one that the .hex is built for.
 *
 * The chip runs up to now whenever bytes come, else every 0.25 ms: what it sends arrives up to so much late.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"
#include "chip.h"
#include "process.h"

#define QUANTUM_NS 250000
#define TRACE_EVERY_NS 10000000
/* After a longer one than this the chip goes on where it stood, instead of running after the time. It is longer than a
 * host measures the clock for: time that the chip loses then looks like a restart. */
#define STALL_S 10.0
#define POWER_ON 1u
#define RESET_INPUT 2u

typedef struct {
    process process;
    virtual_board *chip;
    long baud;
    double start_s; /* process_now_s at the chip's time 0 */
    double changed_s;
    int64_t traced_ns;
} board;

static void trace_row(board *self, const virtual_view *view)
{
    fprintf(self->process.trace, "%.6f,%.6f,%.6f,%.6f,%d\n", self->start_s + view->t_s, view->pin_V, view->y_rad,
            view->v_rad_per_s, (int)view->led);
    fflush(self->process.trace);
    self->traced_ns = virtual_now_ns(self->chip);
}

/* A row where the drive at the pin has changed, to a quantum, and each 10 ms. */
static void trace(board *self)
{
    virtual_view view;
    if (self->process.trace == NULL) {
        return;
    }
    virtual_look(self->chip, &view);
    if (view.pin_changed_s > self->changed_s || virtual_now_ns(self->chip) >= self->traced_ns + TRACE_EVERY_NS) {
        self->changed_s = view.pin_changed_s;
        trace_row(self, &view);
    }
}

static void run_to_now(board *self)
{
    const double behind_s = process_now_s() - self->start_s - 1e-9 * (double)virtual_now_ns(self->chip);
    if (behind_s > STALL_S) {
        fprintf(stderr, "%s: stood still for %.1f s, and the chip's clock with it\n", self->process.program, behind_s);
        self->start_s += behind_s;
    }
    const int64_t now_ns = (int64_t)(1e9 * (process_now_s() - self->start_s));
    while (virtual_now_ns(self->chip) < now_ns) {
        const int64_t next_ns = virtual_now_ns(self->chip) + QUANTUM_NS;
        virtual_run(self->chip, next_ns < now_ns ? next_ns : now_ns, 0);
        trace(self);
    }
}

/* Bytes both ways, and the chip's time up to now. That time is read after the bytes, and they go on the wire at that
 * time: the chip hears nothing before the host has said it, however long this process stood still. */
static void carry_bytes(board *self)
{
    uint8_t bytes[256];
    size_t n = process_read(&self->process, bytes, sizeof bytes);
    run_to_now(self);
    (void)virtual_write(self->chip, bytes, (uint32_t)n); /* what the wire does not take is lost */
    n = virtual_read(self->chip, bytes, sizeof bytes);
    process_write(&self->process, bytes, n);
}

static void usage(void)
{
    puts("    hex\n    baud\n    bridge\n    dead-time-s");
    for (unsigned i = 0; bench_option_name(i) != NULL; i++) {
        printf("    %s\n", bench_option_name(i));
    }
}

static const char *option(void *context, const char *name, const char *value)
{
    board *self = context;
    if (strcmp(name, "baud") == 0) {
        self->baud = strtol(value, NULL, 10);
        return self->baud > 0 ? NULL : "a number of bits per second";
    }
    return virtual_option(self->chip, name, value);
}

int main(int argc, char **argv)
{
    static board self = {.process.program = "rig_chip_board", .baud = 115200, .changed_s = -1.0};
    virtual_view view;
    self.chip = virtual_new();
    if (self.chip == NULL) {
        process_fail(&self.process, "the chip", "no memory");
    }
    if (!process_parse(&self.process, argc, argv, option, &self, usage)) {
        virtual_free(self.chip);
        return 0;
    }
    const char *wrong = virtual_start(self.chip, 10000000000 / self.baud);
    if (wrong != NULL) {
        process_fail(&self.process, "parameters", wrong);
    }
    process_open(&self.process, "t_s,drive_V,y_rad,v_rad_per_s,led");
    self.start_s = process_now_s();
    process_announce(&self.process);
    while (process_wait(&self.process, self.start_s + 1e-9 * (double)(virtual_now_ns(self.chip) + QUANTUM_NS))) {
        if (process_reset_asked()) {
            run_to_now(&self);
            virtual_boot(self.chip, RESET_INPUT, 0.0);
            trace(&self);
        }
        carry_bytes(&self);
    }
    run_to_now(&self);
    if (self.process.trace != NULL) {
        virtual_boot(self.chip, POWER_ON, 1.0); /* the power is cut: pins float, 0 V at the bridge */
        virtual_look(self.chip, &view);
        trace_row(&self, &view);
    }
    process_close(&self.process);
    virtual_free(self.chip);
    return 0;
}
