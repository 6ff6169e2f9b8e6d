/* The least of a test harness: CHECK counts and names what fails; report() is the program's result. */
#ifndef RIG_CHECK_H
#define RIG_CHECK_H

#include <stdio.h>

static unsigned checks_done = 0;
static unsigned checks_failed = 0;

#define CHECK(condition)                                                          \
    do {                                                                          \
        checks_done++;                                                            \
        if (!(condition)) {                                                       \
            checks_failed++;                                                      \
            printf("%s:%d: failed: %s\n", __FILE__, __LINE__, #condition);        \
        }                                                                         \
    } while (0)

static int report(const char *name)
{
    printf("%s: %u checks, %u failed\n", name, checks_done, checks_failed);
    return checks_failed == 0u ? 0 : 1;
}

#endif
