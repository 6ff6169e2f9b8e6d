#include "loopback.h"

#include "clock.h"
#include "cpu.h"
#include "wiring.h"

#define PATIENCE 1000u /* looks at the e-stop's input, some 60 us: its pull-up has to lift a wire */
#define LOOKS 2048u    /* for a share: some five periods, less than half a tick */

static const uint32_t ENDS[2] = {BIT(PIN_WIRE_A), BIT(PIN_WIRE_B)};

static volatile uint32_t ends_before; /* of the ends, at the last edge */
static volatile uint16_t rises[2];
static volatile uint32_t last_us[2];
static volatile uint32_t estop_us;

void loopback_take_edge(void)
{
    REG(IO_INTR2) = EDGES_OF_WIRES; /* before the levels: an edge from here on comes again */
    const uint32_t now = REG(SIO_GPIO_IN);
    const uint32_t changed = now ^ ends_before;
    const uint32_t now_us = clock_us();
    ends_before = now;
    for (uint32_t i = 0; i < 2u; i++) {
        if ((changed & ENDS[i]) != 0u) {
            last_us[i] = now_us;
            if ((now & ENDS[i]) != 0u) {
                rises[i]++;
            }
        }
    }
}

/* Low closes the contact that is not there; as an input the pin leaves it to the pull-up of the e-stop's. */
static void open_estop(bool open)
{
    const uint32_t before = cpu_hold_interrupts();
    if (open) {
        estop_us = clock_us();
        REG(SIO_GPIO_OE_CLR) = BIT(PIN_ESTOP_WIRE);
    } else {
        REG(SIO_GPIO_OUT_CLR) = BIT(PIN_ESTOP_WIRE);
        REG(SIO_GPIO_OE_SET) = BIT(PIN_ESTOP_WIRE);
    }
    cpu_restore_interrupts(before);
}

static bool estop_becomes(uint32_t level)
{
    bool is = false;
    for (uint32_t i = 0; i < PATIENCE && !is; i++) {
        is = (REG(SIO_GPIO_IN) & BIT(PIN_ESTOP)) == level;
    }
    return is;
}

static void disconnect(void)
{
    REG(IO_PROC0_INTE2) = 0;
    REG(SIO_GPIO_OE_CLR) = BIT(PIN_ESTOP_WIRE);
}

static bool connect(void)
{
    disconnect();
    wire_pin(PIN_WIRE_A, PAD_CONTACT, FUNCTION_SIO); /* pulled up: an end without its wire is high */
    wire_pin(PIN_WIRE_B, PAD_CONTACT, FUNCTION_SIO);
    wire_pin(PIN_ESTOP_WIRE, PAD_WEAK, FUNCTION_SIO);
    open_estop(false);
    bool follows = estop_becomes(0u);
    open_estop(true);
    follows = estop_becomes(BIT(PIN_ESTOP)) && follows;
    open_estop(false);
    follows = estop_becomes(0u) && follows;
    REG(IO_INTR2) = EDGES_OF_WIRES;
    ends_before = REG(SIO_GPIO_IN);
    REG(IO_PROC0_INTE2) = EDGES_OF_WIRES;
    return follows;
}

/* A look takes as long at a high pin as at a low one, or the share would be wrong. */
static void count_highs(rig_loopback_view *view)
{
    uint32_t ends[2] = {0, 0};
    uint32_t outputs[2] = {0, 0};
    for (uint32_t i = 0; i < LOOKS; i++) {
        const uint32_t now = REG(SIO_GPIO_IN);
        ends[0] += (now >> PIN_WIRE_A) & 1u;
        ends[1] += (now >> PIN_WIRE_B) & 1u;
        outputs[0] += (now >> PIN_PWM_A) & 1u;
        outputs[1] += (now >> PIN_PWM_B) & 1u;
    }
    for (uint32_t i = 0; i < 2u; i++) {
        view->wire[i].wire_highs = (uint16_t)ends[i];
        view->wire[i].pin_highs = (uint16_t)outputs[i];
    }
    view->looks = LOOKS;
}

static void look(rig_loopback_view *view, bool share)
{
    if (share) {
        REG(IO_PROC0_INTE2) = 0; /* else each edge would hide what follows it */
        count_highs(view);
        REG(IO_PROC0_INTE2) = EDGES_OF_WIRES;
    }
    const uint32_t before = cpu_hold_interrupts();
    const uint32_t now = REG(SIO_GPIO_IN);
    view->high = (uint8_t)(((now & ENDS[0]) != 0u ? 1u : 0u) | ((now & ENDS[1]) != 0u ? 2u : 0u));
    view->estop_us = estop_us;
    for (uint32_t i = 0; i < 2u; i++) {
        view->wire[i].rises = rises[i];
        view->wire[i].last_us = last_us[i];
    }
    cpu_restore_interrupts(before);
}

static void hang_up(void)
{
    for (;;) {
    }
}

const rig_loopback_board LOOPBACK = {
    .begin = connect, .end = disconnect, .open_estop = open_estop, .look = look, .hang_up = hang_up
};
