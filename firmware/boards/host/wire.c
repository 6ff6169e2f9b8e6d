#include "wire.h"

bool wire_put(wire *w, int64_t now_ns, int64_t byte_ns, uint8_t byte)
{
    if (w->count == WIRE_BYTES) {
        return false;
    }
    const uint32_t at = (w->head + w->count) % WIRE_BYTES;
    w->last_ns = (w->last_ns > now_ns ? w->last_ns : now_ns) + byte_ns;
    w->byte[at] = byte;
    w->arrives_ns[at] = w->last_ns;
    w->count++;
    return true;
}

uint32_t wire_put_all(wire *w, int64_t now_ns, int64_t byte_ns, const uint8_t *bytes, uint32_t n)
{
    uint32_t taken = 0;
    while (taken < n && wire_put(w, now_ns, byte_ns, bytes[taken])) {
        taken++;
    }
    return taken;
}

int64_t wire_next_ns(const wire *w)
{
    return w->count > 0u ? w->arrives_ns[w->head] : INT64_MAX;
}

static int64_t frame_ns(const wire *w)
{
    for (uint32_t i = 0; i < w->count; i++) {
        const uint32_t at = (w->head + i) % WIRE_BYTES;
        if (w->byte[at] == 0u) {
            return w->arrives_ns[at];
        }
    }
    return INT64_MAX;
}

int64_t wire_arrival_ns(const wire *w, int32_t until)
{
    switch (until) {
    case 1:
        return wire_next_ns(w);
    case 2:
        return frame_ns(w);
    default:
        return INT64_MAX;
    }
}

uint8_t wire_take(wire *w)
{
    const uint8_t byte = w->byte[w->head];
    w->head = (w->head + 1u) % WIRE_BYTES;
    w->count--;
    return byte;
}

uint32_t wire_take_arrived(wire *w, int64_t now_ns, uint8_t *bytes, uint32_t n)
{
    uint32_t taken = 0;
    while (taken < n && wire_next_ns(w) <= now_ns) { /* a byte on the way arrives before INT64_MAX */
        bytes[taken++] = wire_take(w);
    }
    return taken;
}
