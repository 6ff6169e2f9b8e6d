/* The emulated device in virtual time, as a shared library (librig_host.so; rig/backends/serial/emulated/virtual_board.py). Nothing
 * here looks at a clock and nothing is global: any number of devices can live in one process.
 *
 * A byte takes `byte_ns`, either way.
 */
#include <stdlib.h>
#include <string.h>

#include "device.h"
#include "wire.h"

#define HARDWARE_WATCHDOG_NS 120000000

typedef struct {
    bench_params params;
    device device;
    wire to_device, to_host;
    int64_t now_ns, byte_ns;
    int64_t pin_changed_ns; /* of the last change at the pin; negative: never */
    int64_t fed_ns;         /* when the hardware watchdog was fed last */
    bool hung;
} virtual_board;

/* What a test may look at besides the wire. */
typedef struct {
    double t_s, pin_V, motor_V, y_rad, v_rad_per_s, pin_changed_s;
    int32_t armed, latched, fault, recovering, dropped, hung;
} virtual_view;

static void send(void *context, const uint8_t *bytes, uint8_t n)
{
    virtual_board *b = context;
    for (uint8_t i = 0; i < n; i++) {
        (void)wire_put(&b->to_host, b->now_ns, b->byte_ns, bytes[i]); /* a host that never reads loses bytes */
    }
}

static void pin_changed(void *context)
{
    virtual_board *b = context;
    b->pin_changed_ns = b->now_ns;
}

static int64_t to_ns(double t_s)
{
    return (int64_t)(t_s * 1e9 + 0.5);
}

virtual_board *virtual_new(void)
{
    virtual_board *b = calloc(1, sizeof *b);
    if (b != NULL) {
        bench_defaults(&b->params);
    }
    return b;
}

const char *virtual_option(virtual_board *b, const char *name, const char *value)
{
    return bench_option(&b->params, name, value);
}

/* Powers the device on at time 0. NULL, or what is wrong with the parameters. */
const char *virtual_start(virtual_board *b, int64_t byte_ns)
{
    const char *wrong = bench_check(&b->params);
    if (wrong == NULL) {
        b->byte_ns = byte_ns;
        b->pin_changed_ns = -1;
        device_init(&b->device, &b->params, send, pin_changed, b);
    }
    return wrong;
}

void virtual_free(virtual_board *b)
{
    free(b);
}

/* The host sends bytes from now on. Returns how many the wire took. */
uint32_t virtual_write(virtual_board *b, const uint8_t *bytes, uint32_t n)
{
    return wire_put_all(&b->to_device, b->now_ns, b->byte_ns, bytes, n);
}

/* Bytes that have arrived at the host by now. */
uint32_t virtual_read(virtual_board *b, uint8_t *bytes, uint32_t n)
{
    return wire_take_arrived(&b->to_host, b->now_ns, bytes, n);
}

static void run_to(virtual_board *b, int64_t t_ns)
{
    b->now_ns = t_ns;
    bench_advance_to(&b->device.bench, 1e-9 * (double)t_ns);
}

void virtual_reset(virtual_board *b, uint8_t cause)
{
    b->hung = false;
    b->fed_ns = b->now_ns;
    device_reset(&b->device, cause);
}

/* Runs to `until_ns`, or to what arrives at the host if that is sooner: `until` 1: the next byte; 2: the end of a frame. */
void virtual_run(virtual_board *b, int64_t until_ns, int32_t until)
{
    for (;;) {
        const int64_t tick_ns = b->hung ? INT64_MAX : to_ns(device_next_tick_s(&b->device));
        const int64_t byte_ns = wire_next_ns(&b->to_device);
        const int64_t bite_ns = b->hung ? b->fed_ns + HARDWARE_WATCHDOG_NS : INT64_MAX;
        const int64_t reply_ns = wire_arrival_ns(&b->to_host, until);
        const int64_t next_ns = reply_ns < until_ns ? reply_ns : until_ns;
        const int64_t event_ns = tick_ns < byte_ns ? tick_ns : byte_ns;
        const int64_t first_ns = event_ns < bite_ns ? event_ns : bite_ns;
        if (first_ns > next_ns) {
            if (next_ns > b->now_ns) {
                run_to(b, next_ns);
            }
            return;
        }
        run_to(b, first_ns > b->now_ns ? first_ns : b->now_ns);
        if (first_ns == byte_ns) {
            const uint8_t byte = wire_take(&b->to_device);
            if (!b->hung) {
                device_byte(&b->device, byte);
            }
        } else if (first_ns == tick_ns) {
            device_tick(&b->device);
            b->fed_ns = b->now_ns;
        } else {
            virtual_reset(b, RIG_RESET_WATCHDOG);
        }
    }
}

int64_t virtual_now_ns(const virtual_board *b)
{
    return b->now_ns;
}

void virtual_look(const virtual_board *b, virtual_view *view)
{
    const device *d = &b->device;
    view->t_s = 1e-9 * (double)b->now_ns;
    view->pin_V = bench_pin_V(&d->bench);
    view->motor_V = bench_motor_V(&d->bench);
    view->y_rad = d->bench.y_rad;
    view->v_rad_per_s = d->bench.v_rad_per_s;
    view->pin_changed_s = 1e-9 * (double)b->pin_changed_ns;
    view->armed = d->core.armed;
    view->latched = d->core.latched != 0u;
    view->fault = (uint8_t)d->core.fault;
    view->recovering = d->core.recovering;
    view->dropped = d->core.rx.dropped;
    view->hung = b->hung;
}

/* The firmware stops; the pin keeps its drive until the hardware watchdog resets the chip. */
void virtual_hang(virtual_board *b)
{
    b->hung = true;
}

/* Wiring faults from now on. NULL, or what is wrong with the names. */
const char *virtual_rewire(virtual_board *b, const char *drive, const char *sensor)
{
    return bench_rewire(&b->device.bench, drive, sensor);
}

/* Puts the shaft somewhere, as a hand would. */
void virtual_place(virtual_board *b, double y_rad, double v_rad_per_s)
{
    b->device.bench.y_rad = y_rad;
    b->device.bench.v_rad_per_s = v_rad_per_s;
}

/* One motion of the motor alone under the parameters set so far; the device takes no part. NULL, or what is wrong. */
const char *virtual_motion(const virtual_board *b, double *v, double *y, double u_V, double dt_s)
{
    const char *wrong = bench_check(&b->params);
    if (wrong == NULL) {
        bench_motion(&b->params, v, y, u_V, dt_s);
    }
    return wrong;
}

/* One motion of the motor with its parts alone, from when[0], s, on, for when[1], s: `state` is v, y, f, w, x, or at the
 * start of the run if it is not `begun`; the last is what the sensor shows. NULL, or what is wrong. */
const char *virtual_real_motion(const virtual_board *b, double state[6], int32_t begun, double u_V, const double when[2])
{
    const char *wrong = bench_check(&b->params);
    if (wrong != NULL) {
        return wrong;
    }
    const double stops[2] = {b->params.stop_low_rad, b->params.stop_high_rad};
    real_motor motor;
    real_state at;
    bench_real(&b->params, &motor, &at);
    if (begun != 0) {
        at = (real_state){state[0], state[1], state[2], state[3], state[4]};
    }
    real_advance(&motor, &at, u_V, when, stops);
    const double after[6] = {at.v, at.y, at.f, at.w, at.x, real_reading(&motor, at.x)};
    memcpy(state, after, sizeof after);
    return NULL;
}

/* One conversion of the position channel now. */
int32_t virtual_position_counts(virtual_board *b)
{
    return bench_position_counts(&b->device.bench);
}
