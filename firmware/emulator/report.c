/* What the firmware takes of the chip, measured on the emulated one: stack, time awake, in the tick, in interrupts, with
 * interrupts masked, and bytes lost, while the host asks for everything as fast as the wire carries it and a relay runs,
 * and while strokes run. Fails beyond the bounds below.
 *
 *     report HEX [BAUD] [EDGES]    of an encoder that turns with so many edges a second
 */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "chip.h"
#include "rig_core.h"

static const uint8_t SESSION[4] = {1, 0, 0, 0};
static const uint8_t SETUP[30] = {1,    0, 0, 0, 49, 0, 0, 0, 0xCF, 3,   0, 0,   5, 0, 0,
                                  0, 0xFA, 3, 0, 0,  0, 2, 0, 0,    200, 0, 100, 0, 1, 0};
/* Of an encoder: no rails, limits far away, zero where it stands; here it turns without end. */
static const uint8_t ENCODER_SETUP[30] = {1, 0, 0, 0, 0, 0, 0xF1, 0xFF, 0,   0, 15,  0, 0, 0, 0,
                                          0, 0, 0, 0, 0, 0, 0,    0,    0,   200, 0, 100, 0, 1, 0};
static const uint8_t ZERO[4] = {0, 0, 0, 0};
static const uint8_t RESET[1] = {RIG_E_RESET};
static const uint8_t WATCHDOG[1] = {RIG_E_WATCHDOG};
/* +-60 and +-20 units about 512 counts, blocks of ten rows */
static const uint8_t RELAY[18] = {0xC4, 0xFF, 0xEC, 0xFF, 20, 0, 60, 0, 0, 32, 0, 0, 0, 0, 0, 16, 1, 10};
static const uint8_t DRIVE[2] = {10, 0}; /* 0.3 V: the shaft stays */


#define TICK_SHARE_MAX 0.30
#define MASKED_MAX_US 15.0 /* one and a half bytes at 1 Mbaud: the receiver holds two */

static int64_t byte_ns;

static void ask(virtual_board *b, uint8_t type, const uint8_t *body, uint8_t n)
{
    uint8_t content[FRAME_CONTENT_MAX] = {RIG_PROTOCOL, type, 1, 0};
    uint8_t wire[FRAME_WIRE_MAX];
    if (n > 0u) {
        memcpy(content + FRAME_HEADER, body, n);
    }
    const uint8_t length = frame_encode(content, (uint8_t)(FRAME_HEADER + n), wire);
    (void)virtual_write(b, wire, length);
    virtual_run(b, virtual_now_ns(b) + length * byte_ns, 0);
}

/* Returns the bytes that came. */
static uint32_t pause(virtual_board *b, int64_t ns)
{
    uint8_t bytes[4096];
    virtual_run(b, virtual_now_ns(b) + ns, 0);
    return virtual_read(b, bytes, sizeof bytes);
}

/* To and fro, with as many strokes as there may be. */
static void start_strokes(virtual_board *b)
{
    static const uint8_t to_and_fro[2][6] = {{60, 0, 0x58, 2, 0, 0}, {0xC4, 0xFF, 0xA8, 1, 0, 0}};
    uint8_t body[56] = {STROKES_MAX, BLOCK_ROWS_MAX, 200, 0, 200, 0, 9, 0};
    for (unsigned i = 0; i < STROKES_MAX; i++) {
        memcpy(body + 8u + 6u * i, to_and_fro[i % 2u], 6);
    }
    ask(b, RIG_STROKES, body, sizeof body);
}

static void arm(virtual_board *b, bool has_encoder)
{
    ask(b, RIG_STOP, NULL, 0);
    ask(b, RIG_ACK, RESET, sizeof RESET);
    ask(b, RIG_ACK, WATCHDOG, sizeof WATCHDOG);
    ask(b, RIG_SETUP, has_encoder ? ENCODER_SETUP : SETUP, sizeof SETUP);
    if (has_encoder) {
        ask(b, RIG_ZERO, ZERO, sizeof ZERO);
    }
    ask(b, RIG_ARM, SESSION, sizeof SESSION);
    (void)pause(b, 10000000);
}

int main(int argc, char **argv)
{
    const long baud = argc > 2 ? strtol(argv[2], NULL, 10) : 115200;
    const bool has_encoder = argc > 3; /* it turns at 1 rad/s, whatever drives it */
    const double edges_1_s = has_encoder ? fmax(strtod(argv[3], NULL), 1e-3) : 1.0;
    virtual_board *b = virtual_new();
    if (argc < 2 || b == NULL || baud < 1) {
        fprintf(stderr, "usage: report HEX [BAUD]\n");
        return 2;
    }
    byte_ns = 10000000000 / baud;
    const char *const options[][2] = {{"hex", argv[1]},     {"measure", "1"},     {"fc-plus-V", "0.5"},
                                      {"fc-minus-V", "0.5"}, {"fs-plus-V", "0.5"}, {"fs-minus-V", "0.5"}};
    const char *wrong = NULL;
    if (has_encoder) {
        char rad_per_count[32];
        (void)snprintf(rad_per_count, sizeof rad_per_count, "%.9g", 1.0 / edges_1_s);
        const char *const turning[][2] = {{"encoder", "1"}, {"tau-s", "1e9"}, {"rad-per-count", rad_per_count},
                                          {"stop-low-rad", "-1e9"}, {"stop-high-rad", "1e9"}};
        for (unsigned i = 0; i < sizeof turning / sizeof turning[0] && wrong == NULL; i++) {
            wrong = virtual_option(b, turning[i][0], turning[i][1]);
        }
    }
    for (unsigned i = 0; i < sizeof options / sizeof options[0] && wrong == NULL; i++) {
        wrong = virtual_option(b, options[i][0], options[i][1]);
    }
    wrong = wrong != NULL ? wrong : virtual_start(b, byte_ns);
    if (wrong != NULL) {
        fprintf(stderr, "report: %s: %s\n", argv[1], wrong);
        return 2;
    }
    virtual_view idle, armed, run, view;
    if (has_encoder) {
        virtual_place(b, 0.0, 1.0);
    }
    (void)pause(b, 1000000000);
    virtual_look(b, &idle);

    arm(b, has_encoder); /* as in a run: KEEP at each tick of the host's loop */
    virtual_look(b, &armed);
    ask(b, RIG_RELAY, RELAY, sizeof RELAY);
    uint32_t bytes = 0;
    for (unsigned i = 0; i < 200u; i++) {
        ask(b, RIG_KEEP, NULL, 0);
        bytes += pause(b, 10000000);
    }
    virtual_look(b, &run);
    const double relay_awake = (run.awake_share * run.t_s - armed.awake_share * armed.t_s) / (run.t_s - armed.t_s);

    arm(b, has_encoder); /* everything there is, without a pause on the host's wire, first without and then with the relay */
    for (unsigned i = 0; i < 400u; i++) {
        if (i == 200u) {
            (void)pause(b, 20000000); /* behind the receiver there is room for 255 bytes */
            arm(b, has_encoder);
            ask(b, RIG_RELAY, RELAY, sizeof RELAY);
        }
        if (i < 200u) {
            ask(b, RIG_DRIVE, DRIVE, sizeof DRIVE);
        } else {
            ask(b, RIG_KEEP, NULL, 0);
        }
        ask(b, RIG_READ, NULL, 0);
        ask(b, RIG_HELLO, NULL, 0);
        (void)pause(b, 40 * byte_ns); /* the longer answers need longer */
    }
    (void)pause(b, 200000000); /* the watchdog ends it */
    arm(b, has_encoder);
    start_strokes(b);
    uint32_t stroke_bytes = 0;
    for (unsigned i = 0; i < 40u; i++) {
        ask(b, RIG_KEEP, NULL, 0);
        stroke_bytes += pause(b, 10000000);
    }
    (void)pause(b, 200000000); /* the watchdog ends it */
    virtual_look(b, &view);
    printf("stack     %4ld bytes at most\n", (long)view.stack_bytes);
    printf("awake     %4.1f %% of the time when idle, %.1f %% while the relay runs\n", 100.0 * idle.awake_share,
           100.0 * relay_awake);
    printf("tick      %4.1f us at most, relay or strokes included, without the interrupts that come between\n", view.tick_us);
    printf("1 kHz     %4.1f %% of a tick at most: that and the interrupts of clock and converter\n",
           100.0 * view.timed_share);
    printf("relay     %4.1f %% of a tick at most in all interrupts, the serial port's included, while the relay runs\n",
           100.0 * run.interrupt_share);
    printf("flood     %4.1f %% of a tick at most in all interrupts, both ways of the wire full\n",
           100.0 * view.interrupt_share);
    printf("masked    %4.1f us at most\n", view.masked_us);
    printf("held      %4.1f us at most: the tick, by the main loop, other interrupts included\n", virtual_held_us(b));
    printf("lost      %4ld bytes received, of the relay's 2 s %lu bytes came, of the strokes' 0.4 s %lu\n", (long)view.overruns,
           (unsigned long)bytes, (unsigned long)stroke_bytes);
    const bool is_well = view.overruns == 0 && view.resets == 0 && !view.crashed && bytes > 200u * 50u &&
                         stroke_bytes > 40u * 50u &&
                         view.timed_share < TICK_SHARE_MAX && view.masked_us < MASKED_MAX_US;
    virtual_free(b);
    if (!is_well) {
        fprintf(stderr, "report: bytes or blocks were lost, the chip was reset, a tick took %.0f %% or interrupts were masked "
                        "for %.0f us\n", 100.0 * TICK_SHARE_MAX, MASKED_MAX_US);
    }
    return is_well ? 0 : 1;
}
