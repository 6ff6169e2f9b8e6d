/* The processor's own instructions: interrupts masked and let in, sleep. */
#ifndef RIG_PICO_CPU_H
#define RIG_PICO_CPU_H

#include <stdint.h>

static inline void cpu_mask_interrupts(void)
{
    __asm volatile("cpsid i" ::: "memory");
}

static inline void cpu_let_interrupts_in(void)
{
    __asm volatile("cpsie i" ::: "memory");
}

/* Masks them; cpu_restore_interrupts is given what this returned. */
static inline uint32_t cpu_hold_interrupts(void)
{
    uint32_t before;
    __asm volatile("mrs %0, primask\n\tcpsid i" : "=r"(before)::"memory");
    return before;
}

static inline void cpu_restore_interrupts(uint32_t before)
{
    __asm volatile("msr primask, %0" ::"r"(before) : "memory");
}

/* What was written before is in force after it: a masked interrupt comes no more. */
static inline void cpu_barrier(void)
{
    __asm volatile("dsb\n\tisb" ::: "memory");
}

/* Until an interrupt waits, masked or not: a masked one that has come already ends it at once. */
static inline void cpu_sleep(void)
{
    __asm volatile("wfi" ::: "memory");
}

#endif
