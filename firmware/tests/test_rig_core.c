/* Every device rule of the wire protocol, on a board of plain variables. */
#include "plain_board.h"

#define FULL 799

static struct {
    bool wired;
    bool begun;
    unsigned hung;
} loopback;

static bool fake_begin(void)
{
    loopback.begun = true;
    return loopback.wired;
}

static void fake_end(void)
{
    loopback.begun = false;
}

static void fake_open(bool open)
{
    board.inputs = open ? RIG_INPUT_ESTOP : 0u;
}

static void fake_look(rig_loopback_view *view, bool share)
{
    view->looks = share ? 7u : 0u;
    view->high = 2;
    view->wire[1].last_us = 0x12345678u;
}

static void fake_hang(void)
{
    loopback.hung++;
}

static const rig_loopback_board LOOPBACK = {fake_begin, fake_end, fake_open, fake_look, fake_hang};

static const rig_board BOARD = {PLAIN_BOARD,
                                .build = "build 12345678901234567890",
                                .counts_max = 1023,
                                .drive_full = FULL,
                                .bridge = RIG_BRIDGE_IN1_IN2,
                                .features = RIG_FEATURE_TACHOMETER,
                                .loopback = &LOOPBACK};

static void power_on(void)
{
    memset(&loopback, 0, sizeof loopback);
    start(&BOARD, RIG_RESET_BROWN_OUT);
    board.counts = 512;
}

static uint16_t got_u16(unsigned at)
{
    return u16(board.got + 4 + at);
}

static uint32_t got_u32(unsigned at)
{
    return u32(board.got + 4 + at);
}

/* Whether exactly one reply came, of this type and length of body, with our seq. */
static int replied(uint8_t type, unsigned length)
{
    return board.replies == 1 && board.got_length == 4 + length && board.got[0] == RIG_PROTOCOL && board.got[1] == type &&
           board.got[2] == (seq & 0xFF) && board.got[3] == seq >> 8;
}

static int refused(uint8_t type, uint8_t code)
{
    return replied(RIG_NACK, 2) && board.got[4] == code && board.got[5] == type;
}

/* The set-up of these tests, one field of which a test may change. */
enum { THE_SESSION, HARD_LO, HARD_HI, RAIL_LO, RAIL_HI, CENTRE, MAX_DRIVE, WATCHDOG, POLARITY, FIELDS };

#define SESSION 0x89ABCDEF
#define STATE_LENGTH 24
#define SETUP_LENGTH 30

static void send_setup(int field, int32_t value)
{
    int32_t fields[FIELDS] = {(int32_t)SESSION, 100, 900, 5, 1018, 500, 200, 100, 1};
    uint8_t body[SETUP_LENGTH];
    if (field < FIELDS) {
        fields[field] = value;
    }
    for (int i = 0; i < MAX_DRIVE; i++) {
        put32(body + 4 * i, (uint32_t)fields[i]);
    }
    put16(body + 24, fields[MAX_DRIVE]);
    put16(body + 26, fields[WATCHDOG]);
    body[28] = (uint8_t)fields[POLARITY];
    body[29] = 0;
    send_raw(RIG_PROTOCOL, RIG_SETUP, body, SETUP_LENGTH);
}

static void send_drive(int units)
{
    uint8_t body[2];
    put16(body, units);
    send_raw(RIG_PROTOCOL, RIG_DRIVE, body, 2);
}

static void send_pulse(int units, unsigned longest_ms)
{
    uint8_t body[4];
    put16(body, units);
    body[2] = (uint8_t)(longest_ms & 0xFFu);
    body[3] = (uint8_t)(longest_ms >> 8);
    send_raw(RIG_PROTOCOL, RIG_PULSE, body, 4);
}

static uint8_t send_arm_of(uint32_t session)
{
    uint8_t body[4];
    put32(body, session);
    send_raw(RIG_PROTOCOL, RIG_ARM, body, 4);
    CHECK(replied(RIG_ARM | RIG_REPLY, 1));
    return board.got[4];
}

static uint8_t send_arm(void)
{
    return send_arm_of(SESSION);
}

/* RIG_OK, or why it is refused. */
static uint8_t send_ack(uint8_t code)
{
    send_raw(RIG_PROTOCOL, RIG_ACK, &code, 1);
    if (replied(RIG_NACK, 2)) {
        return board.got[4];
    }
    CHECK(replied(RIG_ACK | RIG_REPLY, STATE_LENGTH));
    return RIG_OK;
}

/* Somebody has seen this fault, and arms again. */
static uint8_t send_ack_and_arm(uint8_t code)
{
    CHECK(send_ack(code) == RIG_OK);
    return send_arm();
}

static void send_read(void)
{
    send_raw(RIG_PROTOCOL, RIG_READ, NULL, 0);
    CHECK(replied(RIG_READ | RIG_REPLY, STATE_LENGTH));
}

/* Fields of the STATE last received. */
static int16_t state_drive(void)
{
    return (int16_t)got_u16(14);
}
static uint8_t state_status(void)
{
    return board.got[4 + 18];
}
static uint8_t state_fault(void)
{
    return board.got[4 + 19];
}

static void armed(void)
{
    power_on();
    send_setup(FIELDS, 0);
    CHECK(replied(RIG_SETUP | RIG_REPLY, SETUP_LENGTH));
    CHECK(send_ack_and_arm(RIG_E_RESET) == RIG_OK);
}

/* Checks that a fault is latched: 0 at the pin whatever is commanded, and STOP and ARM clear nothing. */
static void check_latched(uint8_t code)
{
    CHECK(board.pin == 0);
    send_drive(50);
    CHECK(board.pin == 0 && board.replies == 0);
    send_read();
    CHECK(state_drive() == 0 && state_status() == RIG_STATUS_FAULT && state_fault() == code);
    send_raw(RIG_PROTOCOL, RIG_STOP, NULL, 0);
    CHECK(send_arm() == code && !core.armed);
    send_drive(50);
    CHECK(board.pin == 0);
    send_read();
    CHECK(state_status() == RIG_STATUS_FAULT && state_fault() == code);
}

static void check_latched_in_loopback(uint8_t code)
{
    CHECK(board.pin == 0 && send_arm() == code && !core.armed);
    send_drive(50);
    CHECK(board.pin == 0);
}

static void test_after_reset(void)
{
    power_on();
    CHECK(board.pin == 0);
    send_read();
    CHECK(state_status() == RIG_STATUS_FAULT && state_fault() == RIG_E_RESET && state_drive() == 0); /* P10 */
    CHECK(got_u32(0) == board.now_us && got_u32(4) == 512 && got_u16(8) == RIG_TACH_NONE && got_u32(20) == 0);
    CHECK(send_arm() == RIG_E_RESET);
    CHECK(send_ack(RIG_E_RESET) == RIG_OK);
    CHECK(send_arm() == RIG_E_NO_SETUP);
    send_drive(50);
    CHECK(board.pin == 0 && board.replies == 0);
    send_read();
    CHECK(state_fault() == RIG_E_NOT_ARMED && state_status() == 0); /* told, but not latched */
    send_setup(FIELDS, 0);
    send_drive(50);
    CHECK(board.pin == 0); /* set up is not armed */
    CHECK(send_arm() == RIG_OK);
    send_read();
    CHECK(state_fault() == 0 && state_status() == RIG_STATUS_ARMED);
    CHECK(got_u32(20) == SESSION);
    rig_init(&core, &BOARD, RIG_RESET_WATCHDOG);
    send_drive(50);
    CHECK(board.pin == 0 && send_arm() == RIG_E_RESET);
    CHECK(send_ack_and_arm(RIG_E_RESET) == RIG_E_NO_SETUP); /* a reset forgets everything */
    send_read();
    CHECK(got_u32(20) == 0); /* P11 */
}

static void test_hello(void)
{
    power_on();
    board.now_us = 0xFEDCBA98u;
    send_raw(RIG_PROTOCOL, RIG_HELLO, NULL, 0);
    CHECK(replied(RIG_HELLO | RIG_REPLY, 31));
    CHECK(board.got[4] == RIG_BOARD_HOST && board.got[5] == RIG_RESET_BROWN_OUT);
    CHECK(board.got[6] == RIG_BRIDGE_IN1_IN2 && board.got[7] == (RIG_FEATURE_TACHOMETER | RIG_FEATURE_PULSE | RIG_FEATURE_LOOPBACK | RIG_FEATURE_STROKES));
    CHECK(got_u32(4) == 1023 && got_u16(8) == FULL && got_u32(10) == 0xFEDCBA98u && board.got[18] == 0);
    CHECK(memcmp(board.got + 19, "build 1234567890", 16) == 0);
}

static void test_setup(void)
{
    static const struct {
        int field;
        int32_t value;
    } wrong[] = {{HARD_LO, 900},  {HARD_HI, 100},         {RAIL_LO, 1018}, {RAIL_HI, 5},     {RAIL_HI, 1024},
                 {MAX_DRIVE, 0},  {MAX_DRIVE, FULL + 1},  {WATCHDOG, 0},   {WATCHDOG, 1001}, {POLARITY, 0},
                 {POLARITY, 2},   {MAX_DRIVE, 0xFFFF},    {POLARITY, -2},  {POLARITY, -128},
                 {THE_SESSION, 0}, {RAIL_LO, -1}};
    power_on();
    CHECK(send_ack(RIG_E_RESET) == RIG_OK);
    for (unsigned i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        send_setup(wrong[i].field, wrong[i].value);
        CHECK(refused(RIG_SETUP, RIG_E_SETUP));
        CHECK(send_arm() == RIG_E_NO_SETUP); /* nothing of it is kept */
    }
    send_setup(POLARITY, -1);
    CHECK(replied(RIG_SETUP | RIG_REPLY, SETUP_LENGTH));
    CHECK(got_u32(0) == SESSION && got_u32(4) == 100 && got_u32(8) == 900 && got_u32(12) == 5 && got_u32(16) == 1018);
    CHECK(got_u32(20) == 500 && got_u16(24) == 200 && got_u16(26) == 100);
    CHECK(board.got[4 + 28] == 0xFF && board.got[4 + 29] == 0);
    send_setup(MAX_DRIVE, FULL);
    CHECK(replied(RIG_SETUP | RIG_REPLY, SETUP_LENGTH));
    send_setup(WATCHDOG, 1000);
    CHECK(replied(RIG_SETUP | RIG_REPLY, SETUP_LENGTH));
}

static void test_setup_while_armed(void)
{
    armed();
    send_drive(150);
    send_setup(MAX_DRIVE, 300);
    CHECK(refused(RIG_SETUP, RIG_E_SETUP));
    CHECK(board.pin == 150 && core.setup.max_drive == 200 && core.armed);
    send_raw(RIG_PROTOCOL, RIG_STOP, NULL, 0);
    send_setup(MAX_DRIVE, 300);
    CHECK(replied(RIG_SETUP | RIG_REPLY, SETUP_LENGTH));
}

static void test_drive(void)
{
    armed();
    board.now_us += 250;
    send_drive(-200);
    const uint16_t drive_seq = seq;
    CHECK(board.pin == -200 && board.replies == 0); /* no reply of its own */
    const uint32_t t_drive = board.now_us;
    board.now_us += 300;
    board.counts = 640;
    board.tach = 77;
    send_read();
    CHECK(state_drive() == -200 && got_u16(16) == drive_seq && got_u32(10) == t_drive);
    CHECK(got_u32(0) == board.now_us && got_u32(4) == 640 && got_u16(8) == 77);
    CHECK(state_status() == RIG_STATUS_ARMED && state_fault() == 0);
    send_drive(200);
    CHECK(board.pin == 200);
}

static void test_drive_range(void)
{
    static const int beyond[] = {201, -201, 799, 32767, -32768};
    for (unsigned i = 0; i < sizeof beyond / sizeof beyond[0]; i++) {
        armed();
        send_drive(100);
        const uint16_t accepted = seq;
        send_drive(beyond[i]);
        check_latched(RIG_E_DRIVE_RANGE);
        CHECK(got_u16(16) == accepted);
    }
}

static void test_stop(void)
{
    armed();
    send_drive(100);
    send_raw(RIG_PROTOCOL, RIG_STOP, NULL, 0);
    CHECK(replied(RIG_STOP | RIG_REPLY, STATE_LENGTH));
    CHECK(board.pin == 0 && state_drive() == 0 && state_status() == 0 && state_fault() == 0);
    send_drive(100);
    CHECK(board.pin == 0);
    CHECK(send_arm() == RIG_OK); /* the set-up stays */
    send_drive(100);
    CHECK(board.pin == 100);
    CHECK(send_arm() == RIG_OK && board.pin == 0); /* arming again starts from 0 */
    send_drive(201);
    send_raw(RIG_PROTOCOL, RIG_STOP, NULL, 0);
    CHECK(state_fault() == RIG_E_DRIVE_RANGE && state_status() == RIG_STATUS_FAULT);
    check_latched(RIG_E_DRIVE_RANGE); /* P7: STOP clears nothing */
    CHECK(send_ack(RIG_E_DRIVE_RANGE) == RIG_OK);
    CHECK(state_fault() == 0 && state_status() == 0);
    CHECK(send_ack(RIG_E_DRIVE_RANGE) == RIG_OK && send_arm() == RIG_OK); /* said twice: the reply had got lost */
}

/* Silence from a frame at any phase of the tick: never early, at most a tick late. */
static void test_watchdog(void)
{
    for (uint32_t phase_us = 0; phase_us <= 1000; phase_us += 50) {
        armed();
        board.now_us += phase_us;
        send_drive(100);
        const uint32_t heard_us = board.now_us;
        board.now_us -= phase_us; /* back on the grid of the ticks */
        board.now_us += phase_us == 0 ? 0 : 1000;
        while (board.pin != 0 && board.now_us - heard_us < 300000u) {
            tick();
        }
        CHECK(board.now_us - heard_us >= 100000u && board.now_us - heard_us <= 101000u);
        check_latched(RIG_E_WATCHDOG);
    }
}

static void test_watchdog_is_fed(void)
{
    uint8_t none = 0;
    armed();
    for (unsigned i = 0; i < 500; i++) { /* at rest a READ is enough */
        tick();
        if (i % 90 == 0) {
            send_read();
        }
    }
    CHECK(core.armed);
    send_drive(100);
    for (unsigned i = 0; i < 110; i++) { /* a drive is not kept up by READ */
        CHECK(i >= 100 || board.pin == 100);
        tick();
        send_read();
    }
    CHECK(board.pin == 0);
    check_latched(RIG_E_WATCHDOG);
    armed();
    send_drive(100);
    for (unsigned i = 0; i < 500; i++) {
        tick();
        if (i % 90 == 0) {
            send_drive(100);
        }
    }
    CHECK(board.pin == 100);
    unsigned alive = 0;
    for (unsigned i = 0; i < 500 && board.pin != 0; i++, alive++) { /* all else does not feed it */
        tick();
        send_raw(RIG_PROTOCOL, RIG_HELLO, NULL, 0);
        send_setup(FIELDS, 0);
        send_raw(RIG_PROTOCOL, RIG_READ, &none, 1);
        send_raw(RIG_PROTOCOL, RIG_DRIVE, &none, 1);
        send_raw(RIG_PROTOCOL, 0x55, NULL, 0);
        send_raw(1, RIG_READ, NULL, 0);
        rig_byte(&core, 0x17);
        rig_byte(&core, 0);
    }
    CHECK(alive <= 101);
    check_latched(RIG_E_WATCHDOG);
}

static uint32_t fake_arrival(void *context)
{
    return fake_micros(context) - 400u;
}

static void test_watchdog_counts_from_the_arrival(void)
{
    rig_board slow = BOARD;
    slow.arrived_us = fake_arrival;
    armed();
    core.board = &slow;
    send_drive(50);
    board.now_us += 99599;
    rig_tick(&core);
    CHECK(board.pin == 50);
    board.now_us += 1;
    rig_tick(&core);
    CHECK(board.pin == 0 && core.fault == RIG_E_WATCHDOG);
}

/* P16 */
static void test_pulse(void)
{
    armed();
    send_pulse(100, 30);
    CHECK(board.pin == 100 && board.replies == 0);
    for (unsigned i = 0; i < 29; i++) {
        tick();
        CHECK(board.pin == 100);
    }
    tick();
    CHECK(board.pin == 0 && core.armed); /* it is no fault */
    send_read();
    CHECK(state_drive() == 0 && got_u32(10) == board.now_us && state_fault() == 0); /* and it is told */
    send_pulse(100, 30);
    CHECK(board.pin == 0); /* what comes late drives no more */
    board.now_us -= 30000u; /* though the clock goes round */
    send_pulse(100, 30);
    CHECK(board.pin == 0);
    board.now_us += 30000u;
    const uint32_t ended_us = core.t_drive_us;
    tick();
    send_drive(0);
    send_read();
    CHECK(state_drive() == 0 && got_u32(10) == ended_us); /* a DRIVE of 0 after its end hides nothing */
    send_pulse(-100, 30);
    CHECK(board.pin == -100); /* a DRIVE was between */
    for (unsigned i = 0; i < 30; i++) {
        CHECK(board.pin == -100 - (int)i);
        tick();
        send_pulse(-101 - (int)i, 30); /* none of them makes it longer */
    }
    CHECK(board.pin == 0);
    armed();
    send_pulse(100, 30);
    send_drive(100); /* and a DRIVE goes on as ever */
    for (unsigned i = 0; i < 90; i++) {
        tick();
    }
    CHECK(board.pin == 100);
    armed();
    send_pulse(100, 1000); /* the watchdog comes first */
    for (unsigned i = 0; i < 101; i++) {
        tick();
    }
    check_latched(RIG_E_WATCHDOG);
    armed();
    send_pulse(201, 30);
    check_latched(RIG_E_DRIVE_RANGE);
    power_on();
    send_pulse(100, 30);
    CHECK(board.pin == 0);
}

/* The clock wraps at 2^32 us, after 71.6 min. */
static void test_watchdog_over_wrap(void)
{
    armed();
    board.now_us = 0xFFFFFFFFu - 30000u;
    send_drive(100);
    for (unsigned i = 0; i < 99; i++) {
        tick();
    }
    CHECK(board.pin == 100);
    tick();
    tick();
    check_latched(RIG_E_WATCHDOG);
}

static void test_travel(void)
{
    static const struct {
        int32_t counts;
        int inside;
    } cases[] = {{100, 1}, {900, 1}, {99, 0}, {901, 0}, {6, 0}, {1017, 0}};
    for (unsigned i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        armed();
        send_drive(100);
        board.counts = cases[i].counts;
        tick();
        CHECK(board.pin == (cases[i].inside ? 100 : 0));
        if (!cases[i].inside) {
            board.counts = 512; /* back inside by itself: still latched */
            tick();
            check_latched(RIG_E_TRAVEL);
        }
    }
    armed();
    send_drive(100);
    board.counts = 950;
    send_read(); /* a sample taken for a reply is checked, too */
    CHECK(board.pin == 0 && state_drive() == 0 && state_fault() == RIG_E_TRAVEL);
}

static void test_sensor(void)
{
    static const int32_t rails[] = {0, 5, 1018, 1023};
    for (unsigned i = 0; i < sizeof rails / sizeof rails[0]; i++) {
        armed();
        send_drive(100);
        board.counts = rails[i];
        tick();
        CHECK(board.pin == 0);
        CHECK(send_ack(RIG_E_SENSOR) == RIG_E_SENSOR); /* as long as it is there */
        check_latched(RIG_E_SENSOR);
        board.counts = 512;
        check_latched(RIG_E_SENSOR);
        CHECK(send_ack_and_arm(RIG_E_SENSOR) == RIG_OK);
        send_drive(100);
        CHECK(board.pin == 100);
    }
}

static void test_first_fault_is_kept(void)
{
    armed();
    send_drive(100);
    board.counts = 950;
    tick();
    board.counts = 0;
    for (unsigned i = 0; i < 300; i++) {
        tick();
    }
    send_drive(300);
    check_latched(RIG_E_TRAVEL);
    board.counts = 512;
    CHECK(send_ack_and_arm(RIG_E_TRAVEL) == RIG_E_SENSOR); /* nor is another forgotten */
    CHECK(send_ack_and_arm(RIG_E_SENSOR) == RIG_OK);
}

static void arm_outside(int32_t counts, int polarity)
{
    power_on();
    send_setup(POLARITY, polarity);
    board.counts = counts;
    CHECK(send_ack_and_arm(RIG_E_RESET) == RIG_OK);
    send_read();
    CHECK(state_status() == (RIG_STATUS_ARMED | RIG_STATUS_RECOVERING) && state_fault() == 0);
}

static void test_recovering(void)
{
    static const int32_t outside[] = {950, 50};
    for (int which = 0; which < 2; which++) {
        for (int polarity = -1; polarity <= 1; polarity += 2) {
            const int outward = (which == 0 ? 1 : -1) * polarity;
            arm_outside(outside[which], polarity);
            tick();
            send_drive(0);
            CHECK(board.pin == 0 && core.armed); /* 0 is not outward */
            send_drive(-outward * 80);
            CHECK(board.pin == -outward * 80);
            tick();
            CHECK(board.pin == -outward * 80); /* outside, but on the way in */
            send_drive(outward);
            check_latched(RIG_E_TRAVEL);

            arm_outside(outside[which], polarity);
            send_drive(-outward * 80);
            board.counts = 512;
            tick();
            send_read();
            CHECK(state_status() == RIG_STATUS_ARMED && board.pin == -outward * 80);
            send_drive(outward * 80);
            CHECK(board.pin == outward * 80); /* recovered: both ways again */
            board.counts = outside[which];
            tick();
            check_latched(RIG_E_TRAVEL);
        }
    }
}

static void test_recovering_at_the_edge(void)
{
    arm_outside(950, 1);
    send_drive(-80);
    board.counts = 899; /* noise at the limit: inside, outside */
    tick();
    board.counts = 902;
    tick();
    CHECK(board.pin == -80 && core.recovering != 0);
    board.counts = 896;
    tick();
    CHECK(board.pin == -80 && core.recovering == 0);

    arm_outside(950, 1);
    send_drive(-80);
    board.counts = 50; /* out at the other side */
    tick();
    check_latched(RIG_E_TRAVEL);

    arm_outside(950, 1);
    send_drive(-80);
    board.counts = 1018; /* the sensor fails meanwhile */
    tick();
    check_latched(RIG_E_SENSOR);
}

/* Inward drive that moves the shaft outward. */
static void test_recovering_polarity(void)
{
    arm_outside(950, 1);
    board.counts = 960; /* coasts on at 0 drive: no fault */
    tick();
    send_drive(-80);
    board.counts = 985; /* 800 / 32 = 25 counts are allowed */
    tick();
    CHECK(board.pin == -80);
    board.counts = 986;
    tick();
    check_latched(RIG_E_POLARITY);

    arm_outside(50, 1);
    send_drive(80);
    board.counts = 24;
    tick();
    check_latched(RIG_E_POLARITY);
}

static void test_estop(void)
{
    armed();
    send_drive(80);
    board.inputs = RIG_INPUT_ESTOP;
    tick();
    check_latched(RIG_E_ESTOP);
    CHECK(send_ack(RIG_E_ESTOP) == RIG_E_ESTOP); /* as long as it is pressed */
    check_latched(RIG_E_ESTOP);
    board.inputs = 0;
    tick();
    check_latched(RIG_E_ESTOP); /* released, but latched */
    CHECK(send_ack_and_arm(RIG_E_ESTOP) == RIG_OK && board.pin == 0);
    board.inputs = RIG_INPUT_ESTOP; /* a READ sees it, too */
    send_read();
    check_latched(RIG_E_ESTOP);
}

/* P10: opened and closed again while disarmed, seen by a tick or by nothing but one request. */
static void test_estop_while_disarmed(void)
{
    static const uint8_t requests[] = {0, RIG_READ, RIG_STOP, RIG_ARM, RIG_ACK};
    static const uint8_t body[4] = {RIG_E_WATCHDOG, 0, 0, 0};
    for (unsigned i = 0; i < sizeof requests; i++) {
        for (int set_up = 0; set_up < 2; set_up++) {
            power_on();
            if (set_up != 0) {
                send_setup(FIELDS, 0);
            }
            CHECK(send_ack(RIG_E_RESET) == RIG_OK);
            board.inputs = RIG_INPUT_ESTOP;
            if (requests[i] == 0) {
                tick();
            } else {
                send_raw(RIG_PROTOCOL, requests[i], body, requests[i] == RIG_ARM ? 4 : requests[i] == RIG_ACK ? 1 : 0);
            }
            board.inputs = 0;
            check_latched(RIG_E_ESTOP);
        }
    }
    power_on(); /* and while another fault is there already */
    board.inputs = RIG_INPUT_ESTOP;
    tick();
    board.inputs = 0;
    send_setup(FIELDS, 0);
    check_latched(RIG_E_RESET);
    CHECK(send_ack_and_arm(RIG_E_RESET) == RIG_E_ESTOP);
    check_latched(RIG_E_ESTOP);
}

/* P10: the rail and both end switches latch while disarmed once SETUP has said what they are; travel and one end switch,
 * which P6 recovers from, do not. */
static void test_what_latches_while_disarmed(void)
{
    static const struct {
        int32_t counts;
        uint8_t inputs, code;
    } cases[] = {{3, 0, RIG_E_SENSOR},
                 {1020, 0, RIG_E_SENSOR},
                 {512, RIG_INPUT_END_LOW | RIG_INPUT_END_HIGH, RIG_E_END_SWITCH},
                 {950, RIG_INPUT_END_LOW, RIG_E_END_SWITCH},
                 {950, 0, RIG_OK},
                 {50, 0, RIG_OK},
                 {512, RIG_INPUT_END_LOW, RIG_OK},
                 {512, RIG_INPUT_END_HIGH, RIG_OK}};
    for (unsigned i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        for (int set_up = 0; set_up < 2; set_up++) {
            power_on();
            CHECK(send_ack(RIG_E_RESET) == RIG_OK);
            if (set_up != 0) {
                send_setup(FIELDS, 0);
            }
            board.counts = cases[i].counts;
            board.inputs = cases[i].inputs;
            tick();
            send_read();
            board.counts = 512;
            board.inputs = 0;
            if (set_up != 0 && cases[i].code != RIG_OK) {
                check_latched(cases[i].code);
            } else {
                CHECK(state_status() == 0 && state_fault() == 0);
                send_setup(FIELDS, 0);
                CHECK(send_arm() == RIG_OK);
            }
        }
    }
}

/* P11. */
static void test_session(void)
{
    armed();
    send_raw(RIG_PROTOCOL, RIG_STOP, NULL, 0);
    CHECK(got_u32(20) == SESSION);
    CHECK(send_arm_of(SESSION + 1) == RIG_E_SESSION && !core.armed);
    CHECK(send_arm_of(0) == RIG_E_SESSION && !core.armed);
    send_setup(THE_SESSION, 7);
    CHECK(send_arm() == RIG_E_SESSION && send_arm_of(7) == RIG_OK);
    send_drive(100);
    CHECK(send_arm_of(8) == RIG_E_SESSION && board.pin == 0 && !core.armed); /* a stranger ends the drive */
}

/* What nobody can have seen cannot be acknowledged. */
static void test_ack_of_nonsense(void)
{
    armed();
    send_drive(100);
    CHECK(send_ack(0) == RIG_E_SETUP && send_ack(21) == RIG_E_SETUP && send_ack(255) == RIG_E_SETUP);
    CHECK(send_ack(RIG_E_TRAVEL) == RIG_OK && board.pin == 100 && core.armed); /* none of that kind */
    board.inputs = RIG_INPUT_ESTOP;
    CHECK(send_ack(RIG_E_TRAVEL) == RIG_OK && board.pin == 0); /* it looks, too */
    board.inputs = 0;
    check_latched(RIG_E_ESTOP);
}

/* Positions of 32 bits: what an encoder counts in an hour. */
static void test_far_positions(void)
{
    rig_board far = BOARD;
    far.counts_max = 0x7FFFFFFF;
    static const int32_t bases[] = {1000000000, 70000};
    for (unsigned i = 0; i < 2; i++) {
        power_on();
        rig_init(&core, &far, RIG_RESET_POWER_ON);
        uint8_t body[SETUP_LENGTH] = {1};
        put32(body + 4, (uint32_t)bases[i] - 60000);
        put32(body + 8, (uint32_t)bases[i] + 60000);
        put32(body + 12, (uint32_t)0);
        put32(body + 16, (uint32_t)0x7FFFFFFF);
        put32(body + 20, (uint32_t)bases[i]);
        put16(body + 24, 200);
        put16(body + 26, 100);
        body[28] = 1;
        board.counts = bases[i];
        send_raw(RIG_PROTOCOL, RIG_SETUP, body, SETUP_LENGTH);
        CHECK(send_ack(RIG_E_RESET) == RIG_OK && send_arm_of(1) == RIG_OK);
        send_drive(100);
        board.counts = bases[i] + 60000;
        tick();
        CHECK(board.pin == 100);
        send_read();
        CHECK(got_u32(4) == (uint32_t)(bases[i] + 60000));
        board.counts++;
        tick();
        check_latched(RIG_E_TRAVEL);
        CHECK(send_ack(RIG_E_TRAVEL) == RIG_OK && send_arm_of(1) == RIG_OK && core.recovering == 1);
        send_drive(-100);
        board.counts += 120000 / 32;
        tick();
        CHECK(board.pin == -100);
        board.counts++;
        tick();
        check_latched(RIG_E_POLARITY);
    }
}

static void test_end_switches(void)
{
    static const uint8_t ends[] = {RIG_INPUT_END_HIGH, RIG_INPUT_END_LOW};
    for (int which = 0; which < 2; which++) {
        const int outward = which == 0 ? 1 : -1;
        armed();
        send_drive(80 * outward);
        board.inputs = ends[which]; /* the counts are well inside */
        tick();
        check_latched(RIG_E_END_SWITCH);
        CHECK(send_ack_and_arm(RIG_E_END_SWITCH) == RIG_OK);
        send_read();
        CHECK(state_status() == (RIG_STATUS_ARMED | RIG_STATUS_RECOVERING));
        send_drive(-80 * outward);
        tick();
        CHECK(board.pin == -80 * outward); /* on the way in */
        send_drive(outward);
        check_latched(RIG_E_TRAVEL);
        CHECK(send_ack_and_arm(RIG_E_TRAVEL) == RIG_OK);
        send_drive(-80 * outward);
        board.inputs = ends[1 - which]; /* out at the other end */
        tick();
        check_latched(RIG_E_END_SWITCH);
        CHECK(send_ack_and_arm(RIG_E_END_SWITCH) == RIG_OK);
        board.inputs = 0;
        tick();
        send_drive(80);
        send_drive(-80);
        CHECK(board.pin == -80 && core.recovering == 0);
        board.inputs = RIG_INPUT_END_LOW | RIG_INPUT_END_HIGH; /* a broken wire */
        tick();
        check_latched(RIG_E_END_SWITCH);
        CHECK(send_ack(RIG_E_END_SWITCH) == RIG_E_END_SWITCH);
    }
}

/* A switch that says the other end than the position does: swapped, and inward of one is outward of the other. */
static void test_end_switch_against_the_position(void)
{
    static const struct {
        int32_t counts;
        uint8_t contact;
    } cases[] = {{950, RIG_INPUT_END_LOW}, {50, RIG_INPUT_END_HIGH}};
    for (unsigned i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        armed();
        board.counts = cases[i].counts;
        board.inputs = cases[i].contact;
        CHECK(send_arm() == RIG_E_END_SWITCH);
        send_drive(50);
        send_drive(-50);
        CHECK(board.pin == 0);
        board.inputs = 0;
        CHECK(send_ack_and_arm(RIG_E_END_SWITCH) == RIG_OK);
        send_drive(cases[i].counts > 512 ? -50 : 50);
        board.inputs = cases[i].contact; /* on the way in from the position's side */
        tick();
        check_latched(RIG_E_END_SWITCH);
    }
}

static void test_a_board_without_inputs(void)
{
    rig_board plain = BOARD;
    plain.inputs = NULL;
    power_on();
    rig_init(&core, &plain, RIG_RESET_POWER_ON);
    board.inputs = RIG_INPUT_ESTOP;
    send_setup(FIELDS, 0);
    CHECK(send_ack_and_arm(RIG_E_RESET) == RIG_OK);
    send_drive(80);
    tick();
    CHECK(board.pin == 80);
}

static void test_refusals(void)
{
    uint8_t body[SETUP_LENGTH + 1] = {0};
    armed();
    send_drive(100);
    send_raw(1, RIG_STOP, NULL, 0); /* a host of before */
    CHECK(refused(RIG_STOP, RIG_E_VERSION) && core.rx.dropped == 1);
    send_raw(RIG_PROTOCOL, 0x09, NULL, 0);
    CHECK(refused(0x09, RIG_E_TYPE));
    send_raw(RIG_PROTOCOL, RIG_READ | RIG_REPLY, body, 17);
    CHECK(refused(RIG_READ | RIG_REPLY, RIG_E_TYPE));
    send_raw(RIG_PROTOCOL, RIG_SETUP, body, SETUP_LENGTH - 1);
    CHECK(refused(RIG_SETUP, RIG_E_LENGTH));
    send_raw(RIG_PROTOCOL, RIG_SETUP, body, SETUP_LENGTH + 1);
    CHECK(refused(RIG_SETUP, RIG_E_LENGTH));
    send_raw(RIG_PROTOCOL, RIG_DRIVE, body, 1);
    CHECK(refused(RIG_DRIVE, RIG_E_LENGTH));
    send_raw(RIG_PROTOCOL, RIG_ARM, body, 0);
    CHECK(refused(RIG_ARM, RIG_E_LENGTH));
    send_raw(RIG_PROTOCOL, RIG_ACK, body, 0);
    CHECK(refused(RIG_ACK, RIG_E_LENGTH));
    send_raw(RIG_PROTOCOL, RIG_STOP, body, 1);
    CHECK(refused(RIG_STOP, RIG_E_LENGTH));
    CHECK(board.pin == 100 && core.armed); /* none of them changed anything */
}

/* P8: no damage of a DRIVE frame, one byte or one bit each, reaches the pin. */
static void test_damaged_drive(void)
{
    const uint8_t content[] = {RIG_PROTOCOL, RIG_DRIVE, 1, 2, 150, 0};
    uint8_t wire[FRAME_WIRE_MAX];
    const uint8_t n = frame_encode(content, sizeof content, wire);
    armed();
    send_drive(100);
    const unsigned drives = board.drives;
    for (unsigned at = 0; at + 1u < n; at++) {
        for (unsigned flip = 1; flip < 256; flip++) {
            for (unsigned i = 0; i < n; i++) {
                rig_byte(&core, i == at ? (uint8_t)(wire[i] ^ flip) : wire[i]);
            }
        }
    }
    CHECK(board.pin == 100 && board.drives == drives && core.armed);
    CHECK(core.rx.dropped >= 255u * (n - 1u));
}

/* RIG_OK, or why it is refused. */
static uint8_t send_loopback(uint8_t act)
{
    send_raw(RIG_PROTOCOL, RIG_LOOPBACK, &act, 1);
    if (replied(RIG_NACK, 2)) {
        return board.got[4];
    }
    CHECK(replied(RIG_LOOPBACK | RIG_REPLY, 35));
    return RIG_OK;
}

static void in_loopback(void)
{
    armed();
    send_raw(RIG_PROTOCOL, RIG_STOP, NULL, 0);
    loopback.wired = true;
    CHECK(send_loopback(RIG_LOOPBACK_BEGIN) == RIG_OK);
}

/* P15: when it begins, what of the bench it forgets, and how it ends. */
static void test_loopback_begins_and_ends(void)
{
    armed();
    loopback.wired = true;
    CHECK(send_loopback(RIG_LOOPBACK_BEGIN) == RIG_E_SETUP && core.armed && !loopback.begun); /* not under drive */
    send_raw(RIG_PROTOCOL, RIG_STOP, NULL, 0);
    CHECK(send_loopback(RIG_LOOPBACK_LOOK) == RIG_E_LOOPBACK && send_loopback(RIG_LOOPBACK_END) == RIG_E_LOOPBACK);
    CHECK(send_loopback(RIG_LOOPBACK_HANG) == RIG_E_LOOPBACK && send_loopback(RIG_LOOPBACK_HANG + 1) == RIG_E_TYPE);
    CHECK(loopback.hung == 0);
    loopback.wired = false;
    CHECK(send_loopback(RIG_LOOPBACK_BEGIN) == RIG_E_LOOPBACK && !loopback.begun);
    CHECK(send_arm() == RIG_OK); /* nothing has changed */
    send_raw(RIG_PROTOCOL, RIG_STOP, NULL, 0);
    loopback.wired = true;
    CHECK(send_loopback(RIG_LOOPBACK_BEGIN) == RIG_OK && loopback.begun);
    CHECK(send_arm() == RIG_E_NO_SETUP); /* its set-up was of a bench */
    send_setup(MAX_DRIVE, FULL / 2);
    CHECK(send_arm() == RIG_OK);
    send_raw(RIG_PROTOCOL, RIG_HELLO, NULL, 0); /* somebody else, who may have a motor */
    CHECK(!core.loopback && !core.armed && !loopback.begun && board.pin == 0);
    CHECK(send_arm() == RIG_E_NO_SETUP);
    in_loopback();
    CHECK(send_loopback(RIG_LOOPBACK_END) == RIG_OK && !core.loopback && !loopback.begun);
    in_loopback();
    rig_init(&core, &BOARD, RIG_RESET_WATCHDOG);
    CHECK(!core.loopback);
}

/* P15: at most half of full duty, and no law. */
static void test_what_drives_in_loopback(void)
{
    uint8_t relay_body[18] = {0};
    in_loopback();
    board.counts = 0; /* a sensor that is not there, at its rail */
    send_setup(MAX_DRIVE, FULL / 2 + 1);
    CHECK(refused(RIG_SETUP, RIG_E_SETUP));
    send_setup(MAX_DRIVE, FULL / 2);
    CHECK(send_arm() == RIG_OK);
    tick();
    send_drive(FULL / 2);
    tick();
    CHECK(board.pin == FULL / 2 && core.armed);
    send_raw(RIG_PROTOCOL, RIG_RELAY, relay_body, 18);
    CHECK(refused(RIG_RELAY, RIG_E_SETUP));
    send_drive(FULL / 2 + 1);
    check_latched_in_loopback(RIG_E_DRIVE_RANGE);
    CHECK(send_ack_and_arm(RIG_E_DRIVE_RANGE) == RIG_OK);
    send_drive(100);
    CHECK(send_loopback(RIG_LOOPBACK_OPEN) == RIG_OK);
    tick();
    check_latched_in_loopback(RIG_E_ESTOP);
    CHECK(send_loopback(RIG_LOOPBACK_CLOSE) == RIG_OK && send_ack_and_arm(RIG_E_ESTOP) == RIG_OK);
    send_drive(100);
    board.now_us += 101000;
    tick();
    check_latched_in_loopback(RIG_E_WATCHDOG); /* P3, as ever */
}

static void test_what_a_loopback_tells(void)
{
    in_loopback();
    tick();
    tick();
    CHECK(send_loopback(RIG_LOOPBACK_SHARE) == RIG_OK);
    CHECK(got_u32(0) == board.now_us && got_u32(4) == 2 && got_u16(12) == 7 && board.got[4 + 14] == 2);
    CHECK(got_u32(31) == 0x12345678u);
    CHECK(send_loopback(RIG_LOOPBACK_LOOK) == RIG_OK && got_u16(12) == 0 && loopback.hung == 0);
    CHECK(send_loopback(RIG_LOOPBACK_HANG) == RIG_OK && loopback.hung == 1); /* once it has answered */
}

int main(void)
{
    test_loopback_begins_and_ends();
    test_what_drives_in_loopback();
    test_what_a_loopback_tells();
    test_after_reset();
    test_hello();
    test_setup();
    test_setup_while_armed();
    test_drive();
    test_drive_range();
    test_stop();
    test_watchdog();
    test_watchdog_is_fed();
    test_watchdog_counts_from_the_arrival();
    test_watchdog_over_wrap();
    test_pulse();
    test_travel();
    test_sensor();
    test_first_fault_is_kept();
    test_recovering();
    test_recovering_at_the_edge();
    test_recovering_polarity();
    test_estop();
    test_estop_while_disarmed();
    test_what_latches_while_disarmed();
    test_session();
    test_ack_of_nonsense();
    test_far_positions();
    test_end_switches();
    test_end_switch_against_the_position();
    test_a_board_without_inputs();
    test_refusals();
    test_damaged_drive();
    return report("rig_core");
}
