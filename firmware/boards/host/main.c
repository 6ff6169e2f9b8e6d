/* The emulated board in real time: a process behind a pseudo-terminal (process.h). Its parameters are those of the
 * bench (bench.h).
 */
#include <stdio.h>

#include "device.h"
#include "process.h"

#define TRACE_EVERY_TICKS 10u
#define STALL_S 10.0 /* longer ones are not made up for */

typedef struct {
    process process;
    device device;
    double start_s; /* process_now_s at the bench's time 0 */
    bool drive_changed;
} board;

static void transmit(void *context, const uint8_t *bytes, uint8_t n)
{
    process_write(&((const board *)context)->process, bytes, n);
}

/* ---- trace ---- */

static void drive_changed(void *context)
{
    ((board *)context)->drive_changed = true;
}

static void trace_row(board *self)
{
    const bench *b = &self->device.bench;
    FILE *trace = self->process.trace;
    self->drive_changed = false;
    if (trace != NULL) {
        fprintf(trace, "%.6f,%.6f,%.6f,%.6f,%u\n", self->start_s + b->t_s, bench_pin_V(b), b->y_rad, b->v_rad_per_s,
                (unsigned)self->device.core.fault);
        fflush(trace);
    }
}

/* ---- time ---- */

static double now_s(board *self)
{
    const double behind_s = process_now_s() - self->start_s - device_next_tick_s(&self->device);
    if (behind_s > STALL_S) {
        fprintf(stderr, "%s: stood still for %.1f s, and the board's clock with it\n", self->process.program, behind_s);
        self->start_s += behind_s;
    }
    return process_now_s() - self->start_s;
}

/* Every tick up to `t_s`, at its own time: the board ran on while this process stood still. */
static void serve_ticks(board *self, double t_s)
{
    device *d = &self->device;
    while (device_next_tick_s(d) <= t_s) {
        const uint32_t decade = d->ticks / TRACE_EVERY_TICKS;
        bench_advance_to(&d->bench, device_next_tick_s(d));
        device_tick(d);
        if (self->drive_changed || d->ticks / TRACE_EVERY_TICKS != decade) {
            trace_row(self);
        }
    }
    bench_advance_to(&d->bench, t_s);
}

/* The time is read after the bytes, and they come at that time: the board hears nothing before the host has said it. */
static void serve(board *self)
{
    uint8_t bytes[256];
    const size_t n = process_read(&self->process, bytes, sizeof bytes);
    serve_ticks(self, now_s(self));
    for (size_t i = 0; i < n; i++) {
        device_byte(&self->device, bytes[i]);
        if (self->drive_changed) {
            trace_row(self);
        }
    }
}

/* ---- start ---- */

static void usage(void)
{
    for (unsigned i = 0; bench_option_name(i) != NULL; i++) {
        printf("    %s\n", bench_option_name(i));
    }
}

static const char *option(void *context, const char *name, const char *value)
{
    return bench_option(context, name, value);
}

int main(int argc, char **argv)
{
    static board self = {.process.program = "rig_host_board"};
    bench_params params;
    bench_defaults(&params);
    if (!process_parse(&self.process, argc, argv, option, &params, usage)) {
        return 0;
    }
    const char *wrong = bench_check(&params);
    if (wrong != NULL) {
        process_fail(&self.process, "parameters", wrong);
    }
    process_open(&self.process, "t_s,drive_V,y_rad,v_rad_per_s,fault");
    self.start_s = process_now_s();
    device_init(&self.device, &params, transmit, drive_changed, &self);
    process_announce(&self.process);
    while (process_wait(&self.process, self.start_s + device_next_tick_s(&self.device))) {
        serve(&self);
        if (process_reset_asked()) {
            device_reset(&self.device, RIG_RESET_EXTERNAL);
            trace_row(&self);
        }
    }
    serve_ticks(&self, now_s(&self));
    device_reset(&self.device, RIG_RESET_POWER_ON); /* the power is cut: 0 V at the pin */
    trace_row(&self);
    process_close(&self.process);
    return 0;
}
