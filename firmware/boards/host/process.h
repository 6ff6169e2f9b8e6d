/* What an emulated device in real time takes of the operating system: command line, pseudo-terminal, trace file,
 * signals, waiting.
 *
 *     PROGRAM [--link PATH] [--trace FILE] [--exit-with-stdin] [--NAME VALUE ...]
 *
 * It prints `port /dev/pts/N` once it listens. A host may open and close the port as often as it likes; closing it does
 * not stop the drive, the device's watchdog does.
 */
#ifndef RIG_PROCESS_H
#define RIG_PROCESS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

/* After stdin ended: long enough to see the watchdog act. */
#define PROCESS_ORPHAN_S 0.3

typedef struct {
    const char *program; /* its name, for messages */
    const char *link_path, *trace_path;
    FILE *trace; /* NULL: none was asked for */
    char port[128];
    int pty;
    bool watches_stdin; /* --exit-with-stdin, and stdin has not ended yet */
    double orphan_end_s; /* at which a process whose stdin has ended exits; negative: it has not */
} process;

/* Sets a parameter of the device; returns NULL, or what is wrong. */
typedef const char *process_option(void *context, const char *name, const char *value);

/* The time that everything here is in: CLOCK_MONOTONIC, s. */
double process_now_s(void);

/* Exits with 2. */
void process_fail(const process *self, const char *what, const char *detail);

/* Reads the command line. `usage` prints the names of the device's parameters. False: it was --help, all is done. */
bool process_parse(process *self, int argc, char **argv, process_option *option, void *context, void (*usage)(void));

/* Opens trace (its first line: `columns`), pseudo-terminal and link. */
void process_open(process *self, const char *columns);

/* Says which port it is, and asks for priority: a chip is not kept waiting by the other programs of the host. */
void process_announce(const process *self);

/* Sleeps until a byte comes or until `until_s`. False when it is time to exit. */
bool process_wait(process *self, double until_s);

/* Whether somebody has pressed the reset button (SIGUSR1) since it was asked last. */
bool process_reset_asked(void);

/* Bytes from the host that wait; 0 for none. */
size_t process_read(const process *self, uint8_t *bytes, size_t n);

/* Where nobody reads, bytes are lost, as on a wire. */
void process_write(const process *self, const uint8_t *bytes, size_t n);

/* Removes the link, closes the trace. */
void process_close(process *self);

#endif
