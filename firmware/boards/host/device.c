#include "device.h"

#include <math.h>
#include <stddef.h>

#ifndef RIG_BUILD
#define RIG_BUILD "host"
#endif

#define TICK_S 1e-3

static double clock_rate(const device *d)
{
    return 1.0 + 1e-6 * d->bench.p.clock_error_ppm;
}

static uint32_t micros(void *context)
{
    const device *d = context;
    const double since_reset_us = 1e6 * clock_rate(d) * (d->bench.t_s - d->reset_t_s);
    /* The thousandth absorbs rounding where a whole microsecond is meant. */
    return d->bench.p.clock_start_us + (uint32_t)(uint64_t)(since_reset_us + 1e-3);
}

static int32_t position(void *context, uint32_t *t_us)
{
    device *d = context;
    *t_us = micros(context);
    return bench_position_counts(&d->bench);
}

static uint16_t tach_counts(void *context)
{
    const device *d = context;
    const int32_t counts = bench_tachometer_counts(&d->bench);
    return counts < 0 ? (uint16_t)RIG_TACH_NONE : (uint16_t)counts;
}

static void set_drive(void *context, int16_t units)
{
    device *d = context;
    if (units != d->bench.pin_units) {
        bench_set_drive(&d->bench, units);
        if (d->drive_changed != NULL) {
            d->drive_changed(d->context);
        }
    }
}

static void transmit(void *context, const uint8_t *bytes, uint8_t n)
{
    const device *d = context;
    d->transmit(d->context, bytes, n);
}

void device_init(device *d, const bench_params *p, void (*send)(void *, const uint8_t *, uint8_t),
                 void (*drive_changed)(void *), void *context)
{
    bench_init(&d->bench, p);
    d->transmit = send;
    d->drive_changed = drive_changed;
    d->context = context;
    d->board.context = d;
    d->board.micros = micros;
    d->board.position = position;
    d->board.tach_counts = tach_counts;
    d->board.set_drive = set_drive;
    d->board.transmit = transmit;
    d->board.inputs = NULL;
    d->board.build = RIG_BUILD;
    d->board.counts_max = p->counts_max;
    d->board.drive_full = (uint16_t)p->drive_counts;
    d->board.board_id = RIG_BOARD_HOST;
    d->board.bridge = RIG_BRIDGE_NONE;
    d->board.arrived_us = NULL;
    d->board.supply = NULL;
    d->board.hold_tick = NULL;
    d->board.release_tick = NULL;
    d->board.features = (uint8_t)(p->tachometer_rad_s_per_count != 0.0 ? RIG_FEATURE_TACHOMETER : 0);
    device_reset(d, RIG_RESET_POWER_ON);
}

void device_reset(device *d, uint8_t cause)
{
    set_drive(d, 0); /* floating pins, held down by the resistor on the bridge's enable */
    d->reset_t_s = d->bench.t_s;
    d->ticks = 0;
    rig_init(&d->core, &d->board, cause);
}

double device_next_tick_s(const device *d)
{
    return d->reset_t_s + (d->ticks + 1.0) * (TICK_S / clock_rate(d));
}

void device_tick(device *d)
{
    rig_tick(&d->core);
    rig_stream(&d->core);
    const double due = (d->bench.t_s - d->reset_t_s) * (clock_rate(d) / TICK_S);
    const double done = floor(due + 1e-6); /* a tick run on time has not missed the next */
    d->ticks = done > d->ticks + 1.0 ? (uint32_t)done : d->ticks + 1u;
}

void device_byte(device *d, uint8_t byte)
{
    rig_byte(&d->core, byte);
    rig_stream(&d->core);
    if (d->core.armed) {
        bench_arm(&d->bench);
    }
}
