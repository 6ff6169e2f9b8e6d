#include "device.h"

#include <stddef.h>
#include <string.h>

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

/* As boards/uno/encoder.h: what the chip's interrupts make of the edges since the last look. */
static const unsigned EDGES_MAX = 40u;
static const unsigned ALONE_MAX = 32u;

static void count_edge(device *d, unsigned levels)
{
    const unsigned changed = levels ^ d->encoder.levels;
    d->encoder.levels = levels;
    if (changed == 0u) {
        return;
    }
    if (changed == 3u) {
        d->encoder.troubles |= (uint8_t)RIG_ENCODER_LOST;
        return;
    }
    const bool differ = levels == 1u || levels == 2u;
    d->encoder.counts += (changed == 1u) == differ ? 1 : -1;
    d->encoder.alone = changed == d->encoder.last ? d->encoder.alone + 1u : 0u;
    d->encoder.last = changed;
    d->encoder.edges++;
    if (d->encoder.alone >= ALONE_MAX) {
        d->encoder.troubles |= (uint8_t)RIG_ENCODER_STILL;
        d->encoder.alone = 0;
    }
    if (d->encoder.edges > EDGES_MAX) {
        d->encoder.troubles |= (uint8_t)RIG_ENCODER_RATE;
    }
}

static void look_at_encoder(device *d)
{
    double to_next;
    const int64_t now = bench_encoder_steps(&d->bench, &to_next);
    count_edge(d, bench_encoder_levels(&d->bench, d->encoder.steps)); /* the wiring may have changed */
    while (d->encoder.steps != now) {
        d->encoder.steps += d->encoder.steps < now ? 1 : -1;
        count_edge(d, bench_encoder_levels(&d->bench, d->encoder.steps));
    }
}

static int32_t encoder_position(void *context, uint32_t *t_us)
{
    device *d = context;
    *t_us = micros(context);
    look_at_encoder(d);
    return d->encoder.counts;
}

static void set_position(void *context, int32_t counts)
{
    device *d = context;
    look_at_encoder(d);
    d->encoder.counts = counts;
}

static uint8_t encoder_troubles(void *context)
{
    device *d = context;
    const uint8_t found = d->encoder.troubles;
    d->encoder.troubles = 0;
    return found;
}

static uint8_t contacts(void *context)
{
    const device *d = context;
    return (uint8_t)((bench_estop_is_open(&d->bench) ? (unsigned)RIG_INPUT_ESTOP : 0u) |
                     (bench_end_is_open(&d->bench, false) ? (unsigned)RIG_INPUT_END_LOW : 0u) |
                     (bench_end_is_open(&d->bench, true) ? (unsigned)RIG_INPUT_END_HIGH : 0u));
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
    d->board.set_position = NULL;
    d->board.encoder_troubles = NULL;
    if (p->encoder != 0) {
        d->board.position = encoder_position;
        d->board.set_position = set_position;
        d->board.encoder_troubles = encoder_troubles;
        d->board.inputs = contacts;
        d->board.counts_max = 0;
        d->board.features |= (uint8_t)RIG_FEATURE_ENCODER;
    }
    device_reset(d, RIG_RESET_POWER_ON);
}

void device_reset(device *d, uint8_t cause)
{
    set_drive(d, 0); /* floating pins, held down by the resistor on the bridge's enable */
    d->reset_t_s = d->bench.t_s;
    d->ticks = 0;
    if (d->bench.p.encoder != 0) { /* it counts from 0, wherever the shaft stands */
        double to_next;
        memset(&d->encoder, 0, sizeof d->encoder);
        d->encoder.steps = bench_encoder_steps(&d->bench, &to_next);
        d->encoder.levels = bench_encoder_levels(&d->bench, d->encoder.steps);
    }
    rig_init(&d->core, &d->board, cause);
}

double device_next_tick_s(const device *d)
{
    return d->reset_t_s + (d->ticks + 1.0) * (TICK_S / clock_rate(d));
}

void device_tick(device *d)
{
    rig_tick(&d->core);
    d->encoder.edges = 0;
    rig_stream(&d->core);
    d->ticks++;
}

void device_byte(device *d, uint8_t byte)
{
    rig_byte(&d->core, byte);
    rig_stream(&d->core);
    if (d->core.armed) {
        bench_arm(&d->bench);
    }
}
