/* The stroke test in the device: when it may start, what it drives, what ends it, and what the host is told of it. */
#include "law_board.h"

#define BODY 56u
#define STROKE_TICKS 400u
#define STILL_TICKS 300u
#define STILL_COUNTS 9u

typedef struct {
    int drive;
    int32_t turn;
} told_stroke;

static const told_stroke TO_AND_FRO[] = {{120, 700}, {-150, 300}, {60, 600}, {-80, 400}};

static void fill(uint8_t body[BODY], unsigned n, const told_stroke *of)
{
    memset(body, 0, BODY);
    body[0] = (uint8_t)n;
    body[1] = BLOCK_ROWS_MAX;
    (void)put16(put16(put16(&body[2], STROKE_TICKS), STILL_TICKS), STILL_COUNTS);
    for (unsigned i = 0; i < n && i < STROKES_MAX; i++) {
        (void)put32(put16(&body[8u + 6u * i], of[i].drive), (uint32_t)of[i].turn);
    }
}

static void start(unsigned n, const told_stroke *of)
{
    uint8_t body[BODY];
    fill(body, n, of);
    send(RIG_STROKES, body, BODY);
}

static int started(void)
{
    return board.reply_length == FRAME_HEADER + BODY && board.reply[1] == (RIG_STROKES | RIG_REPLY) && core.running;
}

static void running(void)
{
    armed(1);
    board.counts = 504; /* below the centre: the plan's first stroke is inward */
    start(4, TO_AND_FRO);
    CHECK(started());
}

static void test_it_drives_each_stroke_to_its_turning_point(void)
{
    running();
    CHECK(board.pin == 0); /* from the next tick on */
    tick();
    CHECK(board.pin == 120);
    board.counts = 699;
    tick();
    CHECK(board.pin == 120);
    board.counts = 703;
    tick();
    CHECK(board.pin == -150);
    board.counts = 300;
    tick();
    CHECK(board.pin == 60);
    ticks(3);
    board.counts = 600;
    tick();
    CHECK(board.pin == -80);
    board.counts = 399;
    tick();
    CHECK(board.pin == 120 && core.running && core.armed); /* again and again */
    board.counts = 700;
    ticks(2);
    CHECK(last()->n == 10 && (last()->status & RIG_STATUS_LAW) != 0);
    static const int16_t driven[] = {120, 120, -150, 60, 60, 60, 60, -80, 120, -150};
    CHECK(memcmp(last()->drive, driven, sizeof driven) == 0);
    send_drive(0);
    CHECK(core.armed && !core.running && (last()->status & RIG_STATUS_LAW) == 0);
}

static void test_the_reply_repeats_it(void)
{
    uint8_t body[BODY];
    running();
    fill(body, 4, TO_AND_FRO);
    CHECK(memcmp(board.reply + FRAME_HEADER, body, BODY) == 0);
}

static void test_with_negative_polarity(void)
{
    static const told_stroke mirrored[] = {{120, 300}, {-150, 700}}; /* positive drive lowers the counts */
    armed(-1);
    board.counts = 520;
    start(2, mirrored);
    CHECK(started());
    tick();
    CHECK(board.pin == 120);
    board.counts = 300;
    tick();
    CHECK(board.pin == -150);
}

/* P12: to the tick, each way, and then nothing until the host starts anew. */
static void test_a_stroke_that_does_not_turn(void)
{
    for (int moves = 0; moves <= 1; moves++) {
        const unsigned most = moves != 0 ? STROKE_TICKS : STILL_TICKS;
        running();
        for (unsigned k = 0; k <= 2u * most + 1u; k++) {
            board.counts = 504 + (moves != 0 ? (int32_t)(k % 100u) : 0);
            tick();
            CHECK(board.pin == (k <= most ? 120 : -150));
            if (k % 50u == 0u) {
                send(RIG_KEEP, NULL, 0);
            }
        }
        ticks(2); /* the second stands still from its second tick on */
        CHECK(board.pin == 0 && core.armed && core.running && core.fault == 0);
        for (int32_t counts = 290; counts < 710; counts += 5) {
            board.counts = counts;
            tick();
            send(RIG_KEEP, NULL, 0);
            CHECK(board.pin == 0);
        }
        board.counts = 504;
        send_drive(0);
        start(4, TO_AND_FRO);
        CHECK(started());
        tick();
        CHECK(board.pin == 120);
    }
}

static void test_when_it_may_not_start(void)
{
    armed(1);
    send(RIG_STOP, NULL, 0);
    start(4, TO_AND_FRO);
    CHECK(refused(RIG_STROKES, RIG_E_NOT_ARMED));

    armed(1);
    board.counts = LIMIT_HI + 5;
    send_arm();
    start(4, TO_AND_FRO);
    CHECK(refused(RIG_STROKES, RIG_E_TRAVEL)); /* P6 */

    static const struct {
        told_stroke one;
        uint8_t code;
    } cases[] = {
        {{MOST + 1, 700}, RIG_E_DRIVE_RANGE},
        {{32767, 700}, RIG_E_DRIVE_RANGE},
        {{0, 700}, RIG_E_SETUP},
        {{-1, 700}, RIG_E_SETUP},
        {{100, LIMIT_HI + 1}, RIG_E_SETUP},
        {{100, LIMIT_LO - 1}, RIG_E_SETUP},
        {{100, 0x7FFFFFFF}, RIG_E_SETUP},
        {{100, -0x7FFFFFFF}, RIG_E_SETUP},
    };
    for (unsigned c = 0; c < sizeof cases / sizeof cases[0]; c++) {
        for (unsigned at = 0; at < STROKES_MAX; at++) {
            told_stroke of[STROKES_MAX];
            for (unsigned i = 0; i < STROKES_MAX; i++) {
                of[i] = i == at ? cases[c].one : TO_AND_FRO[i % 4u];
                of[i].drive *= i == at && i % 2u == 1u ? -1 : 1; /* the other way there */
            }
            armed(1);
            start(STROKES_MAX, of);
            CHECK(refused(RIG_STROKES, cases[c].code));
            ticks(3);
            CHECK(board.pin == 0 && core.armed && board.blocks == 0); /* refused, no more */
        }
    }
    static const struct {
        uint8_t at;
        uint16_t value;
        uint8_t bytes;
    } fields[] = {{0, 0, 1}, {0, 1, 1},      {0, 3, 1}, {0, 10, 1},     {0, 255, 1}, {1, 0, 1},     {1, BLOCK_ROWS_MAX + 1u, 1},
                  {2, 0, 2}, {2, 10001, 2}, {4, 0, 2}, {4, 0xFFFFu, 2}, {6, 0, 2}};
    for (unsigned c = 0; c < sizeof fields / sizeof fields[0]; c++) {
        uint8_t body[BODY];
        armed(1);
        fill(body, 4, TO_AND_FRO);
        for (uint8_t i = 0; i < fields[c].bytes; i++) {
            body[fields[c].at + i] = (uint8_t)((fields[c].value >> (8 * i)) & 0xFFu);
        }
        send(RIG_STROKES, body, BODY);
        CHECK(refused(RIG_STROKES, RIG_E_SETUP) && !core.running);
    }
    uint8_t body[BODY];
    armed(1);
    fill(body, 4, TO_AND_FRO);
    send(RIG_STROKES, body, BODY - 1u);
    CHECK(refused(RIG_STROKES, RIG_E_LENGTH));
}

/* What runs does not change: neither its plan nor its law. */
static void test_nothing_changes_while_it_runs(void)
{
    static const told_stroke other[] = {{10, 800}, {-10, 200}};
    static const uint8_t gains[18] = {0};
    running();
    tick();
    start(2, other);
    CHECK(refused(RIG_STROKES, RIG_E_SETUP) && core.running && core.strokes.setup.plan[0].drive == 120);
    send(RIG_RELAY, gains, 18);
    CHECK(refused(RIG_RELAY, RIG_E_SETUP) && core.running);
    tick();
    CHECK(board.pin == 120);
}

static void test_keep_alone_keeps_it_running(void)
{
    running();
    for (int k = 0; k < 10; k++) {
        for (unsigned t = 0; t < WATCHDOG_TICKS - 2u; t++) {
            board.counts = t % 2u == 0u ? 450 : 465;
            tick();
        }
        CHECK(board.pin != 0);
        send(RIG_KEEP, NULL, 0);
        board.counts = k % 2 == 0 ? 710 : 290; /* it turns */
        tick();
    }
    send(RIG_KEEP, NULL, 0);
    for (int k = 0; k < WATCHDOG_TICKS; k++) { /* nothing else counts */
        CHECK(board.pin != 0);
        board.counts = k % 2 == 0 ? 450 : 465;
        send(RIG_READ, NULL, 0);
        send(RIG_HELLO, NULL, 0);
        start(4, TO_AND_FRO);
        CHECK(refused(RIG_STROKES, RIG_E_SETUP));
        tick();
    }
    tick();
    CHECK(board.pin == 0 && core.fault == RIG_E_WATCHDOG && !core.running);
    CHECK(last()->status == RIG_STATUS_FAULT && last()->fault == RIG_E_WATCHDOG && last()->drive[last()->n - 1] == 0);
}

/* Not even at 0 V, after two strokes that failed. */
static void test_reading_keeps_nothing_after_it_has_failed(void)
{
    running();
    for (unsigned k = 0; k <= 2u * STILL_TICKS + 3u; k++) {
        send(RIG_KEEP, NULL, 0);
        tick();
    }
    CHECK(board.pin == 0 && core.running);
    for (int k = 0; k <= WATCHDOG_TICKS; k++) {
        send(RIG_READ, NULL, 0);
        tick();
    }
    CHECK(core.fault == RIG_E_WATCHDOG && !core.running);
}

static void start_to_and_fro(void)
{
    start(4, TO_AND_FRO);
}

static void test_faults_end_it(void)
{
    check_faults_end_it(RIG_STROKES, running, start_to_and_fro);
}

static void test_stop_arm_and_drive_end_it(void)
{
    for (int which = 0; which < 3; which++) {
        running();
        ticks(13);
        if (which == 0) {
            send(RIG_STOP, NULL, 0);
        } else if (which == 1) {
            send_arm();
        } else {
            send_drive(-70);
        }
        CHECK(board.pin == (which == 2 ? -70 : 0) && !core.running && core.armed == (which > 0));
        CHECK(board.blocks == 2 && last()->n == 3 && (last()->status & RIG_STATUS_LAW) == 0);
        ticks(30);
        CHECK(board.pin == (which == 2 ? -70 : 0) && board.blocks == 2);
    }
}

/* One law after the other: neither leaves anything to the next. */
static void test_relay_and_strokes_in_turn(void)
{
    uint8_t gains[18];
    uint8_t *at = put16(put16(put16(put16(gains, -160), 40), -40), 160);
    at = put32(put32(at, 512u * RELAY_COUNT), 100000u);
    at[0] = 1;
    at[1] = BLOCK_ROWS_MAX;
    armed(1);
    for (int k = 0; k < 3; k++) {
        board.counts = 520;
        send(RIG_RELAY, gains, 18);
        CHECK(board.reply[1] == (RIG_RELAY | RIG_REPLY) && core.running);
        ticks(4);
        CHECK(board.pin == -160);
        send_drive(0);
        board.counts = 504;
        start(4, TO_AND_FRO);
        CHECK(started());
        ticks(4);
        CHECK(board.pin == 120);
        send_drive(0);
        CHECK(last()->number == 0 && last()->n == 4);
    }
}

/* A tick at any point of the main loop while it takes the request: the tick never sees half of a plan. */
static void test_a_tick_at_any_point_of_the_start(void)
{
    unsigned points = 0;
    for (unsigned at = 0; at <= points; at++) { /* first without */
        armed(1);
        board.counts = 504;
        board.points = 0;
        board.tick_at = at;
        start(4, TO_AND_FRO);
        points = at == 0 ? board.points : points;
        board.tick_at = 0;
        CHECK(started());
        tick();
        CHECK(board.pin == 120);
        send_drive(0);
        unsigned rows = 0;
        for (unsigned b = 0; b < board.blocks; b++) {
            CHECK(board.block[b].number == b);
            rows += board.block[b].n;
        }
        CHECK(rows == 1u || (at > 0 && rows == 2u));
    }
    CHECK(points >= 4);
}

int main(void)
{
    test_it_drives_each_stroke_to_its_turning_point();
    test_the_reply_repeats_it();
    test_with_negative_polarity();
    test_a_stroke_that_does_not_turn();
    test_when_it_may_not_start();
    test_nothing_changes_while_it_runs();
    test_keep_alone_keeps_it_running();
    test_reading_keeps_nothing_after_it_has_failed();
    test_faults_end_it();
    test_stop_arm_and_drive_end_it();
    test_relay_and_strokes_in_turn();
    test_a_tick_at_any_point_of_the_start();
    return report("rig_strokes");
}
