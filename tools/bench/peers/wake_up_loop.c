/* The C loop that the benchmark compares with: sleep to an absolute time, spin the rest, note how late that was.

   usage: wake_up_loop PRIORITY SPIN_US     PRIORITY 0: ordinary scheduling, else that of SCHED_FIFO

   Commands on standard input, one a line: "TICKS PERIOD_US". The answer is one line: the ticks that were skipped, then 5,
   then for each tick that ran: how late it was, ns; when it was due, ns of CLOCK_MONOTONIC; when its work was over
   after that, ns; since the tick before, how long the loop was ready to run without running, ns, and its page faults.

   Ticks are due half a millisecond after whole ones, where the kernel has its own tick. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

#define LONGEST 1000000

struct tick {
    int64_t late_ns, due_ns, over_ns, queued_ns, faults;
};

static struct tick ticks_run[LONGEST];

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

/* until now: the second figure of schedstat, and page faults */
static void evidence(int file, int64_t *queued_ns, int64_t *faults)
{
    char text[80];
    long long ran, queued;
    struct rusage usage;
    const ssize_t size = pread(file, text, sizeof text - 1, 0);
    if (size <= 0)
        fail("schedstat");
    text[size] = 0;
    if (sscanf(text, "%lld %lld", &ran, &queued) != 2 || getrusage(RUSAGE_THREAD, &usage) != 0)
        fail("schedstat");
    *queued_ns = queued;
    *faults = usage.ru_minflt + usage.ru_majflt;
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
    const int file = open("/proc/thread-self/schedstat", O_RDONLY);
    if (file < 0)
        fail("schedstat");
    while (scanf("%ld %ld", &ticks, &period_us) == 2) {
        long skipped = 0, ran = 0;
        const int64_t period_ns = period_us * 1000, t0_ns = (now_ns() + period_ns) / 1000000 * 1000000 + 1500000;
        int64_t now, queued_ns, faults, queued_before_ns, faults_before;
        if (ticks < 1 || ticks > LONGEST)
            return 2;
        evidence(file, &queued_before_ns, &faults_before);
        for (long tick = 0; tick < ticks; tick++) {
            const int64_t due_ns = t0_ns + tick * period_ns;
            sleep_until(due_ns - spin_ns);
            while ((now = now_ns()) < due_ns) {
            }
            evidence(file, &queued_ns, &faults);
            const int64_t over_ns = now_ns() - due_ns;
            ticks_run[ran++] = (struct tick){now - due_ns, due_ns, over_ns, queued_ns - queued_before_ns,
                                             faults - faults_before};
            queued_before_ns = queued_ns;
            faults_before = faults;
            const long missed = (long)(over_ns / period_ns);
            skipped += missed;
            tick += missed;
        }
        printf("%ld 5", skipped);
        for (long k = 0; k < ran; k++) {
            const struct tick *t = &ticks_run[k];
            printf(" %lld %lld %lld %lld %lld", (long long)t->late_ns, (long long)t->due_ns, (long long)t->over_ns,
                   (long long)t->queued_ns, (long long)t->faults);
        }
        printf("\n");
        fflush(stdout);
    }
    return 0;
}
