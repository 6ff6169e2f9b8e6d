/* A remote I/O block on libmodbus with a motor behind its registers: a peer that shares no code with rig's driver.
 *
 *     slave rtu [KEY=VALUE ...]      on a pseudo-terminal of its own; prints `port /dev/pts/N`
 *     slave tcp [KEY=VALUE ...]      on a free port of 127.0.0.1; prints `port N`
 *
 * A register is KEY=ADDRESS or KEY=ADDRESS:TYPE, its address as on the wire (from 0); what is not named does not exist:
 *     drive, sequence, control (1 arms, 0 stops), watchdog (ms), low, high (limits), max_drive, rail_low, rail_high:
 *     written
 *     position, echo, applied, status: read; with `table=input` from the input registers
 * Position and limits are (counts - offset_counts) / scale, in the type of each.
 * Status: 0 off, 1 armed, 2 silence, 3 travel, 5 drive too large, 6 drive while not armed.
 * Framing, function codes, exceptions and floats are libmodbus's: nothing of the protocol is made here.
 *
 * It answers at once: a pseudo-terminal has no wire time. It ends when its standard input does.
 */
#define _DEFAULT_SOURCE
#define _XOPEN_SOURCE 600

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <netinet/in.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { REGISTERS = 200, STEP_US = 20 };
enum type { INT16, UINT16, INT32, UINT32, FLOAT32, TYPES };
enum status { S_OFF = 0, S_ARMED = 1, S_SILENCE = 2, S_TRAVEL = 3, S_DRIVE_RANGE = 5, S_NOT_ARMED = 6 };
enum what {
    R_DRIVE, R_SEQUENCE, R_CONTROL, R_WATCHDOG, R_LOW, R_HIGH, R_MAX_DRIVE, R_RAIL_LOW, R_RAIL_HIGH, /* written */
    R_POSITION, R_ECHO, R_APPLIED, R_STATUS, /* read */
    REGISTER_NAMES
};
enum number {
    UNIT, FULL, FULL_V, TAU_S, K_RAD_S_V, FC_V, CENTRE, COUNTS_PER_RAD, COUNTS_MAX, SCALE, OFFSET, SILENCE_MS,
    NUMBERS
};

static const char *const TYPE_NAME[TYPES] = {"int16", "uint16", "int32", "uint32", "float32"};
static const char *const REGISTER_NAME[REGISTER_NAMES] = {
    "drive", "sequence", "control", "watchdog", "low", "high", "max_drive", "rail_low", "rail_high",
    "position", "echo", "applied", "status"};
static const char *const NUMBER_NAME[NUMBERS] = {
    "unit", "full", "full_V", "tau_s", "K_rad_s_V", "fc_V", "centre", "counts_per_rad", "counts_max", "scale",
    "offset_counts", "silence_ms"};

static struct {
    int address; /* -1: there is none */
    enum type type;
} map[REGISTER_NAMES];
static double number[NUMBERS] = {1, 10000, 12, 0.17, 6.5, 0.5, 512, 243.8, 1023, 1, 0, 200};
static int low_word_first, read_is_input;
static FILE *executed; /* every drive that was written, and every one that ended by itself */

static modbus_t *ctx;
static modbus_mapping_t *tables;
static enum status status;
static double drive, heard_s; /* what acts, in the drive's units; when it was last written */
static double motor_s, motor_v_rad_s, motor_y_rad; /* the motor up to a time */

static void die(const char *why, const char *of)
{
    fprintf(stderr, "slave: %s%s%s\n", why, of ? ": " : "", of ? of : "");
    exit(2);
}

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* ---- numbers in registers */

static int words(enum type type)
{
    return type >= INT32 ? 2 : 1;
}

static double get(enum what what)
{
    const uint16_t *r = tables->tab_registers + map[what].address;
    uint16_t high_first[2];
    enum type type = map[what].type;
    if (type == FLOAT32)
        return low_word_first ? modbus_get_float_cdab(r) : modbus_get_float_abcd(r);
    if (words(type) == 1)
        return type == INT16 ? (double)(int16_t)r[0] : (double)r[0];
    high_first[0] = r[low_word_first];
    high_first[1] = r[!low_word_first];
    int32_t bits = MODBUS_GET_INT32_FROM_INT16(high_first, 0);
    return type == INT32 ? (double)bits : (double)(uint32_t)bits;
}

/* libmodbus 3.1.6 swaps the bytes where it sets a float, not where it gets one: take the setter that its getter reads
 * back. */
static void set_float(float value, uint16_t *r)
{
    if (low_word_first) {
        modbus_set_float_cdab(value, r);
        if (modbus_get_float_cdab(r) != value)
            modbus_set_float_dcba(value, r);
    } else {
        modbus_set_float_abcd(value, r);
        if (modbus_get_float_abcd(r) != value)
            modbus_set_float_badc(value, r);
    }
}

static void put(enum what what, double value)
{
    if (map[what].address < 0)
        return;
    enum type type = map[what].type;
    uint16_t *table = read_is_input ? tables->tab_input_registers : tables->tab_registers;
    uint16_t *r = table + map[what].address;
    uint16_t high_first[2];
    if (type == FLOAT32) {
        set_float((float)value, r);
    } else if (words(type) == 1) {
        r[0] = (uint16_t)(int32_t)lround(value);
    } else {
        int64_t bits = llround(value);
        MODBUS_SET_INT32_TO_INT16(high_first, 0, (uint32_t)bits);
        r[low_word_first] = high_first[0];
        r[!low_word_first] = high_first[1];
    }
}

/* ---- the motor and what watches over it */

/* Reading of the sensor in the units of its register. */
static double position(void)
{
    double counts = round(number[CENTRE] + number[COUNTS_PER_RAD] * motor_y_rad);
    return (fmin(fmax(counts, 0.0), number[COUNTS_MAX]) - number[OFFSET]) / number[SCALE];
}

/* First order with Coulomb friction, by exact steps of 20 us; a reversal inside a step ends it at rest. */
static void advance_motor(double t_s)
{
    const double h = 1e-6 * STEP_US, keep = exp(-h / number[TAU_S]);
    const double u_V = drive / number[FULL] * number[FULL_V];
    for (; motor_s + h <= t_s; motor_s += h) {
        double v = motor_v_rad_s, next = 0.0;
        if (v != 0.0 || fabs(u_V) > number[FC_V]) {
            double sign = v > 0.0 || (v == 0.0 && u_V > 0.0) ? 1.0 : -1.0;
            double final = number[K_RAD_S_V] * (u_V - sign * number[FC_V]);
            next = final + (v - final) * keep;
            if (next * sign < 0.0)
                next = 0.0;
        }
        motor_y_rad += 0.5 * (v + next) * h;
        motor_v_rad_s = next;
    }
}

static void set_drive(double units, const char *cause)
{
    drive = units;
    if (executed)
        fprintf(executed, "%.6f,%.9g,%s\n", now_s(), units, cause);
}

static void end_drive(enum status why, const char *cause)
{
    status = why;
    set_drive(0.0, cause);
}

static void advance(double t_s)
{
    int is_set = map[R_WATCHDOG].address >= 0 && get(R_WATCHDOG) > 0;
    double silence_s = 1e-3 * (is_set ? get(R_WATCHDOG) : number[SILENCE_MS]);
    advance_motor(t_s);
    if (drive == 0.0)
        return;
    if (t_s - heard_s > silence_s)
        end_drive(S_SILENCE, "silence");
    else if (map[R_LOW].address >= 0 && map[R_HIGH].address >= 0 && get(R_LOW) < get(R_HIGH) &&
             ((drive < 0.0 && position() < get(R_LOW)) || (drive > 0.0 && position() > get(R_HIGH))))
        end_drive(S_TRAVEL, "travel");
}

static void drive_written(double t_s)
{
    double units = get(R_DRIVE), largest = number[FULL];
    if (map[R_MAX_DRIVE].address >= 0 && get(R_MAX_DRIVE) > 0)
        largest = fmin(largest, get(R_MAX_DRIVE));
    heard_s = t_s;
    if (!(fabs(units) <= largest))
        end_drive(S_DRIVE_RANGE, "too large");
    else if (status == S_ARMED || units == 0.0)
        set_drive(units, "written");
    else if (status == S_OFF)
        end_drive(S_NOT_ARMED, "not armed");
}

/* ---- requests */

static int range_fits(int first, int count)
{
    return count >= 1 && first + count <= REGISTERS;
}

static int covers(int first, int count, enum what what)
{
    return map[what].address >= first && map[what].address + words(map[what].type) <= first + count;
}

/* What a write asks for happens before libmodbus makes the reply, so that one FC23 reads what its own write did.
 * libmodbus then writes the same numbers again. What it will refuse is left alone. */
static void execute(const uint8_t *pdu, double t_s)
{
    int first, count, i;
    const uint8_t *data;
    switch (pdu[0]) {
    case MODBUS_FC_WRITE_SINGLE_REGISTER:
        first = MODBUS_GET_INT16_FROM_INT8(pdu, 1), count = 1, data = pdu + 3;
        break;
    case MODBUS_FC_WRITE_MULTIPLE_REGISTERS:
        first = MODBUS_GET_INT16_FROM_INT8(pdu, 1), count = MODBUS_GET_INT16_FROM_INT8(pdu, 3), data = pdu + 6;
        if (count > MODBUS_MAX_WRITE_REGISTERS || pdu[5] != 2 * count)
            return;
        break;
    case MODBUS_FC_WRITE_AND_READ_REGISTERS:
        first = MODBUS_GET_INT16_FROM_INT8(pdu, 5), count = MODBUS_GET_INT16_FROM_INT8(pdu, 7), data = pdu + 10;
        if (count > MODBUS_MAX_WR_WRITE_REGISTERS || pdu[9] != 2 * count ||
            MODBUS_GET_INT16_FROM_INT8(pdu, 3) > MODBUS_MAX_WR_READ_REGISTERS ||
            !range_fits(MODBUS_GET_INT16_FROM_INT8(pdu, 1), MODBUS_GET_INT16_FROM_INT8(pdu, 3)))
            return;
        break;
    default:
        return;
    }
    if (!range_fits(first, count))
        return;
    for (i = 0; i < count; i++)
        tables->tab_registers[first + i] = (uint16_t)MODBUS_GET_INT16_FROM_INT8(data, 2 * i);
    if (covers(first, count, R_CONTROL)) {
        if (get(R_CONTROL) == 1.0) {
            status = S_ARMED;
            heard_s = t_s;
        } else {
            end_drive(S_OFF, "stopped");
        }
    }
    if (covers(first, count, R_DRIVE))
        drive_written(t_s);
    if (covers(first, count, R_SEQUENCE) && map[R_ECHO].address >= 0)
        put(R_ECHO, get(R_SEQUENCE));
}

static void serve(const uint8_t *request, int length)
{
    double t_s = now_s();
    advance(t_s);
    execute(request + modbus_get_header_length(ctx), t_s);
    put(R_POSITION, position());
    put(R_APPLIED, drive);
    put(R_STATUS, status);
    if (modbus_reply(ctx, request, length, tables) < 0)
        fprintf(stderr, "slave: reply: %s\n", modbus_strerror(errno));
}

/* ---- starting */

static void take_option(const char *option)
{
    const char *value = strchr(option, '=');
    int i;
    if (!value)
        die("not KEY=VALUE", option);
    size_t length = (size_t)(value++ - option);
    for (i = 0; i < REGISTER_NAMES; i++) {
        if (strlen(REGISTER_NAME[i]) == length && !strncmp(option, REGISTER_NAME[i], length)) {
            char *type;
            int t = UINT16;
            map[i].address = (int)strtol(value, &type, 10);
            if (*type == ':')
                for (t = 0; t < TYPES && strcmp(type + 1, TYPE_NAME[t]); t++)
                    ;
            if (t == TYPES || type == value || map[i].address < 0 || map[i].address > REGISTERS - 2)
                die("not ADDRESS or ADDRESS:TYPE", option);
            map[i].type = (enum type)t;
            return;
        }
    }
    for (i = 0; i < NUMBERS; i++) {
        if (strlen(NUMBER_NAME[i]) == length && !strncmp(option, NUMBER_NAME[i], length)) {
            number[i] = strtod(value, NULL);
            return;
        }
    }
    if (!strcmp(option, "table=input"))
        read_is_input = 1;
    else if (!strcmp(option, "word_order=low-first") || !strcmp(option, "word_order=high-first"))
        low_word_first = value[0] == 'l';
    else if (!strncmp(option, "log=", 4)) {
        executed = fopen(value, "w");
        if (!executed)
            die("cannot write", value);
        setvbuf(executed, NULL, _IOLBF, 0);
        fprintf(executed, "t_s,drive,cause\n");
    } else
        die("no such option", option);
}

/* The master's end; the other is held open, so that clients may come and go. */
static int open_terminal(void)
{
    struct termios raw;
    int master = posix_openpt(O_RDWR | O_NOCTTY), slave;
    if (master < 0 || grantpt(master) || unlockpt(master))
        die("no pseudo-terminal", NULL);
    slave = open(ptsname(master), O_RDWR | O_NOCTTY);
    if (slave < 0 || tcgetattr(slave, &raw))
        die("no pseudo-terminal", NULL);
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    printf("port %s\n", ptsname(master));
    return master;
}

static int open_listener(void)
{
    struct sockaddr_in address;
    socklen_t length = sizeof address;
    int listener = modbus_tcp_listen(ctx, 1);
    if (listener < 0 || getsockname(listener, (struct sockaddr *)&address, &length))
        die("cannot listen", modbus_strerror(errno));
    printf("port %d\n", ntohs(address.sin_port));
    return listener;
}

int main(int argc, char **argv)
{
    int i, rtu, listener = -1, line = -1;
    for (i = 0; i < REGISTER_NAMES; i++)
        map[i].address = -1;
    if (argc < 2 || (strcmp(argv[1], "rtu") && strcmp(argv[1], "tcp")))
        die("usage: slave rtu|tcp [KEY=VALUE ...]", NULL);
    rtu = !strcmp(argv[1], "rtu");
    for (i = 2; i < argc; i++)
        take_option(argv[i]);
    if (map[R_DRIVE].address < 0 || map[R_POSITION].address < 0)
        die("drive=ADDRESS and position=ADDRESS are needed", NULL);
    tables = modbus_mapping_new(0, 0, REGISTERS, REGISTERS);
    ctx = rtu ? modbus_new_rtu("pty", 115200, 'N', 8, 1) : modbus_new_tcp("127.0.0.1", 0);
    if (!tables || !ctx || modbus_set_slave(ctx, (int)number[UNIT]))
        die("libmodbus", modbus_strerror(errno));
    modbus_set_byte_timeout(ctx, 0, 20000); /* a frame that stays half is dropped */
    if (rtu) {
        line = open_terminal();
        modbus_set_socket(ctx, line);
    } else
        listener = open_listener();
    fflush(stdout);

    motor_s = now_s();
    for (;;) {
        uint8_t request[MODBUS_TCP_MAX_ADU_LENGTH];
        struct timeval wait = {0, drive != 0.0 ? 1000 : 20000}; /* only a drive has to be watched */
        int waited = line >= 0 ? line : listener, length;
        fd_set ready;
        FD_ZERO(&ready);
        FD_SET(STDIN_FILENO, &ready);
        FD_SET(waited, &ready);
        if (select(waited + 1, &ready, NULL, NULL, &wait) <= 0) {
            advance(now_s());
            continue;
        }
        if (FD_ISSET(STDIN_FILENO, &ready))
            return 0;
        if (!FD_ISSET(waited, &ready))
            continue;
        if (line < 0) {
            line = modbus_tcp_accept(ctx, &listener);
            continue;
        }
        length = modbus_receive(ctx, request);
        if (length > 0) {
            serve(request, length);
        } else if (length < 0 && rtu) {
            modbus_flush(ctx); /* damaged, or a function whose length libmodbus does not know */
        } else if (length < 0) {
            close(line);
            line = -1;
        }
    }
}
