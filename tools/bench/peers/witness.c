/* A witness of the machine: on each core a thread that goes before every loop, wakes once a millisecond and notes when
   that was late, and whether it stood in the queue of a core that ran or the core's timer itself came late.

   usage: witness PRIORITY PHASE_US     of SCHED_FIFO, above the loops'; instants: whole ms of CLOCK_MONOTONIC + PHASE_US

   Put just after the instants at which a loop's ticks are due, what makes a tick late for longer makes the witness late,
   and the witness never interrupts a loop's spin. Answers each line of standard input by one line:
   CORE DUE_ns LATE_ns QUEUED_ns for each late instant since the last answer. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#define CORES 64
#define KEPT 16384 /* late instants between two questions; more end the program */
#define PERIOD_NS 1000000
#define LATE_NS 60000

struct late {
    int64_t due_ns, late_ns, queued_ns;
};

static struct late kept[CORES][KEPT];
static atomic_uint noted[CORES];
static int64_t phase_ns;

static void fail(const char *what)
{
    fprintf(stderr, "witness: %s: %s\n", what, strerror(errno));
    exit(1);
}

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

/* how long this thread has been ready to run without running, ns: the second figure of its schedstat */
static int64_t queued_ns(int file)
{
    char text[80];
    long long ran, queued;
    const ssize_t size = pread(file, text, sizeof text - 1, 0);
    if (size <= 0)
        fail("schedstat");
    text[size] = 0;
    if (sscanf(text, "%lld %lld", &ran, &queued) != 2)
        fail("schedstat");
    return queued;
}

static void *watch(void *argument)
{
    const int core = (int)(intptr_t)argument;
    const int file = open("/proc/thread-self/schedstat", O_RDONLY);
    if (file < 0)
        fail("schedstat");
    if (prctl(PR_SET_TIMERSLACK, 1L) != 0)
        fail("timer slack");
    int64_t due_ns = (now_ns() / PERIOD_NS + 2) * PERIOD_NS + phase_ns, before_ns = queued_ns(file);
    for (;;) {
        const struct timespec t = {due_ns / 1000000000, due_ns % 1000000000};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR) {
        }
        const int64_t late_ns = now_ns() - due_ns, after_ns = queued_ns(file);
        if (late_ns > LATE_NS) {
            const unsigned k = atomic_load(&noted[core]);
            if (k == KEPT) {
                fprintf(stderr, "witness: more than %d late instants since the last question\n", KEPT);
                exit(1);
            }
            kept[core][k] = (struct late){due_ns, late_ns, after_ns - before_ns};
            atomic_store(&noted[core], k + 1);
        }
        before_ns = after_ns;
        due_ns += PERIOD_NS * (1 + late_ns / PERIOD_NS);
    }
    return NULL;
}

int main(int argc, char **argv)
{
    if (argc != 3)
        return 2;
    const struct sched_param priority = {.sched_priority = atoi(argv[1])};
    phase_ns = atol(argv[2]) * 1000;
    cpu_set_t cores;
    if (sched_getaffinity(0, sizeof cores, &cores) != 0)
        fail("cores");
    if (mlockall(MCL_CURRENT) != 0)
        fprintf(stderr, "witness: memory not locked: %s\n", strerror(errno));
    for (int core = 0; core < CORES; core++) {
        if (!CPU_ISSET(core, &cores))
            continue;
        pthread_attr_t how;
        pthread_t thread;
        cpu_set_t one;
        CPU_ZERO(&one);
        CPU_SET(core, &one);
        pthread_attr_init(&how);
        pthread_attr_setinheritsched(&how, PTHREAD_EXPLICIT_SCHED);
        pthread_attr_setschedpolicy(&how, SCHED_FIFO);
        pthread_attr_setschedparam(&how, &priority);
        pthread_attr_setaffinity_np(&how, sizeof one, &one);
        errno = pthread_create(&thread, &how, watch, (void *)(intptr_t)core);
        if (errno != 0)
            fail("SCHED_FIFO");
    }
    unsigned told[CORES] = {0};
    for (int c; (c = getchar()) != EOF;) {
        if (c != '\n')
            continue;
        for (int core = 0; core < CORES; core++) {
            const unsigned until = atomic_load(&noted[core]);
            for (; told[core] < until; told[core]++) {
                const struct late *one = &kept[core][told[core]];
                printf("%d %lld %lld %lld ", core, (long long)one->due_ns, (long long)one->late_ns,
                       (long long)one->queued_ns);
            }
        }
        printf("\n");
        fflush(stdout);
    }
    return 0;
}
