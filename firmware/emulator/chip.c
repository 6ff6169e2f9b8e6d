/* What libsimavr 1.6 does not do as the chip does, and what is done about it here:
 *   - its receiver holds 64 bytes: it gets one at a time, when the last bit has arrived; two wait here, as in the chip,
 *     and one more is an overrun;
 *   - a byte takes it 11 bit times: it is told 10;
 *   - a pin set from outside is forgotten when the firmware writes the port: it is told of it as an external pull; an open
 *     contact is high by the chip's own pull-up alone;
 *   - its cycle timers are the only clock there is: the encoder's pins turn at the instant at which the bench says, by one
 *     edge at a time;
 *   - an interrupt that came while it was held back is lost to it: the tick's is raised again when it is let in;
 *   - it converts what stands in a register when the result is read: that is set at the sample's instant;
 *   - it looks at each cycle for a level that an external interrupt waits for, until that pin is high, also where edges are
 *     selected meanwhile: the encoder's pins are shown from then on;
 *   - its sleep waits for real time: not here;
 *   - PINB has the port's bits where the pins show a timer: it is read anew from the pins;
 *   - it lets a program write registers as the data sheet forbids: Timer1, on which the drive hangs, is in timer1.c, and
 *     some rules for the others are below; the first one that the program breaks is kept.
 */
#include "chip.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_timer.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_core_config.h>
#include <simavr/sim_cycle_timers.h>
#include <simavr/sim_hex.h>
#include <simavr/sim_io.h>

#include "bench.h"
#include "timer1.h"
#include "wire.h"

#define LIBRARY_VERSION "1.6" /* of the structures that are looked into here */
#define CHIP_HZ 16000000.0
#define CHIP_ADC_MAX 1023
#define RECEIVER 2u /* bytes that wait in the chip */
#define STANDS_CYCLES 800 /* after which a standing timer's level counts as a drive: a period of 20 kHz */
#define DRIVE_STEPS 32000 /* of the bridge's duty, as the bench counts it */
#define SUPPLY_FULL_V 20.0 /* motor supply that reads full scale at A2: a divider by 4 */
#define RUN_CYCLES 200u /* instructions of about so many cycles run without a look at the timers: none is due then */
#define CONTACTS 0x70u /* of port D */
#define CHANNELS 0x0Cu /* of an encoder, at port D */
#define LOOK_CYCLES 1600u /* at the shaft, at least so often: 100 us */
#define HAND_CYCLES 800u /* between two edges of a shaft that was put elsewhere: 20,000 a second */
#define ENTRY_CYCLES 4u /* of an interrupt: data sheet, section 7.7.1 */
#define PAINT 0xA7u /* of memory that nobody has written */
#define TIMED_CYCLES 4u /* within which the watchdog's register is open: section 11.9.2 */
#define CONVERTER_HZ 200000u /* its fastest clock for 10 bits: section 24.4 */

/* Addresses in data space, and bits, of the registers that make up the drive, and of some more. */
enum {
    PINB = 0x23, PIND = 0x29, DDRB = 0x24, PORTB = 0x25, PINC = 0x26, DDRC = 0x27, PORTC = 0x28, PORTD = 0x2B, TIFR2 = 0x37, SMCR = 0x53, MCUSR = 0x54, WDTCSR = 0x60, EICRA = 0x69, TIMSK2 = 0x70,
    ADCSRA = 0x7A, ADMUX = 0x7C, UCSR0A = 0xC0, UCSR0B = 0xC1, UCSR0C = 0xC2, UBRR0L = 0xC4, UBRR0H = 0xC5, RAM = 0x100
};
enum { PC_WIRE_A = 3, PC_WIRE_B = 4, PC_ESTOP = 5 }; /* of a loop-back: firmware/boards/uno/wiring.h */
enum { WIRE_A = 1, WIRE_B = 2, WIRE_ESTOP = 4 };
enum { PB_DIRECTION = 0, PB_OC1A = 1, PB_OC1B = 2, PB_LED = 5 };
enum { TIMER2_COMPB = 8, USART_RX = 18, USART_UDRE = 19 }; /* numbers of interrupts */
enum { U2X0 = 1, TXEN0 = 3, RXEN0 = 4, OCIE2A = 1, OCIE2B = 2, OCF2B = 2, ADIE = 3, ADSC = 6, WDE = 3, WDCE = 4, WDRF = 3, SE = 0 };
enum { UPE0_TO_FE0 = 0x1C };

/* Whose writes are looked at besides those that libsimavr itself tells of. */
static const avr_io_addr_t WATCHED[] = {
    DDRB, PORTB, DDRC, PORTC, PORTD, TCCR1A, TCCR1B, TCNT1L, TCNT1H, ICR1L, ICR1H, OCR1AL, OCR1AH, OCR1BL, OCR1BH,
    ADMUX, UCSR0A, UCSR0C, UBRR0L, UBRR0H, WDTCSR, EICRA
};
#define WATCHED_COUNT (sizeof WATCHED / sizeof WATCHED[0])

typedef struct {
    virtual_board *board;
    avr_io_addr_t address;
} watched;

enum bridge_style { PWM_DIR, IN1_IN2 };

struct virtual_board {
    bench_params params;
    bench bench;
    char *hex;
    enum bridge_style style;
    double dead_time_s;
    double hz;
    avr_t *avr;
    avr_uart_t *uart;
    avr_timer_t *timer2;
    timer1 timer1;
    watched watched[WATCHED_COUNT];
    avr_irq_t *uart_in, *adc_in, *port_c, *port_d;
    void (*chip_reset)(avr_t *);
    wire to_device, to_host;
    uint8_t waiting[RECEIVER]; /* bytes in the chip's receiver that libsimavr has not got yet */
    uint32_t waiting_count;
    int64_t now_ns, byte_ns, boot_until_ns;
    int64_t pin_changed_ns; /* negative: never */
    avr_cycle_count_t stop;
    uint32_t sampled_channel;
    uint8_t open_pins;       /* of port D */
    bool is_bare;            /* no bench: nothing but the wires of a loop-back */
    uint8_t wires;           /* that are there */
    avr_io_read_t read_port_b; /* libsimavr's own */
    void *port_b;
    int64_t shown_steps;     /* of the encoder, at its pins */
    uint8_t shown_open;      /* contacts, at theirs */
    bool looks;              /* at the shaft, again and again */
    bool look_again;         /* a byte for the host, or a reset: what the run waits for may have changed */
    uint8_t dead_of_timer2;  /* bits of TIMSK2, until the next reset */
    bool converter_is_dead;  /* the same */
    bool measures;
    bool has_started;        /* has unmasked interrupts since the reset */
    enum virtual_stall stall;
    avr_cycle_count_t stall_cycles, stall_end; /* end: not 0 while it lasts */
    avr_flashaddr_t stall_trap, stall_pc;      /* where it runs meanwhile, and where it goes on */
    uint8_t stall_depth;                       /* of interrupts */
    uint32_t resets, overruns, crashed;
    const char *broken_rule; /* the first one; NULL: none */
    uint8_t wdtcsr;
    avr_cycle_count_t wdtcsr_opened;
    int8_t conducts; /* the bridge, now: -1, 0, 1 */
    avr_cycle_count_t conducts_from, longest_pulse;
    uint64_t awake_cycles, masked_now, masked_most, interrupt_now, interrupt_most;
    uint64_t timed_now, timed_most, tick_now, tick_most, held_now, held_most;
    avr_cycle_count_t tick_from;
};

static void hold_to(virtual_board *b, bool kept, const char *rule)
{
    if (!kept && b->broken_rule == NULL) {
        b->broken_rule = rule;
    }
}

static bool has(uint8_t bits, unsigned bit)
{
    return ((bits >> bit) & 1u) != 0u;
}

/* ---- time ---- */

static int64_t ns_of(const virtual_board *b, avr_cycle_count_t cycle)
{
    return (int64_t)((double)cycle * (1e9 / b->hz) + 0.5);
}

static avr_cycle_count_t cycle_of(const virtual_board *b, int64_t t_ns)
{
    return (avr_cycle_count_t)ceil((double)t_ns * (b->hz * 1e-9) - 1e-6);
}

static void advance_bench(virtual_board *b)
{
    bench_advance_to(&b->bench, (double)b->avr->cycle / b->hz);
}

/* ---- wire ---- */

static avr_cycle_count_t cycles_per_byte(const virtual_board *b)
{
    const uint8_t *data = b->avr->data;
    const unsigned divisor = (data[UBRR0L] | ((unsigned)data[UBRR0H] << 8)) + 1u;
    return 10u * divisor * ((data[UCSR0A] >> U2X0) & 1u ? 8u : 16u);
}

static bool chip_has_unread_byte(const virtual_board *b)
{
    return b->uart->input.read != b->uart->input.write;
}

/* The next byte that waits becomes the one that the program reads. */
static void feed_uart(virtual_board *b)
{
    if (b->waiting_count == 0u || chip_has_unread_byte(b)) {
        return;
    }
    const uint8_t byte = b->waiting[0];
    b->waiting_count--;
    memmove(b->waiting, b->waiting + 1, b->waiting_count);
    b->uart->cycles_per_byte = 1; /* it has arrived already */
    avr_raise_irq(b->uart_in, byte);
    b->uart->cycles_per_byte = cycles_per_byte(b);
}

static void uart_byte_was_read(avr_irq_t *irq, uint32_t value, void *context)
{
    (void)irq;
    (void)value;
    feed_uart(context);
}

static avr_cycle_count_t byte_arrives(avr_t *avr, avr_cycle_count_t when, void *context)
{
    virtual_board *b = context;
    (void)when;
    while (b->to_device.count > 0u) {
        const avr_cycle_count_t due = cycle_of(b, wire_next_ns(&b->to_device));
        if (due > avr->cycle) {
            return due;
        }
        const uint8_t byte = wire_take(&b->to_device);
        if (((avr->data[UCSR0B] >> RXEN0) & 1u) == 0u) {
            b->waiting_count = 0;
        } else if (b->waiting_count + (chip_has_unread_byte(b) ? 1u : 0u) >= RECEIVER) {
            b->overruns++;
        } else {
            b->waiting[b->waiting_count++] = byte;
            feed_uart(b);
        }
    }
    return 0;
}

static void expect_byte(virtual_board *b)
{
    if (b->to_device.count > 0u) {
        const avr_cycle_count_t due = cycle_of(b, wire_next_ns(&b->to_device));
        const avr_cycle_count_t now = b->avr->cycle;
        avr_cycle_timer_register(b->avr, due > now ? due - now : 0u, byte_arrives, b);
    }
}

static void chip_sends(avr_irq_t *irq, uint32_t value, void *context)
{
    virtual_board *b = context;
    (void)irq;
    b->uart->cycles_per_byte = cycles_per_byte(b);
    const int64_t byte_ns = ns_of(b, b->uart->cycles_per_byte);
    (void)wire_put(&b->to_host, ns_of(b, b->avr->cycle), byte_ns, (uint8_t)value); /* a host that never reads loses bytes */
    b->look_again = true;
}

/* ---- converter ---- */

static int32_t channel_counts(virtual_board *b, uint32_t channel)
{
    if (channel == 0u) {
        return bench_position_counts(&b->bench);
    }
    if (channel == 1u) {
        const int32_t counts = bench_tachometer_counts(&b->bench);
        return counts < 0 ? 0 : counts;
    }
    if (channel == 2u) {
        const double counts = b->bench.p.supply_V / SUPPLY_FULL_V * CHIP_ADC_MAX;
        return counts > CHIP_ADC_MAX ? CHIP_ADC_MAX : (int32_t)counts;
    }
    return 0;
}

static avr_cycle_count_t adc_holds(avr_t *avr, avr_cycle_count_t when, void *context)
{
    virtual_board *b = context;
    (void)avr;
    (void)when;
    advance_bench(b);
    const int32_t counts = channel_counts(b, b->sampled_channel);
    avr_raise_irq(b->adc_in + b->sampled_channel, (uint32_t)counts * 64u + 32u); /* exact with avcc = 1023 * 64 */
    return 0;
}

static void adc_starts(avr_irq_t *irq, uint32_t value, void *context)
{
    virtual_board *b = context;
    (void)irq;
    union {
        avr_adc_mux_t mux;
        uint32_t value;
    } is;
    is.value = value;
    if (is.mux.kind != ADC_MUX_SINGLE || is.mux.src > 7u) {
        return;
    }
    b->sampled_channel = is.mux.src;
    const unsigned divisor = 1u << (b->avr->data[ADCSRA] & 7u);
    hold_to(b, CHIP_HZ / divisor <= CONVERTER_HZ, "the converter's clock is too fast for 10 bits, section 24.4");
    avr_cycle_timer_register(b->avr, divisor + divisor / 2u, adc_holds, b);
}

/* ---- bridge ---- */

/* Share of the time for which a pin is high: 0 where it is no output (pull-downs), the timer's where it shows that. */
static double pin_duty(const virtual_board *b, unsigned bit)
{
    const uint8_t *data = b->avr->data;
    if (((data[DDRB] >> bit) & 1u) == 0u) {
        return 0.0;
    }
    if (bit == PB_DIRECTION || !timer1_has_pin(&b->timer1, bit - PB_OC1A)) {
        return (double)((data[PORTB] >> bit) & 1u);
    }
    return timer1_share(&b->timer1, bit - PB_OC1A);
}

/* What dead time leaves of a share of the time that the bridge conducts. */
static double conducted(const virtual_board *b, double duty)
{
    const double top = (double)b->timer1.top;
    const double size = fabs(duty);
    if (b->dead_time_s == 0.0 || size == 0.0 || size == 1.0 || top == 0.0) {
        return duty;
    }
    return copysign(fmax(size - b->dead_time_s * b->hz / (2.0 * top), 0.0), duty);
}

static double bridge_duty(const virtual_board *b)
{
    const double a = pin_duty(b, PB_OC1A);
    if (b->style == PWM_DIR) {
        return pin_duty(b, PB_DIRECTION) > 0.0 ? -a : a;
    }
    return a - pin_duty(b, PB_OC1B);
}

static int8_t pin_level(const virtual_board *b, unsigned bit)
{
    const uint8_t *data = b->avr->data;
    const bool shows_timer = bit != PB_DIRECTION && timer1_has_pin(&b->timer1, bit - PB_OC1A);
    const bool high = shows_timer ? b->timer1.level[bit - PB_OC1A] : ((data[PORTB] >> bit) & 1u) != 0u;
    return high && ((data[DDRB] >> bit) & 1u) != 0u ? 1 : 0;
}

static void keep_most(uint64_t *most, uint64_t value)
{
    *most = value > *most ? value : *most;
}

/* The bench gets the mean over a period; how long the bridge conducts without a break is kept beside it, edge by edge. */
static void levels_may_have_changed(virtual_board *b, avr_cycle_count_t at)
{
    const int8_t a = pin_level(b, PB_OC1A);
    const int8_t other = pin_level(b, b->style == PWM_DIR ? PB_DIRECTION : PB_OC1B);
    const int8_t now = (int8_t)(b->style == PWM_DIR ? a * (1 - 2 * other) : a - other);
    if (now != b->conducts) {
        if (b->conducts != 0) {
            keep_most(&b->longest_pulse, at - b->conducts_from);
        }
        b->conducts = now;
        b->conducts_from = at;
    }
}

/* ---- the wires of a loop-back ---- */

/* Of PINB: what is at the pins, as a program sees it. */
static uint8_t read_port_b(avr_t *avr, avr_io_addr_t address, void *context)
{
    virtual_board *b = context;
    const uint8_t outputs = (1u << PB_OC1A) | (1u << PB_OC1B);
    const uint8_t value = b->read_port_b(avr, address, b->port_b);
    timer1_advance(&b->timer1, avr->cycle);
    const unsigned levels = ((unsigned)pin_level(b, PB_OC1A) << PB_OC1A) | ((unsigned)pin_level(b, PB_OC1B) << PB_OC1B);
    const uint8_t driven = outputs & avr->data[DDRB];
    avr->data[address] = (uint8_t)((value & ~driven) | (levels & driven));
    return avr->data[address];
}

/* At the end of a wire, or of none: pulled up, or low. */
static bool end_level(const virtual_board *b, unsigned joins, unsigned output, unsigned end)
{
    return (b->wires & joins) != 0u ? pin_level(b, output) != 0 : has(b->avr->data[PORTC], end);
}

static void show_end(virtual_board *b, unsigned end, bool level)
{
    const uint32_t is = level ? 1u : 0u;
    if (b->port_c[end].value != is || has(b->avr->data[PINC], end) != level) {
        b->port_c[end].value = 1u - is; /* as in tell_contacts */
        avr_raise_irq(b->port_c + end, is);
    }
}

/* The edges of the bridge's outputs go through the wires as they come. */
static avr_cycle_count_t show_ends(avr_t *avr, avr_cycle_count_t when, void *context)
{
    virtual_board *b = context;
    (void)when;
    timer1_advance(&b->timer1, avr->cycle);
    const bool a = end_level(b, WIRE_A, PB_OC1A, PC_WIRE_A);
    const bool other = end_level(b, WIRE_B, b->style == PWM_DIR ? PB_DIRECTION : PB_OC1B, PC_WIRE_B);
    const uint8_t high = (uint8_t)((a ? 1u << PC_WIRE_A : 0u) | (other ? 1u << PC_WIRE_B : 0u));
    avr_ioport_external_t pulls = {.name = 'C', .mask = (1u << PC_WIRE_A) | (1u << PC_WIRE_B), .value = high};
    avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('C'), &pulls);
    show_end(b, PC_WIRE_A, a);
    show_end(b, PC_WIRE_B, other);
    const uint64_t next = timer1_next(&b->timer1);
    return next == UINT64_MAX ? 0u : next;
}

static void look_at_ends(virtual_board *b)
{
    if (b->is_bare && b->wires != 0u) {
        avr_cycle_timer_cancel(b->avr, show_ends, b);
        avr_cycle_timer_register(b->avr, 1u, show_ends, b);
    }
}

static void timer1_changed(void *context)
{
    virtual_board *b = context;
    levels_may_have_changed(b, b->timer1.at);
}

/* A pulse that has begun in the last period begins anew in each. */
static void timer1_skips(void *context, uint64_t cycles)
{
    virtual_board *b = context;
    if (b->timer1.at - cycles - b->conducts_from < 2u * (uint64_t)b->timer1.top) {
        b->conducts_from += cycles;
    }
}

static void set_bench_drive(virtual_board *b)
{
    const int32_t units = (int32_t)lround(conducted(b, bridge_duty(b)) * DRIVE_STEPS);
    if (units != b->bench.pin_units) {
        advance_bench(b);
        bench_set_drive(&b->bench, units);
        b->pin_changed_ns = ns_of(b, b->avr->cycle);
    }
}

static bool pin_shows_timer(const virtual_board *b)
{
    return timer1_has_pin(&b->timer1, 0u) || timer1_has_pin(&b->timer1, 1u);
}

static avr_cycle_count_t stood_for_a_period(avr_t *avr, avr_cycle_count_t when, void *board)
{
    (void)avr;
    (void)when;
    virtual_board *b = board;
    if (timer1_stands(&b->timer1)) {
        set_bench_drive(b);
    }
    return 0;
}

/* A program starts its pulses in a few instructions. The level that a pin has meanwhile is no drive: for the bench, whose
 * motor has no inductance, a fifth of a microsecond of full drive would break a static friction. */
static void pins_may_have_changed(virtual_board *b)
{
    if (pin_shows_timer(b) && timer1_stands(&b->timer1)) {
        avr_cycle_timer_register(b->avr, STANDS_CYCLES, stood_for_a_period, b);
    } else {
        set_bench_drive(b);
    }
    if ((b->avr->data[DDRB] & b->avr->data[PORTB] & (1u << PB_LED)) != 0u) {
        advance_bench(b);
        bench_arm(&b->bench); /* lit: armed */
    }
}

/* ---- what the data sheet does not let a program write ---- */

static unsigned instruction(const avr_t *avr)
{
    return avr->flash[avr->pc] | ((unsigned)avr->flash[avr->pc + 1u] << 8);
}

/* By SBI or CBI, which no interrupt can split from what it has read. */
static bool writes_one_bit(const avr_t *avr)
{
    return (instruction(avr) & 0xFD00u) == 0x9800u;
}

/* STS and ST, ST with a displacement, OUT, SBI and CBI: libsimavr tells of reads, too. */
static bool writes(const avr_t *avr)
{
    const unsigned i = instruction(avr);
    return (i & 0xFE00u) == 0x9200u || (i & 0xD200u) == 0x8200u || (i & 0xF800u) == 0xB800u || writes_one_bit(avr);
}

static void watchdog_written(virtual_board *b, uint8_t value)
{
    const avr_t *avr = b->avr;
    const uint8_t kept = (uint8_t)~(1u << WDCE);
    const bool opens = has(value, WDCE) && has(value, WDE);
    const bool is_open = b->wdtcsr_opened != 0u && avr->cycle - b->wdtcsr_opened <= TIMED_CYCLES;
    hold_to(b, !avr->sreg[S_I], "WDTCSR written with interrupts on, section 11.9.2");
    hold_to(b, opens || is_open || (value & kept) == (b->wdtcsr & kept), "WDTCSR changed without its timed sequence, section 11.9.2");
    hold_to(b, has(value, WDE) || !has(avr->data[MCUSR], WDRF), "WDE cleared while WDRF is set, section 11.9.2");
    b->wdtcsr_opened = opens ? avr->cycle : 0u;
    b->wdtcsr = opens ? b->wdtcsr : value;
}

static uint8_t open_contacts(const virtual_board *b)
{
    if (b->is_bare) {
        const uint8_t *data = b->avr->data;
        const bool is_low = (b->wires & WIRE_ESTOP) != 0u && has(data[DDRC], PC_ESTOP) && !has(data[PORTC], PC_ESTOP);
        return is_low ? CONTACTS & ~0x10u : CONTACTS;
    }
    const unsigned estop = bench_estop_is_open(&b->bench) ? 0x10u : 0u;
    const unsigned ends = (bench_end_is_open(&b->bench, false) ? 0x20u : 0u) | (bench_end_is_open(&b->bench, true) ? 0x40u : 0u);
    return (uint8_t)(b->open_pins | estop | ends);
}

/* Which contacts read high: the open ones, where the pull-up is on. The encoder drives its pins itself. */
static void tell_contacts(virtual_board *b)
{
    const uint8_t selected = b->avr->data[EICRA];
    const bool has_encoder = b->params.encoder != 0 && (selected & 3u) != 0u && (selected & 0xCu) != 0u;
    const unsigned levels = has_encoder ? bench_encoder_levels(&b->bench, b->shown_steps) << 2 : 0u;
    b->shown_open = open_contacts(b);
    const uint8_t high = (uint8_t)((b->shown_open & b->avr->data[PORTD] & CONTACTS) | levels);
    const uint8_t mask = has_encoder ? CONTACTS | CHANNELS : CONTACTS;
    avr_ioport_external_t pulls = {.name = 'D', .mask = mask, .value = high};
    avr_ioctl(b->avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('D'), &pulls);
    for (unsigned pin = 0; pin < 8u; pin++) {
        const uint32_t level = has(high, pin) ? 1u : 0u;
        if (has(mask, pin) && (b->port_d[pin].value != level || has(b->avr->data[PIND], pin) != has(high, pin))) {
            b->port_d[pin].value = 1u - level; /* a reset clears PIND and not this, and what is equal is not told */
            avr_raise_irq(b->port_d + pin, level);
        }
    }
}

/* Turns the encoder's pins by one edge, if the shaft has, and comes again when the next one is due. */
static avr_cycle_count_t look_at_shaft(avr_t *avr, avr_cycle_count_t when, void *context)
{
    virtual_board *b = context;
    (void)when;
    advance_bench(b);
    double to_next;
    const int64_t steps = bench_encoder_steps(&b->bench, &to_next);
    const int64_t behind = steps > b->shown_steps ? steps - b->shown_steps : b->shown_steps - steps;
    if (behind != 0 || open_contacts(b) != b->shown_open) {
        b->shown_steps += steps > b->shown_steps ? 1 : steps < b->shown_steps ? -1 : 0;
        tell_contacts(b);
    }
    const double period = b->hz / fabs(b->bench.v_rad_per_s / b->params.rad_per_count);
    if (behind > 1) { /* it was put here, or pushed: no two edges come closer than those of its speed */
        return avr->cycle + (period < HAND_CYCLES ? (avr_cycle_count_t)period + 1u : HAND_CYCLES);
    }
    const double cycles = behind == 1 ? fmax(to_next, 0.5) * period : to_next * period;
    return avr->cycle + (cycles < LOOK_CYCLES ? (avr_cycle_count_t)cycles + 1u : LOOK_CYCLES);
}

static void begin_to_look(virtual_board *b)
{
    if (b->params.encoder != 0 && !b->looks) {
        b->looks = true;
        avr_cycle_timer_register(b->avr, 1u, look_at_shaft, b);
    }
}

static void hold_to_rules(virtual_board *b, avr_io_addr_t address, uint8_t value)
{
    const avr_t *avr = b->avr;
    const bool interrupts = avr->sreg[S_I] != 0u;
    switch (address) {
    case DDRB:
    case PORTB:
    case PORTD:
        hold_to(b, !interrupts || writes_one_bit(avr), "a port read, changed and written with interrupts on, section 14.1");
        break;
    case TCNT1H:
    case ICR1H:
    case OCR1AH:
    case OCR1BH:
        hold_to(b, !interrupts, "a 16-bit register written with interrupts on, section 16.3");
        break;
    case ADMUX:
        hold_to(b, !has(avr->data[ADCSRA], ADSC), "ADMUX written while a conversion runs, section 24.5");
        break;
    case UCSR0A:
        hold_to(b, (value & UPE0_TO_FE0) == 0u, "FE0, DOR0 or UPE0 written as 1, section 20.11.2");
        break;
    case UCSR0C:
    case UBRR0L:
    case UBRR0H:
        hold_to(b, !has(avr->data[UCSR0B], RXEN0) && !has(avr->data[UCSR0B], TXEN0),
                "the serial port set up while it is on, sections 20.5 and 20.11.5");
        break;
    case WDTCSR:
        watchdog_written(b, value);
        break;
    default:
        break;
    }
}

static void register_written(avr_irq_t *irq, uint32_t value, void *context)
{
    const watched *w = context;
    virtual_board *b = w->board;
    (void)irq;
    if (!writes(b->avr)) {
        return;
    }
    hold_to_rules(b, w->address, (uint8_t)value);
    if (w->address >= TCCR1A && w->address <= OCR1BH) {
        const char *broken = timer1_write(&b->timer1, b->avr->cycle, w->address, (uint8_t)value);
        hold_to(b, broken == NULL, broken);
    } else {
        timer1_advance(&b->timer1, b->avr->cycle);
    }
    if (w->address == PORTD || w->address == EICRA || w->address == DDRC || w->address == PORTC) {
        tell_contacts(b);
    }
    look_at_ends(b);
    levels_may_have_changed(b, b->avr->cycle);
    pins_may_have_changed(b);
}

/* ---- clock ---- */

static void timer2_mask_written(avr_irq_t *irq, uint32_t value, void *context)
{
    virtual_board *b = context;
    uint8_t *data = b->avr->data;
    (void)irq;
    (void)value;
    data[TIMSK2] = (uint8_t)(data[TIMSK2] & ~b->dead_of_timer2);
    avr_int_vector_t *tick = &b->timer2->comp[AVR_TIMER_COMPB].interrupt;
    if ((data[TIMSK2] & (1u << OCIE2B)) != 0u && (data[TIFR2] & (1u << OCF2B)) != 0u && !tick->pending) {
        avr_raise_interrupt(b->avr, tick);
    }
}

/* ---- the chip as a whole ---- */

static void quiet(avr_t *avr, const int level, const char *format, va_list arguments)
{
    (void)avr;
    (void)level;
    (void)format;
    (void)arguments;
}

static void sleep_takes_no_time(avr_t *avr, avr_cycle_count_t how_long)
{
    (void)avr;
    (void)how_long;
}

/* libsimavr resets a chip by itself, too: the watchdog. All its timers are gone then, ours among them. */
static void after_reset(avr_t *avr)
{
    virtual_board *b = avr->custom.data;
    b->chip_reset(avr);
    avr->data[PIND] = 0; /* no pull-up is on */
    b->waiting_count = 0;
    b->converter_is_dead = false;
    b->dead_of_timer2 = 0;
    b->stall = STALL_NONE;
    b->stall_end = 0;
    b->has_started = false;
    b->masked_now = 0;
    b->wdtcsr = avr->data[WDTCSR];
    timer1_advance(&b->timer1, avr->cycle);
    timer1_reset(&b->timer1, avr->cycle);
    levels_may_have_changed(b, avr->cycle);
    b->resets++;
    b->look_again = true;
    b->stop = 0;
    expect_byte(b);
    pins_may_have_changed(b);
    b->looks = false; /* not here: libsimavr may be in the midst of its timers */
}

static avr_uart_t *find_uart(avr_t *avr)
{
    for (avr_io_t *io = avr->io_port; io != NULL; io = io->next) {
        if (strcmp(io->kind, "uart") == 0 && ((avr_uart_t *)io)->name == '0') {
            return (avr_uart_t *)io;
        }
    }
    return NULL;
}

static avr_timer_t *find_timer2(avr_t *avr)
{
    for (avr_io_t *io = avr->io_port; io != NULL; io = io->next) {
        if (strcmp(io->kind, "timer") == 0 && ((avr_timer_t *)io)->name == '2') {
            return (avr_timer_t *)io;
        }
    }
    return NULL;
}

static const char *load(virtual_board *b)
{
    uint32_t size = 0, start = 0;
    uint8_t *code = read_ihex_file(b->hex, &size, &start);
    if (code == NULL || size + start > b->avr->flashend + 1u) {
        return "the .hex file cannot be read";
    }
    avr_loadcode(b->avr, code, size, start);
    free(code);
    return NULL;
}

static void connect(virtual_board *b)
{
    avr_t *avr = b->avr;
    for (unsigned i = 0; i < WATCHED_COUNT; i++) {
        b->watched[i] = (watched){b, WATCHED[i]};
        avr_irq_register_notify(avr_iomem_getirq(avr, WATCHED[i], NULL, AVR_IOMEM_IRQ_ALL), register_written, &b->watched[i]);
    }
    b->timer1 = (timer1){.changed = timer1_changed, .skips = timer1_skips, .context = b};
    avr_irq_register_notify(avr_iomem_getirq(avr, TIMSK2, NULL, AVR_IOMEM_IRQ_ALL), timer2_mask_written, b);
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    b->uart_in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), chip_sends, b);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XON), uart_byte_was_read, b);
    b->adc_in = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_OUT_TRIGGER), adc_starts, b);
    b->port_c = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('C'), IOPORT_IRQ_PIN0);
    b->port_d = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), IOPORT_IRQ_PIN0);
    b->read_port_b = avr->io[AVR_DATA_TO_IO(PINB)].r.c;
    b->port_b = avr->io[AVR_DATA_TO_IO(PINB)].r.param;
    avr->io[AVR_DATA_TO_IO(PINB)].r.c = read_port_b;
    avr->io[AVR_DATA_TO_IO(PINB)].r.param = b;
}

virtual_board *virtual_new(void)
{
    virtual_board *b = calloc(1, sizeof *b);
    if (b != NULL) {
        bench_defaults(&b->params);
    }
    return b;
}

void virtual_free(virtual_board *b)
{
    if (b->avr != NULL) {
        avr_terminate(b->avr);
        free(b->avr);
    }
    free(b->hex);
    free(b);
}

const char *virtual_option(virtual_board *b, const char *name, const char *value)
{
    if (strcmp(name, "hex") == 0) {
        free(b->hex);
        b->hex = strdup(value);
        return NULL;
    }
    if (strcmp(name, "bridge") == 0) {
        b->style = strcmp(value, "in1_in2") == 0 ? IN1_IN2 : PWM_DIR;
        return b->style == IN1_IN2 || strcmp(value, "pwm_dir") == 0 ? NULL : "no such bridge";
    }
    if (strcmp(name, "dead-time-s") == 0) {
        char *end;
        b->dead_time_s = strtod(value, &end);
        return end != value && *end == '\0' && b->dead_time_s >= 0.0 && b->dead_time_s < 1e-3 ? NULL : "0 to 1e-3";
    }
    if (strcmp(name, "bare") == 0) { /* its wires */
        b->is_bare = true;
        b->wires = (uint8_t)strtoul(value, NULL, 10);
        return b->wires <= (WIRE_A | WIRE_B | WIRE_ESTOP) ? NULL : "bits: 1 of PWM or IN1, 2 of direction or IN2, 4 of the e-stop";
    }
    if (strcmp(name, "measure") == 0) {
        b->measures = strcmp(value, "1") == 0;
        return NULL;
    }
    return bench_option(&b->params, name, value);
}

const char *virtual_start(virtual_board *b, int64_t byte_ns)
{
    if (strcmp(CONFIG_SIMAVR_VERSION, LIBRARY_VERSION) != 0) {
        return "this is made for libsimavr " LIBRARY_VERSION ", not " CONFIG_SIMAVR_VERSION;
    }
    const char *wrong = bench_check(&b->params);
    if (wrong != NULL) {
        return wrong;
    }
    if (b->params.counts_max != CHIP_ADC_MAX) {
        return "the chip's converter reads 0 to 1023";
    }
    if (b->params.clock_start_us != 0u) {
        return "the chip's clock starts at 0";
    }
    avr_global_logger_set(quiet);
    b->avr = avr_make_mcu_by_name("atmega328p");
    if (b->avr == NULL || b->hex == NULL) {
        return "no such chip, or no hex";
    }
    b->hz = CHIP_HZ * (1.0 + 1e-6 * b->params.clock_error_ppm);
    b->byte_ns = byte_ns;
    b->pin_changed_ns = -1;
    b->params.drive_counts = DRIVE_STEPS;
    bench_init(&b->bench, &b->params);
    avr_init(b->avr);
    b->avr->frequency = (uint32_t)CHIP_HZ;
    b->avr->vcc = b->avr->avcc = b->avr->aref = CHIP_ADC_MAX * 64u;
    b->avr->sleep = sleep_takes_no_time;
    b->uart = find_uart(b->avr);
    b->timer2 = find_timer2(b->avr);
    if (b->uart == NULL || b->timer2 == NULL || b->timer2->comp[AVR_TIMER_COMPB].interrupt.vector != TIMER2_COMPB) {
        return "libsimavr's serial port or clock is not where it should be";
    }
    connect(b);
    double to_next;
    b->shown_steps = bench_encoder_steps(&b->bench, &to_next);
    tell_contacts(b);
    look_at_ends(b);
    memset(b->avr->data + RAM, PAINT, b->avr->ramend + 1u - RAM);
    b->avr->custom.data = b;
    b->chip_reset = b->avr->reset;
    b->avr->reset = after_reset;
    return load(b);
}

/* ---- running ---- */

/* Until another stop takes its place, so that a program that falls asleep just then does not sleep past it. */
static avr_cycle_count_t stop_here(avr_t *avr, avr_cycle_count_t when, void *context)
{
    (void)when;
    (void)context;
    return avr->cycle + 1u;
}

/* Cycles of the interrupt that an instruction belonged to; none: the main program. */
static void count_interrupt(virtual_board *b, uint8_t vector, uint64_t cycles)
{
    b->interrupt_now += cycles;
    if (vector != USART_RX && vector != USART_UDRE) {
        b->timed_now += cycles;
    }
    if (vector == TIMER2_COMPB) {
        b->tick_now += cycles;
        keep_most(&b->tick_most, b->tick_now);
    }
}

/* How long interrupts stay masked, what they take of a millisecond, and how long the tick is, without those that come
 * between. `cycles`: of one instruction in the interrupt `vector` (0: none). What libsimavr leaves out, the cycles of
 * entering an interrupt, is added. */
static void measure(virtual_board *b, uint8_t vector, uint8_t depth, uint64_t cycles)
{
    const avr_int_table_t *interrupts = &b->avr->interrupts;
    const uint64_t entry = interrupts->running_ptr > depth ? ENTRY_CYCLES : 0u;
    if (vector != 0u) {
        count_interrupt(b, vector, cycles);
    }
    if (entry > 0u) {
        const uint8_t entered = interrupts->running[interrupts->running_ptr - 1]->vector;
        b->tick_now = entered == TIMER2_COMPB ? 0u : b->tick_now;
        count_interrupt(b, entered, entry);
    }
    if (b->avr->sreg[S_I]) {
        b->masked_now = 0;
        b->has_started = true;
    } else if (b->has_started) {
        b->masked_now += entry > 0u ? entry : cycles;
        keep_most(&b->masked_most, b->masked_now);
    }
    const bool is_held = b->has_started && b->dead_of_timer2 == 0u && (b->avr->data[TIMSK2] & (1u << OCIE2B)) == 0u;
    b->held_now = is_held ? b->held_now + cycles + entry : 0u;
    keep_most(&b->held_most, b->held_now);
    if (b->avr->cycle - b->tick_from >= (avr_cycle_count_t)(CHIP_HZ / 1000.0)) {
        b->tick_from = b->avr->cycle;
        keep_most(&b->interrupt_most, b->interrupt_now);
        keep_most(&b->timed_most, b->timed_now);
        b->interrupt_now = b->timed_now = 0;
    }
}

static bool may_stall(const virtual_board *b)
{
    const avr_t *avr = b->avr;
    const uint8_t depth = avr->interrupts.running_ptr;
    if (avr->state != cpu_Running || !avr->sreg[S_I] || (avr->data[TIMSK2] & (1u << OCIE2B)) == 0u) {
        return false;
    }
    return b->stall == STALL_MAIN ? depth == 0u
                                  : depth > 0u && avr->interrupts.running[depth - 1u]->vector == TIMER2_COMPB;
}

/* Sends the program into an endless loop where it is to stall, and back when that is over. */
static void stall(virtual_board *b)
{
    avr_t *avr = b->avr;
    if (b->stall_end == 0u && may_stall(b)) {
        b->stall_pc = avr->pc;
        b->stall_depth = avr->interrupts.running_ptr;
        b->stall_end = avr->cycle + b->stall_cycles;
        avr->pc = b->stall_trap;
    } else if (b->stall_end != 0u && avr->cycle >= b->stall_end && avr->pc == b->stall_trap &&
               avr->interrupts.running_ptr == b->stall_depth) {
        avr->pc = b->stall_pc;
        b->stall_end = 0;
        b->stall = STALL_NONE;
    }
}

static void step(virtual_board *b)
{
    if (b->stall != STALL_NONE) {
        stall(b);
    }
    avr_t *avr = b->avr;
    const avr_cycle_count_t from = avr->cycle;
    const bool was_asleep = avr->state == cpu_Sleeping;
    const avr_cycle_count_t most = b->measures ? 1u : RUN_CYCLES;
    const uint8_t depth = avr->interrupts.running_ptr;
    const uint8_t vector = depth > 0u ? avr->interrupts.running[depth - 1u]->vector : 0u;
    avr->run_cycle_limit = most; /* a reset sets it to 1 */
    if (avr->run_cycle_count > most) {
        avr->run_cycle_count = most;
    }
    if (b->converter_is_dead) {
        avr->data[ADCSRA] = (uint8_t)(avr->data[ADCSRA] & ~(1u << ADIE)); /* its interrupt never comes */
    }
    const int state = avr_run(avr);
    if (state == cpu_Crashed || state == cpu_Done || state == cpu_Stopped) {
        b->crashed++;
        avr->cycle = b->stop;
        return;
    }
    if (!was_asleep && avr->state == cpu_Sleeping) {
        hold_to(b, avr->data[SMCR] == (1u << SE), "asleep not in idle mode, or not enabled, section 10.11.1");
    }
    if (!was_asleep && avr->state != cpu_Sleeping) { /* falling asleep takes libsimavr up to its next timer */
        b->awake_cycles += avr->cycle - from;
    }
    if (b->measures) {
        measure(b, vector, depth, was_asleep ? 0u : avr->cycle - from);
    }
}

static void stop_at(virtual_board *b, int64_t t_ns)
{
    const avr_cycle_count_t stop = cycle_of(b, t_ns);
    if (stop != b->stop && stop > b->avr->cycle) {
        avr_cycle_timer_register(b->avr, stop - b->avr->cycle, stop_here, b);
        b->stop = stop;
    }
}

/* In the boot loader: pins float, bytes are lost. */
static void boot(virtual_board *b, int64_t until_ns)
{
    const int64_t end_ns = until_ns < b->boot_until_ns ? until_ns : b->boot_until_ns;
    while (wire_next_ns(&b->to_device) <= end_ns) {
        (void)wire_take(&b->to_device);
    }
    const avr_cycle_count_t end = cycle_of(b, end_ns);
    if (end > b->avr->cycle) {
        b->avr->cycle = end;
    }
}

void virtual_run(virtual_board *b, int64_t until_ns, int32_t until)
{
    for (;;) {
        const int64_t reply_ns = wire_arrival_ns(&b->to_host, until);
        const int64_t next_ns = reply_ns < until_ns ? reply_ns : until_ns;
        if (b->now_ns < b->boot_until_ns) {
            boot(b, next_ns);
            if (next_ns < b->boot_until_ns) {
                b->now_ns = next_ns > b->now_ns ? next_ns : b->now_ns;
                return;
            }
            b->now_ns = b->boot_until_ns;
            expect_byte(b);
        }
        b->look_again = false;
        begin_to_look(b);
        stop_at(b, next_ns);
        const avr_cycle_count_t stop = cycle_of(b, next_ns);
        while (b->avr->cycle < stop && !b->look_again) {
            step(b);
        }
        if (b->avr->cycle >= stop) {
            b->now_ns = next_ns > b->now_ns ? next_ns : b->now_ns;
            advance_bench(b);
            return;
        }
    }
}

int64_t virtual_now_ns(const virtual_board *b)
{
    return b->now_ns;
}

uint32_t virtual_write(virtual_board *b, const uint8_t *bytes, uint32_t n)
{
    const bool was_empty = b->to_device.count == 0u;
    const uint32_t taken = wire_put_all(&b->to_device, b->now_ns, b->byte_ns, bytes, n);
    if (was_empty && b->now_ns >= b->boot_until_ns) {
        expect_byte(b);
    }
    return taken;
}

uint32_t virtual_read(virtual_board *b, uint8_t *bytes, uint32_t n)
{
    return wire_take_arrived(&b->to_host, b->now_ns, bytes, n);
}

/* ---- what may happen to it, and what is true of it ---- */

void virtual_boot(virtual_board *b, uint8_t cause, double boot_s)
{
    avr_reset(b->avr);
    b->avr->data[MCUSR] = cause;
    b->boot_until_ns = b->now_ns + (int64_t)(1e9 * boot_s);
}

void virtual_contact(virtual_board *b, int32_t pin, int32_t is_open)
{
    const uint8_t bit = (uint8_t)(1u << pin);
    b->open_pins = (uint8_t)(is_open ? b->open_pins | bit : b->open_pins & ~bit);
    tell_contacts(b);
}

/* An instruction that jumps to itself: where a program without an end is sent when it ends. */
static bool find_trap(const avr_t *avr, avr_flashaddr_t *at)
{
    for (avr_flashaddr_t i = 0; i + 1u <= avr->flashend; i += 2u) {
        if (avr->flash[i] == 0xFFu && avr->flash[i + 1u] == 0xCFu) {
            *at = i;
            return true;
        }
    }
    return false;
}

static void die_of_timer2(virtual_board *b, unsigned bit)
{
    b->dead_of_timer2 = (uint8_t)(b->dead_of_timer2 | (1u << bit));
    b->avr->data[TIMSK2] = (uint8_t)(b->avr->data[TIMSK2] & ~b->dead_of_timer2);
}

int32_t virtual_hang(virtual_board *b, int32_t how)
{
    avr_t *avr = b->avr;
    for (unsigned i = 0; i < 100000u && (avr->interrupts.running_ptr > 0 || !avr->sreg[S_I]); i++) {
        step(b); /* out of an interrupt */
    }
    if (how == HANG_CLOCK) {
        die_of_timer2(b, OCIE2A);
        return 1;
    }
    if (how == HANG_TICK) {
        die_of_timer2(b, OCIE2B);
        return 1;
    }
    if (how == HANG_CONVERTER) {
        b->converter_is_dead = true;
        return 1;
    }
    avr_flashaddr_t trap;
    if (!find_trap(avr, &trap)) {
        return 0;
    }
    avr->pc = trap;
    avr->state = cpu_Running;
    if (how == HANG_ALL) {
        avr->sreg[S_I] = 0;
        avr->interrupt_state = 0;
    }
    return 1;
}

int32_t virtual_stall(virtual_board *b, int32_t what, int64_t ns)
{
    if (!find_trap(b->avr, &b->stall_trap)) {
        return 0;
    }
    b->stall = (enum virtual_stall)what;
    b->stall_cycles = cycle_of(b, ns);
    b->stall_end = 0;
    return 1;
}

/* Bytes of memory above the longest stretch that nobody has written: the deepest that the stack has been. */
static int32_t stack_bytes(const avr_t *avr)
{
    unsigned longest = 0, length = 0;
    unsigned end = avr->ramend + 1u;
    for (unsigned at = RAM; at <= avr->ramend; at++) {
        length = avr->data[at] == PAINT ? length + 1u : 0u;
        if (length > longest) {
            longest = length;
            end = at + 1u;
        }
    }
    return (int32_t)(avr->ramend + 1u - end);
}

void virtual_look(const virtual_board *b, virtual_view *view)
{
    const avr_t *avr = b->avr;
    view->t_s = 1e-9 * (double)b->now_ns;
    view->pin_V = bench_pin_V(&b->bench);
    view->motor_V = bench_motor_V(&b->bench);
    view->y_rad = b->bench.y_rad;
    view->v_rad_per_s = b->bench.v_rad_per_s;
    view->pin_changed_s = 1e-9 * (double)b->pin_changed_ns;
    view->awake_share = avr->cycle > 0u ? (double)b->awake_cycles / (double)avr->cycle : 0.0;
    view->masked_us = 1e6 * (double)b->masked_most / CHIP_HZ;
    view->interrupt_share = (double)b->interrupt_most / (CHIP_HZ / 1000.0);
    view->timed_share = (double)b->timed_most / (CHIP_HZ / 1000.0);
    view->tick_us = 1e6 * (double)b->tick_most / CHIP_HZ;
    view->led = (avr->data[DDRB] & avr->data[PORTB] & (1u << PB_LED)) != 0u;
    view->resets = (int32_t)b->resets;
    view->overruns = (int32_t)b->overruns;
    view->crashed = (int32_t)b->crashed;
    view->stack_bytes = stack_bytes(avr);
}

double virtual_held_us(const virtual_board *b)
{
    return 1e6 * (double)b->held_most / CHIP_HZ;
}

const char *virtual_broken_rule(const virtual_board *b)
{
    return b->broken_rule != NULL ? b->broken_rule : "";
}

double virtual_longest_pulse_s(virtual_board *b)
{
    timer1_advance(&b->timer1, b->avr->cycle);
    avr_cycle_count_t longest = b->longest_pulse;
    if (b->conducts != 0) {
        keep_most(&longest, b->avr->cycle - b->conducts_from);
    }
    b->longest_pulse = 0;
    return (double)longest / CHIP_HZ;
}

const char *virtual_rewire(virtual_board *b, const char *drive, const char *sensor)
{
    advance_bench(b);
    const char *wrong = bench_rewire(&b->bench, drive, sensor);
    tell_contacts(b);
    return wrong;
}

void virtual_place(virtual_board *b, double y_rad, double v_rad_per_s)
{
    advance_bench(b);
    b->bench.y_rad = y_rad;
    b->bench.v_rad_per_s = v_rad_per_s;
    b->looks = false; /* it looks at once: of edges that came since the last look none would come sooner than its speed has them */
}
