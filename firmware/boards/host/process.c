#include "process.h"

#include <errno.h>
#include <fcntl.h>
#include <sched.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/stat.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

static volatile sig_atomic_t stop_requested = 0, reset_requested = 0;
static sigset_t while_waiting; /* signals blocked while it waits: not those that end it */

static void on_signal(int number)
{
    if (number == SIGUSR1) {
        reset_requested = 1;
    } else {
        stop_requested = 1;
    }
}

double process_now_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

void process_fail(const process *self, const char *what, const char *detail)
{
    fprintf(stderr, "%s: %s: %s\n", self->program, what, detail);
    exit(2);
}

/* ---- command line ---- */

bool process_parse(process *self, int argc, char **argv, process_option *option, void *context, void (*usage)(void))
{
    self->link_path = NULL;
    self->trace_path = NULL;
    self->watches_stdin = false;
    self->orphan_end_s = -1.0;
    for (int i = 1; i < argc; i++) {
        const char *name = argv[i];
        if (strcmp(name, "--help") == 0) {
            printf("%s [--link PATH] [--trace FILE] [--exit-with-stdin] [--NAME VALUE ...]\nNAME is one of\n",
                   self->program);
            usage();
            return false;
        }
        if (strcmp(name, "--exit-with-stdin") == 0) {
            self->watches_stdin = true;
            continue;
        }
        if (strncmp(name, "--", 2) != 0 || i + 1 >= argc) {
            process_fail(self, name, "expected --NAME VALUE; see --help");
        }
        const char *value = argv[++i];
        if (strcmp(name, "--link") == 0) {
            self->link_path = value;
        } else if (strcmp(name, "--trace") == 0) {
            self->trace_path = value;
        } else {
            const char *wrong = option(context, name + 2, value);
            if (wrong != NULL) {
                process_fail(self, name, wrong);
            }
        }
    }
    return true;
}

/* ---- port ---- */

/* Opens a pseudo-terminal and holds its other end open, so that it lives on while no host has it open. */
static void open_pty(process *self)
{
    self->pty = posix_openpt(O_RDWR | O_NOCTTY);
    if (self->pty < 0 || grantpt(self->pty) != 0 || unlockpt(self->pty) != 0) {
        process_fail(self, "cannot open a pseudo-terminal", strerror(errno));
    }
    const char *slave_name = ptsname(self->pty);
    if (slave_name == NULL || strlen(slave_name) >= sizeof self->port) {
        process_fail(self, "cannot name the pseudo-terminal", strerror(errno));
    }
    strcpy(self->port, slave_name);
    const int slave = open(self->port, O_RDWR | O_NOCTTY);
    struct termios raw;
    if (slave < 0 || tcgetattr(slave, &raw) != 0) {
        process_fail(self, self->port, strerror(errno));
    }
    raw.c_iflag = 0;
    raw.c_oflag = 0;
    raw.c_lflag = 0;
    raw.c_cflag = CS8 | CREAD | CLOCAL;
    raw.c_cc[VMIN] = 1;
    raw.c_cc[VTIME] = 0;
    if (tcsetattr(slave, TCSANOW, &raw) != 0 || fcntl(self->pty, F_SETFL, O_NONBLOCK) != 0) {
        process_fail(self, self->port, strerror(errno));
    }
}

/* Makes or replaces the symbolic link in one step; refuses to replace anything else. */
static void make_link(const process *self)
{
    const char *path = self->link_path;
    struct stat there;
    char fresh[4096];
    if (lstat(path, &there) == 0 && !S_ISLNK(there.st_mode)) {
        process_fail(self, path, "exists and is not a symbolic link");
    }
    if (stat(path, &there) == 0) {
        process_fail(self, path, "is the link of a device that exists: end that one, or choose another name");
    }
    if (snprintf(fresh, sizeof fresh, "%s.%ld", path, (long)getpid()) >= (int)sizeof fresh) {
        process_fail(self, path, "too long");
    }
    if (symlink(self->port, fresh) != 0 || rename(fresh, path) != 0) {
        process_fail(self, path, strerror(errno));
    }
}

/* Removes the link if it is still ours. */
static void remove_link(const process *self)
{
    char target[256];
    const ssize_t n = readlink(self->link_path, target, sizeof target - 1);
    if (n >= 0) {
        target[n] = '\0';
        if (strcmp(target, self->port) == 0) {
            (void)unlink(self->link_path);
        }
    }
}

size_t process_read(const process *self, uint8_t *bytes, size_t n)
{
    const ssize_t taken = read(self->pty, bytes, n);
    return taken > 0 ? (size_t)taken : 0u;
}

void process_write(const process *self, const uint8_t *bytes, size_t n)
{
    if (n > 0u && write(self->pty, bytes, n) != (ssize_t)n && errno != EAGAIN) {
        process_fail(self, "cannot write to the pseudo-terminal", strerror(errno));
    } /* EAGAIN: nobody reads */
}

/* ---- start and end ---- */

/* Signals arrive only inside pselect, so none is missed between the check and the wait. */
static void take_signals(void)
{
    sigset_t blocked;
    sigemptyset(&blocked);
    sigaddset(&blocked, SIGINT);
    sigaddset(&blocked, SIGTERM);
    sigaddset(&blocked, SIGUSR1);
    sigprocmask(SIG_BLOCK, &blocked, &while_waiting);
    sigdelset(&while_waiting, SIGINT);
    sigdelset(&while_waiting, SIGTERM);
    sigdelset(&while_waiting, SIGUSR1);
    struct sigaction action;
    memset(&action, 0, sizeof action);
    action.sa_handler = on_signal;
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGUSR1, &action, NULL);
}

void process_open(process *self, const char *columns)
{
    take_signals();
    self->trace = NULL;
    if (self->trace_path != NULL) {
        self->trace = fopen(self->trace_path, "w");
        if (self->trace == NULL) {
            process_fail(self, self->trace_path, strerror(errno));
        }
        fprintf(self->trace, "%s\n", columns);
    }
    open_pty(self);
    if (self->link_path != NULL) {
        make_link(self);
    }
}

void process_announce(const process *self)
{
    struct sched_param priority;
    printf("port %s\n", self->port);
    fflush(stdout);
    memset(&priority, 0, sizeof priority);
    priority.sched_priority = 50;
    if (sched_setscheduler(0, SCHED_FIFO, &priority) != 0) {
        fprintf(stderr, "%s: no real-time priority (%s): replies may be late on a busy machine\n", self->program,
                strerror(errno));
    }
}

void process_close(process *self)
{
    if (self->link_path != NULL) {
        remove_link(self);
    }
    if (self->trace != NULL && fclose(self->trace) != 0) {
        process_fail(self, self->trace_path, strerror(errno));
    }
}

/* ---- waiting ---- */

bool process_reset_asked(void)
{
    const bool is_asked = reset_requested != 0;
    reset_requested = 0;
    return is_asked;
}

bool process_wait(process *self, double until_s)
{
    fd_set readable;
    FD_ZERO(&readable);
    FD_SET(self->pty, &readable);
    if (self->watches_stdin) {
        FD_SET(STDIN_FILENO, &readable);
    }
    double left_s = until_s - process_now_s();
    left_s = left_s > 0.0 ? left_s : 0.0;
    struct timespec timeout;
    timeout.tv_sec = (time_t)left_s;
    timeout.tv_nsec = (long)(1e9 * (left_s - (double)timeout.tv_sec));
    if (pselect(self->pty + 1, &readable, NULL, NULL, &timeout, &while_waiting) > 0 && self->watches_stdin &&
        FD_ISSET(STDIN_FILENO, &readable)) {
        char ignored[64];
        if (read(STDIN_FILENO, ignored, sizeof ignored) <= 0) {
            self->watches_stdin = false;
            self->orphan_end_s = process_now_s() + PROCESS_ORPHAN_S;
        }
    }
    return !stop_requested && (self->orphan_end_s < 0.0 || process_now_s() < self->orphan_end_s);
}
