/* The stroke test in the device: how its plan gets there, when it may start, what it drives, and what ends it. */
#include "law_board.h"

#define PIECE 7u
#define PLAN_BODY 58u

typedef struct {
    int drive, ticks;
    int32_t turn;
} told_stroke;

static const told_stroke UP_AND_DOWN[] = {{120, 400, 700}, {-150, 400, 300}, {60, 400, 600}};

static void write_stroke(uint8_t *at, const told_stroke *one)
{
    (void)put32(put16(put16(at, one->drive), one->ticks), (uint32_t)one->turn);
}

static void send_piece(unsigned first, unsigned n, const told_stroke *of)
{
    uint8_t body[PLAN_BODY] = {(uint8_t)first, (uint8_t)n};
    for (unsigned i = 0; i < n && i < PIECE; i++) {
        write_stroke(&body[2u + 8u * i], &of[i]);
    }
    send(RIG_PLAN, body, PLAN_BODY);
    CHECK(board.reply_length == 0); /* the start tells whether it came */
}

static uint16_t checksum(unsigned n, const told_stroke *of)
{
    uint16_t crc = FRAME_CRC_START;
    for (unsigned i = 0; i < n; i++) {
        uint8_t bytes[8];
        write_stroke(bytes, &of[i]);
        crc = frame_crc16(crc, bytes, 8);
    }
    return crc;
}

static void send_plan(unsigned n, const told_stroke *of)
{
    for (unsigned first = 0; first < n; first += PIECE) {
        send_piece(first, n - first < PIECE ? n - first : PIECE, &of[first]);
    }
}

static void send_start(unsigned n, uint16_t crc)
{
    uint8_t body[4] = {(uint8_t)n, BLOCK_ROWS_MAX};
    (void)put16(&body[2], crc);
    send(RIG_STROKES, body, 4);
}

static void start(unsigned n, const told_stroke *of)
{
    send_plan(n, of);
    send_start(n, checksum(n, of));
}

static int started(void)
{
    return board.reply_length == 8 && board.reply[1] == (RIG_STROKES | RIG_REPLY) && core.running;
}

static void running(void)
{
    armed(1);
    start(3, UP_AND_DOWN);
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
    CHECK(board.pin == 0 && core.running && core.armed); /* over, and the rows go on until the host ends it */
    ticks(20);
    CHECK(board.pin == 0 && (last()->status & RIG_STATUS_LAW) != 0 && last()->drive[9] == 0);
    send_drive(0);
    CHECK(core.armed && !core.running && (last()->status & RIG_STATUS_LAW) == 0);
}

static void test_with_negative_polarity(void)
{
    static const told_stroke down = {120, 400, 300}; /* positive drive lowers the counts */
    armed(-1);
    start(1, &down);
    CHECK(started());
    tick();
    CHECK(board.pin == 120);
    board.counts = 300;
    tick();
    CHECK(board.pin == 0);
}

/* P12: a stroke that does not turn drives no longer than its time, to the tick. */
static void test_no_stroke_outlasts_its_time(void)
{
    static const told_stroke two[] = {{120, 30, 700}, {-150, 20, 300}};
    armed(1);
    start(2, two);
    for (int k = 0; k < 60; k++) {
        tick();
        CHECK(board.pin == (k < 30 ? 120 : k < 50 ? -150 : 0));
        if (k % 10 == 0) {
            send(RIG_KEEP, NULL, 0);
        }
    }
}

static void test_the_longest_plan(void)
{
    told_stroke of[STROKES_MAX + 1u];
    for (unsigned i = 0; i <= STROKES_MAX; i++) {
        of[i].drive = i % 2u == 0u ? 50 + (int)i : -50 - (int)i;
        of[i].ticks = 2;
        of[i].turn = i % 2u == 0u ? 890 : 110;
    }
    armed(1);
    start(STROKES_MAX, of);
    CHECK(started());
    for (unsigned i = 0; i < 2u * STROKES_MAX; i++) {
        tick();
        CHECK(board.pin == of[i / 2u].drive);
    }
    tick();
    CHECK(board.pin == 0);
    send_drive(0);
    start(STROKES_MAX + 1u, of);
    CHECK(refused(RIG_STROKES, RIG_E_PLAN));
}

/* P12: only the plan that the host means, whole. */
static void test_pieces_that_got_lost_or_came_twice(void)
{
    told_stroke of[16];
    for (unsigned i = 0; i < 16u; i++) {
        of[i] = UP_AND_DOWN[i % 3u];
    }
    const uint16_t crc = checksum(16, of);
    for (unsigned lost = 0; lost < 3u; lost++) {
        armed(1);
        for (unsigned piece = 0; piece < 3u; piece++) {
            if (piece != lost) {
                send_piece(PIECE * piece, piece < 2u ? PIECE : 2u, &of[PIECE * piece]);
            }
        }
        send_start(16, crc);
        CHECK(refused(RIG_STROKES, RIG_E_PLAN) && !core.running);
        ticks(3);
        CHECK(board.pin == 0 && board.blocks == 0);
        start(16, of); /* sent again, all of it */
        CHECK(started());
    }
    armed(1);
    send_plan(16, of);
    send_piece(PIECE, PIECE, &of[PIECE]); /* once more, late: no longer the next */
    send_start(16, crc);
    CHECK(started());

    armed(1);
    send_plan(3, UP_AND_DOWN);
    send_start(3, (uint16_t)(checksum(3, UP_AND_DOWN) ^ 1u));
    CHECK(refused(RIG_STROKES, RIG_E_PLAN));
    send_start(2, checksum(2, UP_AND_DOWN));
    CHECK(refused(RIG_STROKES, RIG_E_PLAN));
    send_start(0, FRAME_CRC_START);
    CHECK(refused(RIG_STROKES, RIG_E_PLAN));
    send_start(3, checksum(3, UP_AND_DOWN));
    CHECK(started());
    send_drive(0);
    send_start(3, checksum(3, UP_AND_DOWN)); /* the same plan again */
    CHECK(started());
    reset(&BOARD);
    CHECK(core.strokes.n == 0);
}

static void test_pieces_that_are_none(void)
{
    static const unsigned cases[][2] = {{0, 0}, {0, PIECE + 1u}, {0, 255}, {3, 1}, {1, 3}, {255, 1}, {STROKES_MAX, 1}, {254, 7}};
    for (unsigned c = 0; c < sizeof cases / sizeof cases[0]; c++) {
        told_stroke of[PIECE] = {{120, 400, 700}};
        armed(1);
        send_piece(cases[c][0], cases[c][1], of);
        CHECK(core.strokes.n == 0);
    }
    armed(1);
    uint8_t body[PLAN_BODY - 1u] = {0, 1};
    send(RIG_PLAN, body, sizeof body);
    CHECK(refused(RIG_PLAN, RIG_E_LENGTH));
    send(RIG_STROKES, body, 3);
    CHECK(refused(RIG_STROKES, RIG_E_LENGTH));
}

static void test_when_it_may_not_start(void)
{
    armed(1);
    send(RIG_STOP, NULL, 0);
    start(3, UP_AND_DOWN);
    CHECK(refused(RIG_STROKES, RIG_E_NOT_ARMED));

    armed(1);
    board.counts = LIMIT_HI + 5;
    send_arm();
    start(3, UP_AND_DOWN);
    CHECK(refused(RIG_STROKES, RIG_E_TRAVEL)); /* P6 */

    static const struct {
        told_stroke one;
        uint8_t code;
    } cases[] = {
        {{MOST + 1, 100, 700}, RIG_E_DRIVE_RANGE},
        {{-(MOST + 1), 100, 300}, RIG_E_DRIVE_RANGE},
        {{-32768, 100, 300}, RIG_E_DRIVE_RANGE},
        {{0, 100, 700}, RIG_E_SETUP},
        {{100, 0, 700}, RIG_E_SETUP},
        {{100, STROKE_TICKS_MAX + 1, 700}, RIG_E_SETUP},
        {{100, 100, LIMIT_HI + 1}, RIG_E_SETUP},
        {{-100, 100, LIMIT_LO - 1}, RIG_E_SETUP},
        {{-100, 100, -0x7FFFFFFF}, RIG_E_SETUP},
    };
    for (unsigned c = 0; c < sizeof cases / sizeof cases[0]; c++) {
        for (unsigned at = 0; at < 9u; at += 4u) { /* in either piece */
            told_stroke of[9];
            for (unsigned i = 0; i < 9u; i++) {
                of[i] = i == at ? cases[c].one : UP_AND_DOWN[i % 3u];
            }
            armed(1);
            start(9, of);
            CHECK(refused(RIG_STROKES, cases[c].code));
            ticks(3);
            CHECK(board.pin == 0 && core.armed && board.blocks == 0); /* refused, no more */
        }
    }
    armed(1);
    send_plan(3, UP_AND_DOWN);
    uint8_t body[4] = {3, BLOCK_ROWS_MAX + 1u};
    (void)put16(&body[2], checksum(3, UP_AND_DOWN));
    send(RIG_STROKES, body, 4);
    CHECK(refused(RIG_STROKES, RIG_E_SETUP));
    body[1] = 0;
    send(RIG_STROKES, body, 4);
    CHECK(refused(RIG_STROKES, RIG_E_SETUP));
}

/* What runs does not change: neither its plan nor its law. */
static void test_nothing_changes_while_it_runs(void)
{
    static const told_stroke other = {-10, 9, 110};
    static const uint8_t gains[18] = {0};
    running();
    tick();
    send_piece(0, 1, &other);
    CHECK(core.strokes.n == 3 && core.strokes.plan[0].drive == 120);
    send_start(3, checksum(3, UP_AND_DOWN));
    CHECK(refused(RIG_STROKES, RIG_E_SETUP) && core.running);
    send(RIG_RELAY, gains, 18);
    CHECK(refused(RIG_RELAY, RIG_E_SETUP) && core.running);
    tick();
    CHECK(board.pin == 120);
}

static void test_keep_alone_keeps_it_running(void)
{
    static const told_stroke slow = {120, STROKE_TICKS_MAX, 700};
    armed(1);
    start(1, &slow);
    for (int k = 0; k < 10; k++) {
        ticks(WATCHDOG_TICKS - 1);
        CHECK(board.pin == 120);
        send(RIG_KEEP, NULL, 0);
    }
    for (int k = 0; k < WATCHDOG_TICKS; k++) { /* nothing else counts, a new plan neither */
        send(RIG_READ, NULL, 0);
        send_piece(0, 1, &slow);
        send_start(1, checksum(1, &slow));
        CHECK(refused(RIG_STROKES, RIG_E_SETUP));
        tick();
    }
    tick();
    CHECK(board.pin == 0 && core.fault == RIG_E_WATCHDOG && !core.running);
    CHECK(last()->status == RIG_STATUS_FAULT && last()->fault == RIG_E_WATCHDOG && last()->drive[last()->n - 1] == 0);
}

/* Not even at 0 V, after its last stroke. */
static void test_reading_keeps_nothing_after_the_last_stroke(void)
{
    static const told_stroke brief = {120, 1, 700};
    armed(1);
    start(1, &brief);
    for (int k = 0; k <= WATCHDOG_TICKS; k++) {
        send(RIG_READ, NULL, 0);
        tick();
    }
    CHECK(core.fault == RIG_E_WATCHDOG && !core.running);
}

/* A plan keeps no drive alive, and no armed device that stands at 0. */
static void test_a_plan_is_no_voice(void)
{
    for (int units = 0; units <= 50; units += 50) {
        armed(1);
        send_drive(units);
        for (int k = 0; k <= WATCHDOG_TICKS; k++) {
            send_piece(0, 3, UP_AND_DOWN);
            tick();
        }
        CHECK(board.pin == 0 && core.fault == RIG_E_WATCHDOG);
    }
}

static void test_faults_end_it(void)
{
    static const struct {
        int32_t counts;
        uint8_t inputs, code;
    } cases[] = {{LIMIT_HI + 1, 0, RIG_E_TRAVEL},  {LIMIT_LO - 1, 0, RIG_E_TRAVEL},
                 {1018, 0, RIG_E_SENSOR},          {5, 0, RIG_E_SENSOR},
                 {512, RIG_INPUT_ESTOP, RIG_E_ESTOP}, {512, RIG_INPUT_END_LOW, RIG_E_END_SWITCH}};
    for (unsigned c = 0; c < sizeof cases / sizeof cases[0]; c++) {
        for (unsigned phase = 0; phase < 12u; phase++) {
            running();
            ticks(phase + 1u);
            CHECK(board.pin == 120);
            board.counts = cases[c].counts;
            board.inputs = cases[c].inputs;
            tick();
            CHECK(board.pin == 0 && core.latched && core.fault == cases[c].code && !core.running && !core.armed);
            const told_block *told = last();
            CHECK(told->status == RIG_STATUS_FAULT && told->fault == cases[c].code);
            CHECK(told->n >= 1 && told->counts[told->n - 1] == cases[c].counts && told->drive[told->n - 1] == 0);
            board.counts = 520;
            board.inputs = 0;
            ticks(30);
            CHECK(board.pin == 0);
            start(3, UP_AND_DOWN);
            CHECK(refused(RIG_STROKES, cases[c].code)); /* P7 */
        }
    }
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
        start(3, UP_AND_DOWN);
        CHECK(started());
        ticks(4);
        CHECK(board.pin == 120);
        send_drive(0);
        CHECK(last()->number == 0 && last()->n == 4);
    }
}

/* A tick at any point of the main loop while it takes the plan or starts it: the tick never sees half of either. */
static void test_a_tick_at_any_point_of_plan_and_start(void)
{
    unsigned points = 0;
    for (unsigned at = 0; at <= points; at++) { /* first without */
        armed(1);
        board.points = 0;
        board.tick_at = at;
        start(3, UP_AND_DOWN);
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
    test_with_negative_polarity();
    test_no_stroke_outlasts_its_time();
    test_the_longest_plan();
    test_pieces_that_got_lost_or_came_twice();
    test_pieces_that_are_none();
    test_when_it_may_not_start();
    test_nothing_changes_while_it_runs();
    test_keep_alone_keeps_it_running();
    test_reading_keeps_nothing_after_the_last_stroke();
    test_a_plan_is_no_voice();
    test_faults_end_it();
    test_stop_arm_and_drive_end_it();
    test_relay_and_strokes_in_turn();
    test_a_tick_at_any_point_of_plan_and_start();
    return report("rig_strokes");
}
