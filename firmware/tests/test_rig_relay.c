/* The relay in the device: when it may start, what it drives, what ends it, and what the host is told of it. */
#include "law_board.h"

/* Drives of the four states by sign of h2 - h1 = 40; polarity and direction as given. */
static void fill(uint8_t body[18], int direction, int polarity)
{
    const int sign = direction * polarity;
    uint8_t *at = put16(body, -160 * sign);
    at = put16(at, 40 * sign);
    at = put16(at, -40 * sign);
    at = put16(at, 160 * sign);
    at = put32(put32(at, 512u * RELAY_COUNT), 100000u);
    at[0] = (uint8_t)direction;
    at[1] = BLOCK_ROWS_MAX;
}

static void start_as(int direction, int polarity)
{
    uint8_t body[18];
    fill(body, direction, polarity);
    send(RIG_RELAY, body, 18);
}

static int started(void)
{
    return board.reply_length == 22 && board.reply[1] == (RIG_RELAY | RIG_REPLY) && core.running;
}

static void running(void)
{
    armed(1);
    start_as(1, 1);
    CHECK(started());
}

static void test_it_drives_at_each_tick(void)
{
    running();
    CHECK(board.pin == 0); /* from the next tick on */
    tick();
    CHECK(board.pin == -160);
    board.counts = 511;
    tick();
    CHECK(board.pin == -40); /* z is still positive */
    board.counts = 400;
    tick();
    CHECK(board.pin == 160);
    board.counts = 513;
    ticks(1);
    CHECK(board.pin == 40);
    CHECK(core.armed && core.running && core.fault == 0);
}

static void test_either_direction_and_polarity(void)
{
    for (int polarity = -1; polarity <= 1; polarity += 2) {
        for (int direction = -1; direction <= 1; direction += 2) {
            armed(polarity);
            start_as(direction, polarity);
            CHECK(started());
            tick();
            /* the counts are above the centre: the drive must lower them */
            CHECK(board.pin == -160 * polarity);
            armed(polarity);
            start_as(direction, -polarity);
            CHECK(refused(RIG_RELAY, RIG_E_POLARITY) && !core.running);
        }
    }
}

static void test_rows_in_blocks(void)
{
    running();
    int32_t sent[25];
    int16_t driven[25];
    for (unsigned k = 0; k < 25u; k++) {
        board.counts = (int32_t)(505u + (k * 7u) % 16u);
        sent[k] = board.counts;
        tick();
        driven[k] = board.pin;
    }
    CHECK(board.blocks == 2);
    send_drive(0);
    CHECK(board.pin == 0 && board.blocks == 3 && !core.running && core.armed);
    unsigned row = 0;
    for (unsigned b = 0; b < 3u; b++) {
        const told_block *told = &board.block[b];
        CHECK(told->number == b && told->period_us == RIG_TICK_US && told->fault == 0);
        CHECK(told->t_us == (1u + row) * RIG_TICK_US && told->session == SESSION);
        CHECK(told->n == (b < 2u ? 10 : 5));
        CHECK(told->status == (b < 2u ? (RIG_STATUS_ARMED | RIG_STATUS_LAW) : RIG_STATUS_ARMED));
        CHECK(told->delay_us == 7);
        for (unsigned i = 0; i < told->n; i++, row++) {
            CHECK(told->counts[i] == sent[row] && told->drive[i] == driven[row]);
        }
    }
    CHECK(row == 25);
    ticks(30);
    CHECK(board.blocks == 3); /* nothing more */
}

static void test_late_and_skipped_ticks_begin_a_block(void)
{
    running();
    ticks(3);
    board.now_us += 4000;
    ticks(4);
    board.now_us += 150; /* a row off the grid, by more than the jitter that is allowed */
    interrupt();
    rig_stream(&core);
    ticks(2);
    send(RIG_STOP, NULL, 0);
    CHECK(board.blocks == 4);
    CHECK(board.block[0].n == 3 && board.block[1].n == 4 && board.block[2].n == 1 && board.block[3].n == 2);
    CHECK(board.block[0].t_us == 1000 && board.block[1].t_us == 8000);
    CHECK(board.block[2].t_us % 1000u != 0u && board.block[3].number == 3);
}

/* 16 bits hold how far a row is from the first of its block: positions of 32 bits come whole. */
static void test_far_positions(void)
{
    rig_board far = BOARD;
    far.counts_max = 0x7FFFFFFF;
    static const int32_t step[] = {0, 30000, 32767, 32768, 3, 0, -32000};
    static const int32_t centre = 16000000;
    armed_about(centre, &far, 1);
    core.setup.hard_lo = centre - 40000;
    core.setup.hard_hi = centre + 40000;
    memcpy(&seen, &core, sizeof core);
    uint8_t body[18];
    fill(body, 1, 1);
    (void)put32(body + 8, (uint32_t)centre * RELAY_COUNT);
    send(RIG_RELAY, body, 18);
    CHECK(started());
    for (unsigned k = 0; k < 7u; k++) {
        board.counts = centre + step[k];
        tick();
    }
    send_drive(0);
    CHECK(board.blocks == 3 && board.block[0].n == 3 && board.block[1].n == 3 && board.block[2].n == 1);
    unsigned row = 0;
    for (unsigned b = 0; b < board.blocks; b++) {
        for (unsigned i = 0; i < board.block[b].n; i++, row++) {
            CHECK(board.block[b].counts[i] == centre + step[row]);
        }
    }
    CHECK(row == 7u);

    armed_about(centre, &far, 1); /* limits so wide that its numbers have no room */
    core.setup.hard_hi = centre + RELAY_REACH_MAX + 1;
    memcpy(&seen, &core, sizeof core);
    send(RIG_RELAY, body, 18);
    CHECK(refused(RIG_RELAY, RIG_E_SETUP));
}

static void test_a_block_that_nobody_sends_is_missed(void)
{
    running();
    for (int k = 0; k < 35; k++) {
        board.now_us += RIG_TICK_US;
        interrupt(); /* and no rig_stream */
    }
    rig_stream(&core);
    ticks(15);
    CHECK(board.blocks == 4);
    CHECK(board.block[0].number == 0 && board.block[1].number == 1);
    CHECK(board.block[2].number == 3 && board.block[3].number == 4);
}

static void test_keep_alone_keeps_it_running(void)
{
    running();
    for (int k = 0; k < 30; k++) {
        ticks(WATCHDOG_TICKS - 1);
        CHECK(board.pin != 0);
        send(RIG_KEEP, NULL, 0);
        CHECK(board.reply_length == 0);
    }
    for (int k = 0; k < WATCHDOG_TICKS; k++) { /* READ, HELLO and what is refused do not count */
        send(RIG_READ, NULL, 0);
        send(RIG_HELLO, NULL, 0);
        start_as(1, 1);
        CHECK(refused(RIG_RELAY, RIG_E_SETUP));
        tick();
    }
    tick();
    CHECK(board.pin == 0 && core.latched != 0u && core.fault == RIG_E_WATCHDOG && !core.running);
    CHECK(last()->status == RIG_STATUS_FAULT && last()->fault == RIG_E_WATCHDOG && last()->drive[last()->n - 1] == 0);
    const unsigned told = board.blocks;
    send(RIG_KEEP, NULL, 0);
    ticks(20);
    CHECK(board.pin == 0 && board.blocks == told);
}

static void test_keep_keeps_nothing_else(void)
{
    armed(1);
    send_drive(50);
    for (int k = 0; k <= WATCHDOG_TICKS; k++) {
        send(RIG_KEEP, NULL, 0);
        tick();
    }
    CHECK(board.pin == 0 && core.fault == RIG_E_WATCHDOG);
}

static void start_plain(void)
{
    start_as(1, 1);
}

static void test_faults_end_it(void)
{
    check_faults_end_it(RIG_RELAY, running, start_plain);
}

static void test_a_read_sees_the_limit_too(void)
{
    running();
    ticks(4);
    board.counts = LIMIT_HI + 1;
    send(RIG_READ, NULL, 0);
    CHECK(board.pin == 0 && !core.running && last()->n == 4 && last()->fault == RIG_E_TRAVEL);
}

static void test_stop_and_arm_end_it(void)
{
    for (int which = 0; which < 2; which++) {
        running();
        ticks(13);
        if (which == 0) {
            send(RIG_STOP, NULL, 0);
        } else {
            send_arm();
        }
        CHECK(board.pin == 0 && !core.running && core.armed == (which == 1));
        CHECK(board.blocks == 2 && last()->n == 3 && (last()->status & RIG_STATUS_LAW) == 0);
        ticks(30);
        CHECK(board.pin == 0 && board.blocks == 2);
    }
}

static void test_drive_takes_over(void)
{
    running();
    ticks(10);
    send_drive(-70);
    CHECK(board.pin == -70 && core.armed && !core.running);
    CHECK(last()->number == 1 && last()->n == 0 && last()->status == RIG_STATUS_ARMED); /* the end is told, empty */
    ticks(3);
    CHECK(board.pin == -70);
    start_as(1, 1); /* and it can be started again */
    CHECK(started());
    tick();
    CHECK(board.pin == -160);
    send_drive(MOST + 1);
    CHECK(board.pin == 0 && core.fault == RIG_E_DRIVE_RANGE && !core.running);
    CHECK(last()->number == 0 && last()->n == 1 && last()->fault == RIG_E_DRIVE_RANGE);
}

static void test_when_it_may_not_start(void)
{
    uint8_t body[18];
    armed(1);
    send(RIG_STOP, NULL, 0);
    start_as(1, 1);
    CHECK(refused(RIG_RELAY, RIG_E_NOT_ARMED));

    armed(1);
    board.counts = LIMIT_HI + 5;
    send_arm();
    CHECK(core.recovering == 1);
    start_as(1, 1);
    CHECK(refused(RIG_RELAY, RIG_E_TRAVEL)); /* P6 */

    static const struct {
        uint8_t at;
        uint32_t value;
        uint8_t bytes, code;
    } cases[] = {
        {0, (uint16_t)-(MOST + 1), 2, RIG_E_DRIVE_RANGE}, {2, MOST + 1, 2, RIG_E_DRIVE_RANGE},
        {4, 0x8000u, 2, RIG_E_DRIVE_RANGE},               {6, MOST + 1, 2, RIG_E_DRIVE_RANGE},
        {0, 1, 2, RIG_E_POLARITY},                        {6, 0xFFFFu, 2, RIG_E_POLARITY},
        {8, RELAY_CENTRE_MAX + 1, 4, RIG_E_SETUP},        {8, 0x80000000u, 4, RIG_E_SETUP},
        {8, (512 + RELAY_REACH_MAX) * 16, 4, RIG_E_SETUP},
        {12, 0, 4, RIG_E_SETUP},                          {12, RELAY_Z_MAX + 1, 4, RIG_E_SETUP},
        {12, 0xFFFFFFFFu, 4, RIG_E_SETUP},                {16, 0, 1, RIG_E_SETUP},
        {16, 2, 1, RIG_E_SETUP},                          {17, 0, 1, RIG_E_SETUP},
        {17, BLOCK_ROWS_MAX + 1, 1, RIG_E_SETUP},
    };
    for (unsigned c = 0; c < sizeof cases / sizeof cases[0]; c++) {
        armed(1);
        fill(body, 1, 1);
        for (uint8_t i = 0; i < cases[c].bytes; i++) {
            body[cases[c].at + i] = (uint8_t)((cases[c].value >> (8 * i)) & 0xFFu);
        }
        send(RIG_RELAY, body, 18);
        CHECK(refused(RIG_RELAY, cases[c].code));
        ticks(3);
        CHECK(board.pin == 0 && core.armed && board.blocks == 0); /* refused, no more */
    }
    armed(1);
    fill(body, 1, 1);
    send(RIG_RELAY, body, 17);
    CHECK(refused(RIG_RELAY, RIG_E_LENGTH));
}

static void test_gains_do_not_change_while_it_runs(void)
{
    running();
    tick();
    start_as(1, 1);
    CHECK(refused(RIG_RELAY, RIG_E_SETUP) && core.running);
    uint8_t body[30] = {0};
    send(RIG_SETUP, body, 30);
    CHECK(refused(RIG_SETUP, RIG_E_SETUP) && core.running);
}

static void test_a_reset_forgets_it(void)
{
    running();
    ticks(3);
    reset(&BOARD);
    CHECK(board.pin == 0 && !core.running);
    ticks(30);
    CHECK(board.pin == 0 && board.blocks == 0);
}

/* The numbers of blocks and the device's clock both wrap. */
static void test_wraps(void)
{
    running();
    board.now_us = 0u - 5u * RIG_TICK_US;
    send(RIG_KEEP, NULL, 0);
    core.blocks.ring[core.blocks.in].number = 0xFFFFu;
    memcpy(&seen, &core, sizeof core);
    for (int k = 0; k < 20; k++) {
        board.now_us += RIG_TICK_US;
        interrupt();
        rig_stream(&core);
    }
    CHECK(board.blocks == 2 && board.block[0].number == 0xFFFFu && board.block[1].number == 0);
    CHECK(board.block[0].n == 10 && board.block[1].t_us - board.block[0].t_us == 10u * RIG_TICK_US + 7u);
}

/* The main loop was away for nearly two blocks' time: each row comes, in order. */
static void test_a_main_loop_that_was_away_loses_nothing(void)
{
    for (unsigned away = 1; away < 2u * BLOCK_ROWS_MAX; away++) {
        running();
        for (unsigned k = 0; k < away; k++) {
            board.now_us += RIG_TICK_US - board.now_us % RIG_TICK_US;
            interrupt();
        }
        ticks(25);
        send_drive(0);
        unsigned rows = 0;
        for (unsigned b = 0; b < board.blocks; b++) {
            CHECK(board.block[b].number == b && (board.block[b].n == 0 || board.block[b].t_us == (1u + rows) * RIG_TICK_US));
            rows += board.block[b].n;
        }
        CHECK(rows == away + 25u);
    }
}

/* A tick at any point of the main loop while it takes the request that ends the relay: the rows are whole, the last block
 * tells the end, nothing drives after it. */
static void test_a_tick_between_any_two_steps_of_the_main_loop(void)
{
    static const uint8_t requests[] = {RIG_STOP, RIG_ARM, RIG_DRIVE, RIG_READ};
    static const uint8_t session[4] = {SESSION, 0, 0, 0}; /* of ARM; of DRIVE: any */
    static const uint8_t lengths[] = {0, 4, 2, 0};
    for (unsigned r = 0; r < sizeof requests; r++) {
        for (unsigned phase = 0; phase < 21u; phase++) {
            unsigned points = 0;
            for (unsigned at = 0; at <= points; at++) { /* first without */
                running();
                for (unsigned k = 0; k < phase; k++) {
                    board.now_us += RIG_TICK_US - board.now_us % RIG_TICK_US;
                    interrupt(); /* and no rig_stream: up to two blocks wait */
                    if (k % BLOCK_ROWS_MAX == 4u) {
                        rig_stream(&core);
                    }
                }
                board.points = 0;
                board.tick_at = at;
                board.counts = requests[r] == RIG_READ ? LIMIT_HI + 1 : 520;
                send(requests[r], requests[r] == RIG_DRIVE ? session + 2 : session, lengths[r]);
                points = at == 0 ? board.points : points;
                board.tick_at = 0;
                rig_stream(&core); /* a tick may have closed one more */
                const bool answered = requests[r] == RIG_DRIVE || board.reply[1] == (requests[r] | RIG_REPLY);
                CHECK(answered && board.pin == 0 && !core.running && core.armed == (requests[r] == RIG_ARM || requests[r] == RIG_DRIVE));
                unsigned rows = 0;
                for (unsigned b = 0; b < board.blocks; b++) {
                    const told_block *told = &board.block[b];
                    const bool is_last = b + 1u == board.blocks;
                    CHECK(told->number == b && (told->status & RIG_STATUS_LAW) == (is_last ? 0 : RIG_STATUS_LAW));
                    CHECK(told->n == 0 || told->t_us == (1u + rows) * RIG_TICK_US);
                    rows += told->n;
                }
                CHECK(rows == phase || (at > 0 && rows == phase + 1u));
                const unsigned told = board.blocks;
                ticks(15);
                CHECK(board.pin == 0 && board.blocks == told);
            }
            CHECK(points >= 4);
        }
    }
}

/* DRIVE, and a tick that sees the limit at any point around it: either way nothing is left at the pin. */
static void test_a_fault_at_any_point_of_a_request(void)
{
    uint8_t body[2];
    (void)put16(body, 60);
    unsigned points = 0;
    for (unsigned at = 0; at <= points; at++) {
        armed(1);
        board.points = 0;
        board.tick_at = at;
        board.inputs = RIG_INPUT_ESTOP;
        send(RIG_DRIVE, body, 2);
        points = at == 0 ? board.points : points;
        CHECK(at == 0 ? board.pin == 60 : board.pin == 0 && core.fault == RIG_E_ESTOP);
        tick();
        CHECK(board.pin == 0 && core.latched && core.fault == RIG_E_ESTOP);
    }
    CHECK(points >= 2);
}

int main(void)
{
    test_it_drives_at_each_tick();
    test_either_direction_and_polarity();
    test_rows_in_blocks();
    test_late_and_skipped_ticks_begin_a_block();
    test_far_positions();
    test_a_block_that_nobody_sends_is_missed();
    test_keep_alone_keeps_it_running();
    test_keep_keeps_nothing_else();
    test_faults_end_it();
    test_a_read_sees_the_limit_too();
    test_stop_and_arm_end_it();
    test_drive_takes_over();
    test_when_it_may_not_start();
    test_gains_do_not_change_while_it_runs();
    test_a_reset_forgets_it();
    test_wraps();
    test_a_main_loop_that_was_away_loses_nothing();
    test_a_tick_between_any_two_steps_of_the_main_loop();
    test_a_fault_at_any_point_of_a_request();
    return report("rig_relay");
}
