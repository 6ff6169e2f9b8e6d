/* What the core promises of a board whose position is an encoder's: P13 and P14, zero, homing, and no travel limits, for
 * both laws that run in the device. */
#include "plain_board.h"

static void fake_set_position(void *context, int32_t counts)
{
    (void)context;
    board.counts = counts;
}

static uint8_t fake_troubles(void *context)
{
    const uint8_t found = board.troubles;
    (void)context;
    board.troubles = 0;
    return found;
}

static const rig_board ENCODER = {PLAIN_BOARD,
                                  .build = "encoder",
                                  .drive_full = 400,
                                  .features = RIG_FEATURE_ENCODER,
                                  .set_position = fake_set_position,
                                  .encoder_troubles = fake_troubles};

static const rig_board POTENTIOMETER = {
    PLAIN_BOARD, .build = "potentiometer", .counts_max = 1023, .drive_full = 400
};

static uint8_t ask(uint8_t type, const uint8_t *body, uint8_t n)
{
    send_raw(RIG_PROTOCOL, type, body, n);
    return board.got_length != 0u && board.got[1] == (uint8_t)RIG_NACK ? board.got[4] : (uint8_t)RIG_OK;
}

static uint8_t setup(int32_t hard_lo, int32_t hard_hi, int32_t rail_hi, uint8_t homing)
{
    uint8_t body[30] = {7};
    put32(body + 4, (uint32_t)hard_lo);
    put32(body + 8, (uint32_t)hard_hi);
    put32(body + 16, (uint32_t)rail_hi);
    body[24] = 200;
    body[26] = 100;
    body[28] = 1;
    body[29] = homing;
    return ask(RIG_SETUP, body, sizeof body);
}

static uint8_t zero(int32_t counts)
{
    uint8_t body[4];
    put32(body, (uint32_t)counts);
    return ask(RIG_ZERO, body, sizeof body);
}

static uint8_t arm(void)
{
    const uint8_t body[4] = {7, 0, 0, 0};
    CHECK(ask(RIG_ARM, body, sizeof body) == RIG_OK);
    return board.got[4];
}

static uint8_t ack(uint8_t code)
{
    return ask(RIG_ACK, &code, 1);
}

static void drive(int16_t units)
{
    const uint8_t body[2] = {(uint8_t)units, (uint8_t)((uint16_t)units >> 8)};
    (void)ask(RIG_DRIVE, body, sizeof body);
}

static uint8_t start_relay(int32_t centre)
{
    uint8_t body[18] = {0xC4, 0xFF, 0xEC, 0xFF, 20, 0, 60, 0};
    put32(body + 8, (uint32_t)centre);
    put32(body + 12, 1u << 20);
    body[16] = 1;
    body[17] = 10;
    return ask(RIG_RELAY, body, sizeof body);
}

/* To and fro between these counts. */
static uint8_t start_strokes(int32_t high, int32_t low)
{
    uint8_t body[56] = {2, 10, 100, 0, 100, 0, 3, 0, 60, 0};
    put32(body + 10, (uint32_t)high);
    body[14] = 0xC4;
    body[15] = 0xFF;
    put32(body + 16, (uint32_t)low);
    return ask(RIG_STROKES, body, sizeof body);
}

static uint8_t status(void)
{
    CHECK(ask(RIG_READ, NULL, 0) == RIG_OK);
    return board.got[4 + 18];
}

static void power_on(const rig_board *as)
{
    start(as, RIG_RESET_POWER_ON);
    CHECK(ack(RIG_E_RESET) == RIG_OK);
}

#define NO_LIMITS INT32_MIN, INT32_MAX, 0

/* P13: with limits nothing arms before ZERO, and a reset ends that. */
static void test_no_zero_no_drive(void)
{
    power_on(&ENCODER);
    CHECK(setup(-1000, 1000, 0, 0) == RIG_OK && arm() == RIG_E_ZERO);
    drive(50);
    CHECK(board.pin == 0);
    CHECK(zero(-300) == RIG_OK && board.counts == -300 && (status() & RIG_STATUS_ZERO) != 0u);
    CHECK(arm() == RIG_OK);
    drive(50);
    CHECK(board.pin == 50);
    CHECK(zero(0) == RIG_E_SETUP && board.counts == -300); /* positions never change under drive */
    rig_init(&core, &ENCODER, RIG_RESET_WATCHDOG);
    CHECK(ack(RIG_E_RESET) == RIG_OK && (status() & RIG_STATUS_ZERO) == 0u);
    CHECK(setup(-1000, 1000, 0, 0) == RIG_OK && arm() == RIG_E_ZERO);
}

static void test_limits_hold_below_0(void)
{
    power_on(&ENCODER);
    CHECK(setup(-1000, -100, 0, 0) == RIG_OK && zero(-300) == RIG_OK && arm() == RIG_OK);
    drive(50);
    board.counts = -100;
    tick();
    CHECK(board.pin == 50);
    board.counts = -99;
    tick();
    CHECK(board.pin == 0 && core.fault == RIG_E_TRAVEL);
}

/* Each trouble, armed or not: 0 V, latched, zero is void, and none is set before somebody has seen it. */
static void test_troubles(void)
{
    static const uint8_t CODES[] = {RIG_E_ENCODER_LOST, RIG_E_ENCODER_RATE, RIG_E_ENCODER_STILL};
    for (unsigned i = 0; i < 6u; i++) {
        const uint8_t code = CODES[i % 3u];
        power_on(&ENCODER);
        CHECK(setup(-1000, 1000, 0, 0) == RIG_OK && zero(0) == RIG_OK);
        CHECK(i >= 3u || arm() == RIG_OK);
        drive(50);
        board.troubles = (uint8_t)(1u << (i % 3u));
        if (i != 5u) {
            tick();
        } /* else the ARM itself finds it */
        CHECK(arm() == code && board.pin == 0 && !core.armed && core.fault == code && !core.has_zero);
        CHECK(zero(5) == code && !core.has_zero && board.counts == 0);
        CHECK(ack(code) == RIG_OK && arm() == RIG_E_ZERO);
        board.troubles = (uint8_t)(1u << (i % 3u));
        CHECK(zero(5) == code && ack(code) == RIG_OK && arm() == RIG_E_ZERO);
        CHECK(zero(5) == RIG_OK && arm() == RIG_OK);
    }
}

/* What was known before a homing began is forgotten, whatever becomes of it. */
static void test_a_homing_forgets_the_zero(void)
{
    power_on(&ENCODER);
    CHECK(zero(-300) == RIG_OK);
    CHECK(setup(NO_LIMITS, 1) == RIG_E_SETUP && (status() & RIG_STATUS_ZERO) != 0u); /* refused: it has not begun */
    CHECK(setup(-1000, 1000, 0, 1) == RIG_OK && (status() & RIG_STATUS_ZERO) == 0u);
    CHECK(setup(-1000, 1000, 0, 0) == RIG_OK && arm() == RIG_E_ZERO);
    drive(50);
    CHECK(board.pin == 0);
    CHECK(zero(0) == RIG_OK && setup(-1000, 1000, 0, 1) == RIG_OK && arm() == RIG_OK);
    drive(50);
    CHECK(ask(RIG_STOP, NULL, 0) == RIG_OK && setup(-1000, 1000, 0, 0) == RIG_OK && arm() == RIG_E_ZERO);
}

/* A homing arms without a zero, inside limits from wherever it counts, and runs no law. */
static void test_homing(void)
{
    power_on(&ENCODER);
    CHECK(setup(NO_LIMITS, 1) == RIG_E_SETUP); /* it needs limits */
    CHECK(setup(-1000, 1000, 0, 2) == RIG_E_SETUP);
    CHECK(setup(-1000, 1000, 0, 1) == RIG_OK && arm() == RIG_OK);
    CHECK(start_relay(0) == RIG_E_SETUP && start_strokes(100, -100) == RIG_E_SETUP);
    drive(50);
    CHECK(board.pin == 50);
    board.counts = 1001;
    tick();
    CHECK(board.pin == 0 && core.fault == RIG_E_TRAVEL && !core.has_zero);
    CHECK(ack(RIG_E_TRAVEL) == RIG_OK);
    board.counts = 0;
    CHECK(arm() == RIG_OK);
    drive(50);
    board.inputs = RIG_INPUT_END_HIGH;
    tick();
    CHECK(board.pin == 0 && core.fault == RIG_E_END_SWITCH);
    CHECK(zero(700) == RIG_OK && ack(RIG_E_END_SWITCH) == RIG_OK);
    CHECK(setup(-1000, 1000, 0, 0) == RIG_OK && arm() == RIG_OK && core.recovering == 1);
    drive(-50);
    CHECK(board.pin == -50);
}

/* P14: without limits only the e-stop's own contact shows that it works. */
static void test_endless(void)
{
    power_on(&ENCODER);
    CHECK(setup(NO_LIMITS, 0) == RIG_OK && zero(0) == RIG_OK && arm() == RIG_E_ESTOP_UNTRIED);
    board.inputs = RIG_INPUT_ESTOP;
    tick();
    CHECK(arm() == RIG_E_ESTOP);
    board.inputs = 0;
    tick();
    CHECK(arm() == RIG_E_ESTOP && ack(RIG_E_ESTOP) == RIG_OK && (status() & RIG_STATUS_ESTOP_TRIED) != 0u);
    CHECK(arm() == RIG_OK);
    drive(50);
    board.counts = INT32_MAX;
    tick();
    CHECK(board.pin == 50);
    board.counts = INT32_MIN;
    tick();
    CHECK(board.pin == 50);
    rig_init(&core, &ENCODER, RIG_RESET_BROWN_OUT);
    CHECK(ack(RIG_E_RESET) == RIG_OK && setup(NO_LIMITS, 0) == RIG_OK && zero(0) == RIG_OK);
    CHECK(arm() == RIG_E_ESTOP_UNTRIED);
}

static void armed_endless(int32_t at)
{
    power_on(&ENCODER);
    board.inputs = RIG_INPUT_ESTOP;
    tick();
    board.inputs = 0;
    CHECK(ack(RIG_E_ESTOP) == RIG_OK && setup(NO_LIMITS, 0) == RIG_OK && zero(at) == RIG_OK && arm() == RIG_OK);
}

/* The relay about any centre within its numbers; where the shaft leaves them it ends. */
static void test_endless_relay(void)
{
    armed_endless(60000000);
    CHECK(start_relay(0) == RIG_E_SETUP); /* out of its reach */
    CHECK(start_relay(60000000 * 16) == RIG_OK);
    tick();
    CHECK(board.pin == -60);
    board.counts = 60000000 - 10;
    tick();
    CHECK(board.pin == 60);
    board.counts = 60000000 + (1 << 20);
    tick();
    CHECK(board.pin == 0 && core.fault == RIG_E_TRAVEL && !core.running);
}

/* Strokes inside limits, below zero and above it. */
static void test_strokes_on_counts(void)
{
    power_on(&ENCODER);
    CHECK(setup(-2000, 1000, 0, 0) == RIG_OK && zero(-300) == RIG_OK && arm() == RIG_OK);
    CHECK(start_strokes(1001, -1000) == RIG_E_SETUP && start_strokes(1000, -2001) == RIG_E_SETUP);
    CHECK(start_strokes(200, -1000) == RIG_OK);
    tick();
    CHECK(board.pin == 60);
    board.counts = 201;
    tick();
    CHECK(board.pin == -60);
    board.counts = -999;
    tick();
    CHECK(board.pin == -60);
    board.counts = -1000;
    tick();
    CHECK(board.pin == 60);
    board.troubles = RIG_ENCODER_LOST;
    tick();
    CHECK(board.pin == 0 && core.fault == RIG_E_ENCODER_LOST && !core.running);
}

#define REACH (1 << 20)

/* Without limits the strokes keep within as many counts as the relay: turning points, the start, and each tick. */
static void test_endless_strokes(void)
{
    armed_endless(0);
    CHECK(start_strokes(REACH, -100) == RIG_E_SETUP && start_strokes(100, -REACH) == RIG_E_SETUP);
    CHECK(start_strokes(INT32_MAX, INT32_MIN) == RIG_E_SETUP);
    CHECK(start_strokes(REACH - 1, 1 - REACH) == RIG_OK);
    tick();
    CHECK(board.pin == 60);
    board.counts = REACH - 1;
    tick();
    CHECK(board.pin == -60 && core.running);
    board.counts = REACH;
    tick();
    CHECK(board.pin == 0 && core.fault == RIG_E_TRAVEL && !core.running);

    armed_endless(-REACH);
    CHECK(start_strokes(100, -100) == RIG_E_SETUP); /* out of their reach */
}

static void test_what_fits_which_sensor(void)
{
    power_on(&ENCODER);
    CHECK(setup(-1000, 1000, 1018, 0) == RIG_E_SETUP); /* an encoder has no rails */
    power_on(&POTENTIOMETER);
    CHECK(zero(0) == RIG_E_TYPE);
    CHECK(setup(100, 900, 1018, 0) == RIG_OK && setup(100, 900, 1018, 1) == RIG_E_SETUP);
}

int main(void)
{
    test_no_zero_no_drive();
    test_limits_hold_below_0();
    test_troubles();
    test_a_homing_forgets_the_zero();
    test_homing();
    test_endless();
    test_endless_relay();
    test_strokes_on_counts();
    test_endless_strokes();
    test_what_fits_which_sensor();
    return report("rig_encoder");
}
