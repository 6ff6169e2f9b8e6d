/* Runs a program on the Uno's emulated chip until it sleeps: the bytes that it writes to GPIOR0 go to a file, and to the
 * error output how many cycles GPIOR1 was 1, at most and in all, and how often. For tests only: libsimavr is GPL 3. */
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <simavr/sim_io.h>

#include <stdio.h>

enum { GPIOR0 = 0x3E, GPIOR1 = 0x4A };

static avr_cycle_count_t from, most, all;
static unsigned long times;
static FILE *out;

static void give(avr_t *avr, avr_io_addr_t address, uint8_t byte, void *context)
{
    (void)avr, (void)address, (void)context;
    (void)fputc(byte, out);
}

static void compute(avr_t *avr, avr_io_addr_t address, uint8_t is, void *context)
{
    (void)address, (void)context;
    if (is) {
        from = avr->cycle;
        return;
    }
    const avr_cycle_count_t took = avr->cycle - from;
    most = took > most ? took : most;
    all += took;
    times++;
}

int main(int argc, char **argv)
{
    elf_firmware_t program = {0};
    if (argc != 3 || elf_read_firmware(argv[1], &program) != 0) {
        (void)fputs("usage: uno PROGRAM.elf BYTES\n", stderr);
        return 2;
    }
    avr_t *avr = avr_make_mcu_by_name("atmega328p");
    if (avr == NULL || avr_init(avr) != 0) {
        return 2;
    }
    avr->frequency = 16000000;
    avr->log = LOG_NONE;
    avr_load_firmware(avr, &program);
    avr_register_io_write(avr, GPIOR0, give, NULL);
    avr_register_io_write(avr, GPIOR1, compute, NULL);
    out = fopen(argv[2], "wb"); /* libsimavr writes to the output, too */
    if (out == NULL) {
        return 2;
    }
    int state = cpu_Running;
    while (state != cpu_Done && state != cpu_Crashed) {
        state = avr_run(avr);
    }
    (void)fclose(out);
    (void)fprintf(stderr, "%llu %llu %lu\n", (unsigned long long)most, (unsigned long long)all, times);
    return state == cpu_Done ? 0 : 1;
}
