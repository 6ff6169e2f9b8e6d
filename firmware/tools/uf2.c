/* Makes of a program for the RP2040, as it lies in flash, the file that its boot program takes as a drive: UF2.
 *
 *     uf2 PROGRAM.bin PROGRAM.uf2
 *
 * The checksum that the boot program compares is put into the last four of the first 256 bytes (data sheet, 2.8.1). A block of
 * the file is 512 bytes, of which 256 are the program's (https://github.com/microsoft/uf2, and 2.8.4).
 */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#define FLASH 0x10000000u
#define FLASH_MAX (2u * 1024u * 1024u)
#define BOOT2_BYTES 256u
#define PAYLOAD 256u
#define BLOCK 512u
#define RP2040 0xE48BFF56u
#define HAS_FAMILY 0x00002000u

static uint8_t program[FLASH_MAX];

static void put_u32(uint8_t *at, uint32_t value)
{
    for (unsigned i = 0; i < 4u; i++) {
        at[i] = (uint8_t)(value >> (8u * i));
    }
}

/* CRC-32/MPEG-2 */
static uint32_t checksum(const uint8_t *bytes, size_t n)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < n; i++) {
        crc ^= (uint32_t)bytes[i] << 24;
        for (unsigned bit = 0; bit < 8u; bit++) {
            crc = (crc & 0x80000000u) != 0u ? (crc << 1) ^ 0x04C11DB7u : crc << 1;
        }
    }
    return crc;
}

static int fail(const char *path, const char *why)
{
    fprintf(stderr, "uf2: %s: %s\n", path, why);
    return 1;
}

static void fill_block(uint8_t block[BLOCK], uint32_t number, uint32_t count)
{
    const uint32_t head[8] = {0x0A324655u, 0x9E5D5157u, HAS_FAMILY, FLASH + number * PAYLOAD, PAYLOAD, number, count, RP2040};
    memset(block, 0, BLOCK);
    for (unsigned i = 0; i < 8u; i++) {
        put_u32(block + 4u * i, head[i]);
    }
    memcpy(block + 32, program + number * PAYLOAD, PAYLOAD);
    put_u32(block + BLOCK - 4u, 0x0AB16F30u);
}

int main(int argc, char **argv)
{
    if (argc != 3) {
        fprintf(stderr, "usage: uf2 PROGRAM.bin PROGRAM.uf2\n");
        return 2;
    }
    FILE *in = fopen(argv[1], "rb");
    if (in == NULL) {
        return fail(argv[1], "cannot be read");
    }
    const size_t size = fread(program, 1, sizeof program, in);
    const int longer = fgetc(in) != EOF;
    fclose(in);
    if (size <= BOOT2_BYTES || longer) {
        return fail(argv[1], "is no program for a Pico: it must have more than 256 bytes and at most 2 MB");
    }
    put_u32(program + BOOT2_BYTES - 4u, checksum(program, BOOT2_BYTES - 4u));
    FILE *out = fopen(argv[2], "wb");
    if (out == NULL) {
        return fail(argv[2], "cannot be written");
    }
    const uint32_t count = (uint32_t)((size + PAYLOAD - 1u) / PAYLOAD);
    int well = 1;
    for (uint32_t number = 0; number < count; number++) {
        uint8_t block[BLOCK];
        fill_block(block, number, count);
        well = well && fwrite(block, 1, BLOCK, out) == BLOCK;
    }
    well = fclose(out) == 0 && well;
    return well ? 0 : fail(argv[2], "cannot be written");
}
