/* The first 256 bytes of flash. The chip's own boot program copies them to memory, compares their checksum, which uf2.c puts
 * into the last four, and runs them (data sheet, 2.8.1). They make the flash readable as memory and start the program.
 *
 * By the slowest command, 03h, which every flash chip knows: the program runs from memory and reads the flash just once.
 */
    .syntax unified
    .cpu cortex-m0plus
    .thumb

    .equ SSI, 0x18000000            @ 4.10.13
    .equ SSI_CTRLR0, 0x00
    .equ SSI_CTRLR1, 0x04
    .equ SSI_SSIENR, 0x08
    .equ SSI_BAUDR, 0x14
    .equ READ_32_BITS, 0x001F0300   @ CTRLR0: one wire, send a command, then receive 32 bits
    .equ BY_COMMAND_03, 0x03000218  @ SPI_CTRLR0: command 03h of 8 bits, 24 bits of address
    .equ SSI_SPI_CTRLR0, 0xF4
    .equ PROGRAM, 0x10000100        @ its table of vectors
    .equ VTOR, 0xE000ED08

    .section .boot2, "ax"
    .global boot2
    .type boot2, %function
    .thumb_func
boot2:
    ldr r0, =SSI
    movs r1, #0
    str r1, [r0, #SSI_SSIENR]       @ off: only then can it be set up
    movs r2, #4
    str r2, [r0, #SSI_BAUDR]        @ an even part of the system clock: 31 MHz at 125 MHz
    ldr r2, =READ_32_BITS
    str r2, [r0, #SSI_CTRLR0]
    str r1, [r0, #SSI_CTRLR1]       @ one word at a time
    ldr r2, =BY_COMMAND_03
    ldr r3, =(SSI + SSI_SPI_CTRLR0)
    str r2, [r3]
    movs r1, #1
    str r1, [r0, #SSI_SSIENR]
    ldr r0, =PROGRAM
    ldr r1, =VTOR
    str r0, [r1]
    ldr r1, [r0]
    msr msp, r1
    ldr r1, [r0, #4]
    bx r1
    .ltorg
