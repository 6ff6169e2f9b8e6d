/* The device: protocol version 2, arming, travel limits, host watchdog and latched faults.
 *
 * Portable C99 with no hardware in it. A board fills in `rig_board` and calls
 *
 *     rig_init   once after a reset, before any tick
 *     rig_tick   every RIG_TICK_US: samples, checks, decides, drives; sends nothing
 *     rig_byte   for each byte received
 *     rig_stream whenever there is time, at least every few ms while a relay runs: sends a block that is full
 *
 * rig_tick may interrupt the other two, which come from one context (the main loop); nothing may interrupt rig_tick with
 * a call in here. What they share is touched by the main loop only between hold_tick and release_tick, shortly:
 * a request acts as a whole between two ticks. Frames are decoded and encoded outside of that. None of the calls waits. A
 * hung main loop does not hold up what the tick promises; that it hangs is the business of the board's hardware watchdog.
 *
 * What the device promises, whatever the host does (the code names these where it keeps them):
 *     P1 after a reset the drive is 0, and stays 0 until SETUP and ARM
 *     P2 more drive than max_drive never reaches the pin
 *     P3 host silence longer than watchdog_ms sets the drive to 0, at most one tick later;
 *        while something drives, only DRIVE and PULSE count as the host's voice; while a law of the device runs, only KEEP
 *     P4 a position outside the hard limits sets the drive to 0, at most one tick later
 *     P5 a sensor at its rail sets the drive to 0, at most one tick later
 *     P6 armed outside a hard limit, only drive inward reaches the pin
 *     P7 a fault latches: nothing arms until an ACK has named it, which is refused while its cause lasts; STOP and ARM
 *        clear nothing
 *     P8 only a whole frame with a valid CRC can change anything
 *     P9 the e-stop or an end switch sets the drive to 0, at most one tick later (a board may do it sooner)
 *    P10 the e-stop latches whether armed or not, a reset always; so do, once SETUP has told what they are, the rail and
 *        both end switches at once. Travel and one end switch latch only while armed: P6 recovers from them
 *    P11 ARM names the session that SETUP has begun; a reset ends it
 *    P12 a stroke drives no longer than its time; after two in a row that failed nothing drives
 *    P13 an encoder counts from anywhere: nothing but a homing arms before ZERO has said where it stands. A reset ends
 *        that, a homing as it begins, and a fault of the encoder, which latches whether armed or not: no ZERO until ACK
 *    P14 without travel limits nothing arms until the e-stop has been open since the reset
 *    P15 loop-back begins only disarmed, and only where the e-stop's input follows a pin of the board's own: no bench is
 *        wired so. In it at most half of full duty reaches the pin, and no law runs. HELLO ends it, and so does a reset
 *    P16 a pulse drives no longer than its time, at most one tick more, whatever the host does; after that no PULSE drives
 *        until a DRIVE has come
 *
 * Two laws can run in the device, one at a time: the relay (relay.h), started by RELAY, and the stroke test (strokes.h),
 * started by STROKES. The law drives at each tick, after P3, P4, P5 and P9 have been looked at. Whatever disarms ends it;
 * so does DRIVE, which takes over. Each of its ticks is a row that goes to the host unasked, in blocks (blocks.h); the
 * last block says by its status that the law has ended.
 */
#ifndef RIG_CORE_H
#define RIG_CORE_H

#include <stdbool.h>
#include <stdint.h>

#include "blocks.h"
#include "frames.h"
#include "relay.h"
#include "strokes.h"

#define RIG_PROTOCOL 2u
#define RIG_TICK_US 1000u
#define RIG_TACH_NONE 0xFFFFu
#define RIG_BUILD_LENGTH 16u
#define RIG_WATCHDOG_MAX_MS 1000u
#define RIG_LOOPBACK_PART 2u /* of full duty, the most in loop-back: P15 */

enum rig_board_id { RIG_BOARD_HOST = 1, RIG_BOARD_UNO = 2, RIG_BOARD_PICO = 3 };

/* What the board's outputs are wired for. */
enum rig_bridge { RIG_BRIDGE_NONE = 0, RIG_BRIDGE_PWM_DIR = 1, RIG_BRIDGE_IN1_IN2 = 2 };

enum rig_reset_cause { RIG_RESET_POWER_ON = 1, RIG_RESET_EXTERNAL = 2, RIG_RESET_BROWN_OUT = 4, RIG_RESET_WATCHDOG = 8 };

/* A board's count from the first bit, the core's from the last. */
enum rig_feature { RIG_FEATURE_TACHOMETER = 1, RIG_FEATURE_SUPPLY = 2, RIG_FEATURE_ENCODER = 4, RIG_FEATURE_PULSE = 32,
                   RIG_FEATURE_LOOPBACK = 64, RIG_FEATURE_STROKES = 128 };

enum rig_status {
    RIG_STATUS_ARMED = 1,
    RIG_STATUS_FAULT = 2,
    RIG_STATUS_RECOVERING = 4,
    RIG_STATUS_LAW = 8,
    RIG_STATUS_ZERO = 16,       /* ZERO has said where the encoder stands */
    RIG_STATUS_ESTOP_TRIED = 32, /* it has been open since the reset */
    RIG_STATUS_LOOPBACK = 64
};

enum rig_type {
    RIG_HELLO = 0x01,
    RIG_SETUP = 0x02,
    RIG_ARM = 0x03,
    RIG_READ = 0x04,
    RIG_DRIVE = 0x05,
    RIG_STOP = 0x06,
    RIG_RELAY = 0x07,
    RIG_KEEP = 0x08,
    RIG_BLOCK = 0x89, /* unasked, while a law runs */
    RIG_ACK = 0x0A,
    RIG_STROKES = 0x0B,
    RIG_ZERO = 0x0C,
    RIG_LOOPBACK = 0x0D,
    RIG_PULSE = 0x0E,
    RIG_REPLY = 0x80, /* set in the type of a reply */
    RIG_NACK = 0xFF
};

enum rig_code {
    RIG_OK = 0,
    RIG_E_VERSION = 1,
    RIG_E_TYPE = 2,
    RIG_E_LENGTH = 3,
    RIG_E_NOT_ARMED = 4,
    RIG_E_WATCHDOG = 5,
    RIG_E_TRAVEL = 6,
    RIG_E_SENSOR = 7,
    RIG_E_DRIVE_RANGE = 8,
    RIG_E_SETUP = 9,
    RIG_E_NO_SETUP = 10,
    RIG_E_POLARITY = 11,
    RIG_E_ESTOP = 12,
    RIG_E_END_SWITCH = 13,
    RIG_E_RESET = 14,
    RIG_E_SESSION = 15,
    RIG_E_ENCODER_LOST = 16,  /* both channels changed at once: counts are lost */
    RIG_E_ENCODER_RATE = 17,  /* edges come faster than they can be counted */
    RIG_E_ENCODER_STILL = 18, /* one channel changes, the other does not: a loose wire, or a shaft that trembles */
    RIG_E_ZERO = 19,          /* nobody has said where the encoder stands: does not latch */
    RIG_E_ESTOP_UNTRIED = 20, /* does not latch; a bit of rig_core.latched has room for codes up to 31 */
    RIG_E_LOOPBACK = 21       /* its wires are not there, or it has not begun: does not latch */
};

/* What a board finds wrong with its encoder. */
enum rig_encoder_trouble { RIG_ENCODER_LOST = 1, RIG_ENCODER_RATE = 2, RIG_ENCODER_STILL = 4 };

/* Contacts that a board may have; a set bit is a contact that asks for a stop. */
enum rig_input { RIG_INPUT_ESTOP = 1, RIG_INPUT_END_LOW = 2, RIG_INPUT_END_HIGH = 4 }; /* low, high: of the counts */

/* Of a LOOPBACK. */
enum rig_loopback_act {
    RIG_LOOPBACK_END = 0,
    RIG_LOOPBACK_BEGIN = 1,
    RIG_LOOPBACK_LOOK = 2,  /* what the edges' interrupt has seen */
    RIG_LOOPBACK_SHARE = 3, /* the same, and for what share of some periods each pin is high */
    RIG_LOOPBACK_OPEN = 4,  /* the e-stop, by the board's own pin */
    RIG_LOOPBACK_CLOSE = 5,
    RIG_LOOPBACK_HANG = 6   /* the main loop, so that the hardware watchdog resets the chip */
};

/* One output of the bridge, and the input that a wire leads it to. */
typedef struct {
    uint16_t wire_highs; /* of the looks, at the wire's end */
    uint16_t pin_highs;  /* of the looks, at the output itself */
    uint16_t rises;      /* at the wire's end since the loop-back began, modulo 2^16 */
    uint32_t last_us;    /* device time of the last edge there */
} rig_loopback_wire;

typedef struct {
    uint32_t estop_us; /* device time at which the e-stop was last opened */
    uint16_t looks;    /* of a SHARE, else 0 */
    uint8_t high;      /* bits: the wires' ends now, in their order */
    rig_loopback_wire wire[2]; /* PWM or IN1; direction or IN2 */
} rig_loopback_view;

/* Wires from the bridge's outputs, and from the e-stop's input, to pins that are free on a bench. */
typedef struct {
    bool (*begin)(void); /* whether the e-stop's input follows the pin that opens and closes it */
    void (*end)(void);
    void (*open_estop)(bool open);
    void (*look)(rig_loopback_view *view, bool share);
    void (*hang_up)(void); /* the main loop: does not return */
} rig_loopback_board;

/* What the core needs of a board. */
typedef struct {
    void *context;                                                      /* handed to every function below */
    uint32_t (*micros)(void *context);                                  /* device clock, us, modulo 2^32 */
    int32_t (*position)(void *context, uint32_t *t_us);                 /* newest, counts, and when it was sampled */
    uint16_t (*tach_counts)(void *context);                             /* velocity now, or RIG_TACH_NONE */
    void (*set_drive)(void *context, int16_t units);                    /* to the pins, at once */
    void (*transmit)(void *context, const uint8_t *bytes, uint8_t n);   /* queues; must not wait */
    uint8_t (*inputs)(void *context);                                   /* RIG_INPUT_*; NULL: the board has none */
    const char *build;                                                  /* shown in HELLO, first 16 characters */
    int32_t counts_max;                                                 /* largest position; 0: an encoder, which has none */
    uint16_t drive_full;                                                /* units at full duty, 1 to 32767 */
    uint8_t board_id;
    uint8_t bridge; /* of enum rig_bridge */
    uint8_t features;
    uint32_t (*arrived_us)(void *context); /* when the byte that the core is given arrived: P3; NULL: just now */
    uint8_t (*supply)(void *context); /* motor supply, 255 for 20 V; NULL: not measured */
    /* Of an encoder; both NULL: the position is absolute. */
    void (*set_position)(void *context, int32_t counts); /* from now on the present position reads so */
    uint8_t (*encoder_troubles)(void *context);          /* RIG_ENCODER_* since the last call */
    const rig_loopback_board *loopback; /* NULL: it has no pins for it */
    /* Where the tick is an interrupt: no tick until release, and memory as it was before. NULL: all is one context. */
    void (*hold_tick)(void *context);
    void (*release_tick)(void *context); /* what came due meanwhile runs now */
} rig_board;

typedef struct {
    uint32_t session; /* chosen by the host, not 0 */
    int32_t hard_lo;  /* counts; inside is hard_lo <= counts <= hard_hi; INT32_MIN to INT32_MAX: no travel limits */
    int32_t hard_hi;
    int32_t rail_lo; /* counts at or beyond are a broken sensor; an encoder has none: both 0 */
    int32_t rail_hi;
    int32_t centre; /* kept for the host: the limits alone say what is inward */
    uint16_t max_drive;
    uint16_t watchdog_ms;
    int8_t polarity; /* +1: positive drive raises counts */
    uint8_t homing;  /* 1: no zero; the limits count from wherever an encoder was switched on; no relay */
} rig_setup;

typedef struct {
    const rig_board *board;
    frame_receiver rx;
    rig_setup setup;
    bool has_setup;
    bool armed;
    uint32_t latched;    /* a bit for each fault, 1 << its code: while one is set nothing arms */
    enum rig_code fault; /* the first that latched; RIG_E_NOT_ARMED is reported but does not latch */
    int8_t recovering;   /* 0, or the side of the hard limits we were armed on: +1 above, -1 below */
    int32_t farthest;    /* counts, while recovering: where inward drive began */
    uint8_t reset_cause;
    int16_t drive;       /* units now at the pin */
    uint16_t drive_seq;  /* of the DRIVE last accepted */
    uint32_t t_drive_us; /* when `drive` took effect */
    uint32_t t_heard_us; /* of the last frame that counts for P3 */
    bool pulsing;         /* a PULSE has come since the last DRIVE: P16 */
    uint32_t t_pulse_us;  /* when the first of them took effect */
    uint16_t pulse_ms;    /* how long they may drive in all */
    uint32_t t_sample_us;
    int32_t counts;
    uint16_t tach;
    uint8_t inputs;
    bool has_zero;       /* ZERO has said where the encoder stands */
    bool estop_tried;    /* it has been open since the reset */
    bool loopback;       /* P15 */
    bool hangs;          /* once the reply is sent */
    uint32_t ticks;      /* since the reset */
    bool running;        /* a law of the device drives */
    bool law_acted;      /* since it was started */
    uint16_t delay_us;   /* from the sample to the drive, at its last switching */
    bool stroking;       /* that law is the stroke test, else the relay */
    relay relay;
    strokes strokes;
    blocks blocks;
} rig_core;

/* `board` must outlive the core. */
void rig_init(rig_core *core, const rig_board *board, uint8_t reset_cause);
void rig_byte(rig_core *core, uint8_t byte);
void rig_tick(rig_core *core);
void rig_stream(rig_core *core);

#endif
