#include "encoder.h"

#include "clock.h"
#include "pio.h"
#include "rig_core.h"
#include "wiring.h"

#define CHANNEL_A 1u /* levels of both channels, as the pins give them */
#define CHANNEL_B 2u
#define CHANNELS (CHANNEL_A | CHANNEL_B)

/* The position's program. It goes on at the address that the levels before and the levels now make up together: so the first
 * sixteen places are a table of what to do. X is the count. A round takes 7 to 10 cycles. */
#define DOWN 16u
#define LOOK 17u
#define UP 23u
#define COUNTED 25u
#define LOST 26u
#define LOST_FLAG 0u

/* The edges' program: X falls with each. A round takes 4 cycles. */
#define LOW 0u
#define ROSE 4u
#define HIGH 5u
#define FELL 8u

static const pio_machine POSITION = {PIO0, 0u};
static const pio_machine EDGES[2] = {{PIO1, 0u}, {PIO1, 1u}};

static bool is_counting;
static uint32_t edges_left[2]; /* of each channel, at the last tick */
static uint8_t troubles;
static uint32_t zero; /* count at position 0 */
static uint32_t count;
static encoder_sample of_tick;

static uint32_t after(uint32_t before, uint32_t now)
{
    const uint32_t changed = before ^ now;
    const bool differ = now == CHANNEL_A || now == CHANNEL_B;
    uint32_t to = DOWN;
    if (changed == 0u) {
        to = LOOK;
    } else if (changed == CHANNELS) {
        to = LOST;
    } else if ((changed == CHANNEL_A) == differ) { /* forward is A before B */
        to = UP;
    } else {
        /* backward */
    }
    return to;
}

static void load_position(void)
{
    static const uint32_t PROGRAM[] = {
        PIO_JMP_X_DECREMENT(LOOK), /* DOWN */
        PIO_MOV_ISR_X,             /* LOOK */
        PIO_PUSH,
        PIO_IN_Y(2u), /* the levels before */
        PIO_IN_PINS(2u),
        PIO_MOV_Y_ISR,
        PIO_MOV_PC_ISR,
        PIO_MOV_X_NOT_X, /* UP */
        PIO_JMP_X_DECREMENT(COUNTED),
        PIO_MOV_X_NOT_X, /* COUNTED, and back to LOOK */
        PIO_IRQ(LOST_FLAG), /* LOST */
        PIO_JMP(LOOK),
    };
    for (uint32_t before = 0; before <= CHANNELS; before++) {
        for (uint32_t now = 0; now <= CHANNELS; now++) {
            const uint32_t jump = PIO_JMP(after(before, now));
            pio_load(POSITION.block, (before << 2) | now, &jump, 1u);
        }
    }
    pio_load(POSITION.block, DOWN, PROGRAM, sizeof PROGRAM / sizeof PROGRAM[0]);
}

static void load_edges(void)
{
    static const uint32_t PROGRAM[] = {
        PIO_MOV_ISR_X, /* LOW */
        PIO_PUSH,
        PIO_JMP_PIN(ROSE),
        PIO_JMP(LOW),
        PIO_JMP_X_DECREMENT(HIGH), /* ROSE; X may be 0: then HIGH is next all the same */
        PIO_MOV_ISR_X,             /* HIGH */
        PIO_PUSH,
        PIO_JMP_PIN(HIGH),
        PIO_JMP_X_DECREMENT(LOW), /* FELL, and back to LOW */
    };
    pio_load(EDGES[0].block, LOW, PROGRAM, sizeof PROGRAM / sizeof PROGRAM[0]);
}

void encoder_init(void)
{
    wire_pin(PIN_ENCODER_A, PAD_CONTACT, FUNCTION_SIO); /* pulled up: most encoders only pull down */
    wire_pin(PIN_ENCODER_B, PAD_CONTACT, FUNCTION_SIO);
    load_position();
    load_edges();
}

/* Not before the pull-ups have lifted the wires. The first look has no levels before it: what it makes of that is no edge. */
static void begin_counting(void)
{
    pio_start(POSITION, PIN_ENCODER_A, LOOK, COUNTED);
    pio_start(EDGES[0], PIN_ENCODER_A, LOW, FELL);
    pio_start(EDGES[1], PIN_ENCODER_B, LOW, FELL);
    for (uint32_t i = 0; i < 2u; i++) {
        (void)pio_newest(POSITION, &count);
        (void)pio_newest(EDGES[i], &edges_left[i]);
    }
    (void)pio_take_flag(POSITION.block, LOST_FLAG);
    is_counting = true;
}

/* Of the millisecond that is over. */
static bool count_edges(void)
{
    static uint32_t alone[2]; /* edges of a channel beyond the other one's, since that one's last, to a tick */
    uint32_t edges[2];
    for (uint32_t i = 0; i < 2u; i++) {
        uint32_t left = 0;
        if (!pio_newest(EDGES[i], &left)) {
            return false;
        }
        edges[i] = edges_left[i] - left;
        edges_left[i] = left;
    }
    if (edges[0] + edges[1] > ENCODER_EDGES_MAX) {
        troubles |= (uint8_t)RIG_ENCODER_RATE;
    }
    for (uint32_t i = 0; i < 2u; i++) {
        const uint32_t others = edges[1u - i]; /* a shaft that turns makes as many, but for one at each reversal */
        alone[i] = (others == 0u ? alone[i] : 0u) + (edges[i] > others ? edges[i] - others : 0u);
        if (alone[i] >= ENCODER_ALONE_MAX) {
            alone[i] = 0;
            troubles |= (uint8_t)RIG_ENCODER_STILL;
        }
    }
    return true;
}

/* Two's complement without the implementation-defined cast. */
static encoder_sample sample_at(uint32_t t_us)
{
    const uint32_t from_zero = count - zero;
    const uint32_t below = ~from_zero; /* how far below -1 */
    const encoder_sample sample = {from_zero < 0x80000000u ? (int32_t)from_zero : -1 - (int32_t)below, t_us};
    return sample;
}

bool encoder_begin_tick(void)
{
    if (!is_counting) {
        begin_counting();
    }
    const uint32_t t_us = clock_us();
    const bool answers = pio_newest(POSITION, &count);
    of_tick = sample_at(t_us);
    return answers && count_edges();
}

encoder_sample encoder_tick_sample(void)
{
    return of_tick;
}

encoder_sample encoder_newest_sample(void)
{
    const uint32_t t_us = clock_us();
    (void)pio_newest(POSITION, &count);
    return sample_at(t_us);
}

void encoder_set(int32_t counts)
{
    (void)pio_newest(POSITION, &count);
    zero = count - (uint32_t)counts;
}

uint8_t encoder_take_troubles(void)
{
    uint8_t found = troubles;
    troubles = 0;
    if (pio_take_flag(POSITION.block, LOST_FLAG)) {
        found |= (uint8_t)RIG_ENCODER_LOST;
    }
    return found;
}
