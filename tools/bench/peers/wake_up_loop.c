/* The C loop that the benchmark compares with: sleep to an absolute time, spin the rest, note how late that was.

   usage: wake_up_loop PRIORITY SPIN_US     PRIORITY 0: ordinary scheduling, else that of SCHED_FIFO

   Commands on standard input, one a line: "TICKS PERIOD_US". The answer is one line: the ticks that were skipped, then
   the lateness of each tick that ran, ns. */
#define _GNU_SOURCE
#include <errno.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>

#define LONGEST 1000000

static int64_t late_ns[LONGEST];

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static void sleep_until(int64_t t_ns)
{
    const struct timespec t = {t_ns / 1000000000, t_ns % 1000000000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR) {
    }
}

static void fail(const char *what)
{
    fprintf(stderr, "wake_up_loop: %s: %s\n", what, strerror(errno));
    exit(1);
}

int main(int argc, char **argv)
{
    long ticks, period_us;
    if (argc != 3)
        return 2;
    const struct sched_param priority = {.sched_priority = atoi(argv[1])};
    const int64_t spin_ns = atol(argv[2]) * 1000;
    if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0)
        fprintf(stderr, "wake_up_loop: memory not locked: %s\n", strerror(errno));
    if (prctl(PR_SET_TIMERSLACK, 1L) != 0)
        fail("timer slack");
    if (priority.sched_priority > 0 && sched_setscheduler(0, SCHED_FIFO, &priority) != 0)
        fail("SCHED_FIFO");
    while (scanf("%ld %ld", &ticks, &period_us) == 2) {
        long skipped = 0, ran = 0;
        const int64_t period_ns = period_us * 1000, t0_ns = now_ns() + period_ns;
        int64_t now;
        if (ticks < 1 || ticks > LONGEST)
            return 2;
        for (long tick = 0; tick < ticks; tick++) {
            const int64_t due_ns = t0_ns + tick * period_ns;
            sleep_until(due_ns - spin_ns);
            while ((now = now_ns()) < due_ns) {
            }
            late_ns[ran++] = now - due_ns;
            const long missed = (long)((now_ns() - due_ns) / period_ns);
            skipped += missed;
            tick += missed;
        }
        printf("%ld", skipped);
        for (long k = 0; k < ran; k++)
            printf(" %lld", (long long)late_ns[k]);
        printf("\n");
        fflush(stdout);
    }
    return 0;
}
