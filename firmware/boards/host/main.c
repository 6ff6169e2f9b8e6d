/* The emulated board in real time: a process behind a pseudo-terminal.
 *
 *     rig_host_board [--link PATH] [--trace FILE] [--exit-with-stdin] [--NAME VALUE ...]
 *
 * NAME is a parameter of the bench (bench.h; --help lists them). Prints `port /dev/pts/N` once it listens. A host
 * may open and close the port as often as it likes; closing it does not stop the drive, the watchdog does.
 */
#include <errno.h>
#include <fcntl.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/stat.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "device.h"

#define TRACE_EVERY_TICKS 10u
#define ORPHAN_S 0.3 /* after stdin ended: long enough to see the watchdog act */

typedef struct {
    device device;
    int pty;
    FILE *trace;
    double start_s; /* CLOCK_MONOTONIC at the bench's time 0 */
    bool drive_changed;
} process;

static volatile sig_atomic_t stop_requested = 0;

static void on_signal(int number)
{
    (void)number;
    stop_requested = 1;
}

static double monotonic_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void fail(const char *what, const char *detail)
{
    fprintf(stderr, "rig_host_board: %s: %s\n", what, detail);
    exit(2);
}

/* ---- port ---- */

/* Opens a pseudo-terminal and holds its other end open, so that it lives on while no host has it open. */
static int open_pty(char *name, size_t size)
{
    const int master = posix_openpt(O_RDWR | O_NOCTTY);
    if (master < 0 || grantpt(master) != 0 || unlockpt(master) != 0) {
        fail("cannot open a pseudo-terminal", strerror(errno));
    }
    const char *slave_name = ptsname(master);
    if (slave_name == NULL || strlen(slave_name) >= size) {
        fail("cannot name the pseudo-terminal", strerror(errno));
    }
    strcpy(name, slave_name);
    const int slave = open(name, O_RDWR | O_NOCTTY);
    struct termios raw;
    if (slave < 0 || tcgetattr(slave, &raw) != 0) {
        fail(name, strerror(errno));
    }
    raw.c_iflag = 0;
    raw.c_oflag = 0;
    raw.c_lflag = 0;
    raw.c_cflag = CS8 | CREAD | CLOCAL;
    raw.c_cc[VMIN] = 1;
    raw.c_cc[VTIME] = 0;
    if (tcsetattr(slave, TCSANOW, &raw) != 0 || fcntl(master, F_SETFL, O_NONBLOCK) != 0) {
        fail(name, strerror(errno));
    }
    return master;
}

/* Makes or replaces the symbolic link in one step; refuses to replace anything else. */
static void make_link(const char *port, const char *path)
{
    struct stat there;
    char fresh[4096];
    if (lstat(path, &there) == 0 && !S_ISLNK(there.st_mode)) {
        fail(path, "exists and is not a symbolic link");
    }
    if (stat(path, &there) == 0) {
        fail(path, "is the link of a device that exists: end that one, or choose another name");
    }
    if (snprintf(fresh, sizeof fresh, "%s.%ld", path, (long)getpid()) >= (int)sizeof fresh) {
        fail(path, "too long");
    }
    if (symlink(port, fresh) != 0 || rename(fresh, path) != 0) {
        fail(path, strerror(errno));
    }
}

/* Removes the link if it is still ours. */
static void remove_link(const char *port, const char *path)
{
    char target[256];
    const ssize_t n = readlink(path, target, sizeof target - 1);
    if (n >= 0) {
        target[n] = '\0';
        if (strcmp(target, port) == 0) {
            (void)unlink(path);
        }
    }
}

static void transmit(void *context, const uint8_t *bytes, uint8_t n)
{
    const process *self = context;
    if (write(self->pty, bytes, n) != n && errno != EAGAIN) {
        fail("cannot write to the pseudo-terminal", strerror(errno));
    } /* EAGAIN: nobody reads; like a wire, it does not keep the bytes */
}

/* ---- trace ---- */

static void drive_changed(void *context)
{
    ((process *)context)->drive_changed = true;
}

static void trace_row(process *self)
{
    const bench *b = &self->device.bench;
    self->drive_changed = false;
    if (self->trace != NULL) {
        fprintf(self->trace, "%.6f,%.6f,%.6f,%.6f,%u\n", self->start_s + b->t_s, bench_pin_V(b), b->y_rad,
                b->v_rad_per_s, (unsigned)self->device.core.fault);
        fflush(self->trace);
    }
}

/* ---- time ---- */

static void advance_to_now(process *self)
{
    bench_advance_to(&self->device.bench, monotonic_s() - self->start_s);
}

static void serve_bytes(process *self)
{
    uint8_t bytes[256];
    const ssize_t n = read(self->pty, bytes, sizeof bytes);
    for (ssize_t i = 0; i < n; i++) {
        advance_to_now(self);
        device_byte(&self->device, bytes[i]);
        if (self->drive_changed) {
            trace_row(self);
        }
    }
}

static void serve_tick(process *self)
{
    device *d = &self->device;
    const uint32_t decade = d->ticks / TRACE_EVERY_TICKS;
    advance_to_now(self);
    if (d->bench.t_s < device_next_tick_s(d)) {
        return;
    }
    device_tick(d);
    if (self->drive_changed || d->ticks / TRACE_EVERY_TICKS != decade) {
        trace_row(self);
    }
}

/* Whether stdin still has a parent at its other end. Sleeps until a byte or the next tick is due. */
static bool wait_for_event(const process *self, bool watch_stdin, const sigset_t *signals)
{
    fd_set readable;
    FD_ZERO(&readable);
    FD_SET(self->pty, &readable);
    if (watch_stdin) {
        FD_SET(STDIN_FILENO, &readable);
    }
    double left_s = self->start_s + device_next_tick_s(&self->device) - monotonic_s();
    left_s = left_s > 0.0 ? left_s : 0.0;
    struct timespec timeout;
    timeout.tv_sec = (time_t)left_s;
    timeout.tv_nsec = (long)(1e9 * (left_s - (double)timeout.tv_sec));
    if (pselect(self->pty + 1, &readable, NULL, NULL, &timeout, signals) <= 0) {
        return true; /* a tick is due, or a signal came */
    }
    if (watch_stdin && FD_ISSET(STDIN_FILENO, &readable)) {
        char ignored[64];
        return read(STDIN_FILENO, ignored, sizeof ignored) > 0;
    }
    return true;
}

static void run(process *self, bool exit_with_stdin, const sigset_t *signals)
{
    double end_s = -1.0; /* bench time at which an orphan exits; negative: not orphaned */
    while (!stop_requested && (end_s < 0.0 || self->device.bench.t_s < end_s)) {
        if (!wait_for_event(self, exit_with_stdin && end_s < 0.0, signals)) {
            end_s = self->device.bench.t_s + ORPHAN_S;
        }
        serve_bytes(self); /* first: what waited through a stall of this process was not late on the wire */
        serve_tick(self);
    }
}

/* ---- start ---- */

static void usage(void)
{
    puts("rig_host_board [--link PATH] [--trace FILE] [--exit-with-stdin] [--NAME VALUE ...]\nNAME is one of");
    for (unsigned i = 0; bench_option_name(i) != NULL; i++) {
        printf("    %s\n", bench_option_name(i));
    }
}

/* A chip is not kept waiting by the other programs of the host; where the system allows it, neither is this one. */
static void ask_for_priority(void)
{
    struct sched_param priority;
    memset(&priority, 0, sizeof priority);
    priority.sched_priority = 50;
    if (sched_setscheduler(0, SCHED_FIFO, &priority) != 0) {
        fprintf(stderr, "rig_host_board: no real-time priority (%s): replies may be late on a busy machine\n",
                strerror(errno));
    }
}

int main(int argc, char **argv)
{
    static process self;
    bench_params params;
    const char *link_path = NULL;
    const char *trace_path = NULL;
    bool exit_with_stdin = false;
    bench_defaults(&params);
    for (int i = 1; i < argc; i++) {
        const char *name = argv[i];
        if (strcmp(name, "--help") == 0) {
            usage();
            return 0;
        }
        if (strcmp(name, "--exit-with-stdin") == 0) {
            exit_with_stdin = true;
            continue;
        }
        if (strncmp(name, "--", 2) != 0 || i + 1 >= argc) {
            fail(name, "expected --NAME VALUE; see --help");
        }
        const char *value = argv[++i];
        if (strcmp(name, "--link") == 0) {
            link_path = value;
        } else if (strcmp(name, "--trace") == 0) {
            trace_path = value;
        } else {
            const char *wrong = bench_option(&params, name + 2, value);
            if (wrong != NULL) {
                fail(name, wrong);
            }
        }
    }
    const char *wrong = bench_check(&params);
    if (wrong != NULL) {
        fail("parameters", wrong);
    }

    /* Signals arrive only inside pselect, so none is missed between the check and the wait. */
    sigset_t blocked, outside;
    sigemptyset(&blocked);
    sigaddset(&blocked, SIGINT);
    sigaddset(&blocked, SIGTERM);
    sigprocmask(SIG_BLOCK, &blocked, &outside);
    sigdelset(&outside, SIGINT);
    sigdelset(&outside, SIGTERM);
    struct sigaction action;
    memset(&action, 0, sizeof action);
    action.sa_handler = on_signal;
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);

    if (trace_path != NULL) {
        self.trace = fopen(trace_path, "w");
        if (self.trace == NULL) {
            fail(trace_path, strerror(errno));
        }
        fputs("t_s,drive_V,y_rad,v_rad_per_s,fault\n", self.trace);
    }
    char port[128];
    self.pty = open_pty(port, sizeof port);
    if (link_path != NULL) {
        make_link(port, link_path);
    }
    self.start_s = monotonic_s();
    device_init(&self.device, &params, transmit, drive_changed, &self);
    printf("port %s\n", port);
    fflush(stdout);

    ask_for_priority();
    run(&self, exit_with_stdin, &outside);

    advance_to_now(&self);
    device_reset(&self.device, RIG_RESET_POWER_ON); /* the power is cut: 0 V at the pin */
    trace_row(&self);
    if (link_path != NULL) {
        remove_link(port, link_path);
    }
    if (self.trace != NULL && fclose(self.trace) != 0) {
        fail(trace_path, strerror(errno));
    }
    return 0;
}
