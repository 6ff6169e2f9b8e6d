/* The registers of the RP2040 that the firmware uses, by the names of its data sheet, whose sections stand beside them.
 * tests/hil/test_hil_pico_registers.py compares them with the table in docs/pico-registers.md.
 */
#ifndef RIG_PICO_RP2040_H
#define RIG_PICO_RP2040_H

#include <stdint.h>

#define BIT(n) ((uint32_t)1u << (n))
#define REG(address) (*(volatile uint32_t *)(address))
/* Writes to these change the bits given and no others, in one step that no interrupt can split: section 2.1.2. */
#define SET_BITS(address, bits) (REG((address) + 0x2000u) = (bits))
#define CLEAR_BITS(address, bits) (REG((address) + 0x3000u) = (bits))

/* 2.12 chip-level reset */
#define CHIP_RESET 0x40064008u
#define HAD_POR BIT(8)
#define HAD_RUN BIT(16)

/* 2.13 power-on state machine */
#define PSM_WDSEL 0x40010008u
#define PSM_ALL_BUT_OSCILLATORS 0x0001FFFCu

/* 2.14 subsystem resets */
#define RESETS_RESET 0x4000C000u
#define RESETS_DONE 0x4000C008u
#define RESETS_ADC BIT(0)
#define RESETS_IO_BANK0 BIT(5)
#define RESETS_PADS_BANK0 BIT(8)
#define RESETS_PIO0 BIT(10)
#define RESETS_PIO1 BIT(11)
#define RESETS_PLL_SYS BIT(12)
#define RESETS_PLL_USB BIT(13)
#define RESETS_PWM BIT(14)
#define RESETS_TIMER BIT(21)
#define RESETS_UART0 BIT(22)

/* 2.15 clocks */
#define CLK_REF_CTRL 0x40008030u
#define CLK_REF_SELECTED 0x40008038u
#define CLK_REF_XOSC 2u
#define CLK_SYS_CTRL 0x4000803Cu
#define CLK_SYS_SELECTED 0x40008044u
#define CLK_SYS_AUX 1u /* its source 0: the system PLL */
#define CLK_PERI_CTRL 0x40008048u
#define CLK_ADC_CTRL 0x40008060u
#define CLK_ENABLE BIT(11) /* from source 0: of CLK_PERI the system clock, of CLK_ADC the USB PLL */

/* 2.16 crystal oscillator */
#define XOSC_CTRL 0x40024000u
#define XOSC_STATUS 0x40024004u
#define XOSC_STARTUP 0x4002400Cu
#define XOSC_ENABLE_1_15_MHZ 0x00FABAA0u
#define XOSC_STABLE BIT(31)

/* 2.18 PLLs */
#define PLL_SYS 0x40028000u
#define PLL_USB 0x4002C000u
#define PLL_CS 0x0u
#define PLL_PWR 0x4u
#define PLL_FBDIV_INT 0x8u
#define PLL_PRIM 0xCu
#define PLL_LOCK BIT(31)
#define PLL_PD BIT(0)
#define PLL_POSTDIVPD BIT(3)
#define PLL_VCOPD BIT(5)

/* 2.19 pins: their functions and interrupts */
#define GPIO_CTRL(pin) (0x40014004u + 8u * (pin))
#define FUNCTION_UART 2u
#define FUNCTION_PWM 4u
#define FUNCTION_SIO 5u
#define OUTPUT_INVERTED BIT(8)
#define BOTH_EDGES(pin) ((uint32_t)0xCu << (4u * (pin)))
#define IO_INTR1 0x400140F4u        /* pins 8 to 15, four bits each */
#define IO_PROC0_INTE1 0x40014104u
#define IO_PROC0_INTS1 0x40014124u
#define IO_INTR2 0x400140F8u        /* pins 16 to 23 */
#define IO_PROC0_INTE2 0x40014108u
#define IO_PROC0_INTS2 0x40014128u
#define EDGE_HIGH(pin) BIT(4u * ((pin) - 8u) + 3u)

/* 2.19 pads */
#define PADS_GPIO(pin) (0x4001C004u + 4u * (pin))
#define PAD_SCHMITT BIT(1)
#define PAD_PULL_DOWN BIT(2)
#define PAD_PULL_UP BIT(3)
#define PAD_4_MA BIT(4)
#define PAD_INPUT BIT(6)
#define PAD_OUTPUT_DISABLED BIT(7)

/* 2.3.1 single-cycle I/O */
#define SIO_GPIO_IN 0xD0000004u
#define SIO_GPIO_OUT_SET 0xD0000014u
#define SIO_GPIO_OUT_CLR 0xD0000018u
#define SIO_GPIO_OE_SET 0xD0000024u
#define SIO_GPIO_OE_CLR 0xD0000028u

/* 2.4.8 interrupt controller, and the table of vectors; 2.3.2 numbers of interrupts */
#define NVIC_ISER 0xE000E100u
#define NVIC_ICER 0xE000E180u
#define NVIC_IPR0 0xE000E400u
#define NVIC_IPR3 0xE000E40Cu
#define VTOR 0xE000ED08u
#define IRQ_TIMER_0 0u
#define IRQ_IO_BANK0 13u
#define IRQ_UART0 20u
#define IRQS 26u
#define PRIORITY_LOWEST 0xC0u
#define SECOND_OF_IO_BANK0 0x4000u /* of four, in NVIC_IPR3 */

/* 3.7 PIO: two blocks, of four state machines each */
#define PIO0 0x50200000u
#define PIO1 0x50300000u
#define PIO_CTRL 0x000u
#define PIO_FSTAT 0x004u
#define PIO_RXEMPTY(machine) BIT(8u + (machine))
#define PIO_FLEVEL 0x00Cu
#define PIO_RX_LEVEL(machine) (4u + 8u * (machine))
#define PIO_RXF(machine) (0x020u + 4u * (machine))
#define PIO_IRQ_FLAGS 0x030u
#define PIO_INSTR_MEM(at) (0x048u + 4u * (at))
#define PIO_SM_CLKDIV(machine) (0x0C8u + 0x18u * (machine))
#define PIO_SM_EXECCTRL(machine) (0x0CCu + 0x18u * (machine))
#define PIO_SM_SHIFTCTRL(machine) (0x0D0u + 0x18u * (machine))
#define PIO_SM_PINCTRL(machine) (0x0DCu + 0x18u * (machine))
#define PIO_FULL_SPEED BIT(16) /* divider 1 */
#define PIO_JMP_PIN_IS(pin) ((pin) << 24)
#define PIO_WRAP(first, last) (((last) << 12) | ((first) << 7))
#define PIO_SHIFT_LEFT 0u /* whole words, and only when the program says so */
#define PIO_IN_BASE(pin) ((pin) << 15)

/* 4.2 UART */
#define UART0_DR 0x40034000u
#define UART0_FR 0x40034018u
#define UART0_IBRD 0x40034024u
#define UART0_FBRD 0x40034028u
#define UART0_LCR_H 0x4003402Cu
#define UART0_CR 0x40034030u
#define UART0_IMSC 0x40034038u
#define UART0_ICR 0x40034044u
#define UART_FR_RXFE BIT(4)
#define UART_FR_TXFF BIT(5)
#define UART_LCR_H_8_BITS 0x60u
#define UART_CR_UARTEN BIT(0)
#define UART_CR_TXE BIT(8)
#define UART_CR_RXE BIT(9)
#define UART_RX BIT(4)
#define UART_TX BIT(5)

/* 4.5 PWM */
#define PWM_CH0_CSR 0x40050000u
#define PWM_CH0_CTR 0x40050008u
#define PWM_CH0_CC 0x4005000Cu
#define PWM_CH0_TOP 0x40050010u
#define PWM_EN BIT(0)

/* 4.6 timer */
#define TIMER_ALARM0 0x40054010u
#define TIMER_TIMERAWL 0x40054028u
#define TIMER_INTR 0x40054034u
#define TIMER_INTE 0x40054038u
#define ALARM_0 BIT(0)

/* 4.7 watchdog */
#define WATCHDOG_CTRL 0x40058000u
#define WATCHDOG_LOAD 0x40058004u
#define WATCHDOG_REASON 0x40058008u
#define WATCHDOG_SCRATCH0 0x4005800Cu
#define WATCHDOG_TICK 0x4005802Cu
#define WATCHDOG_ENABLE BIT(30)
#define WATCHDOG_TICK_ENABLE BIT(9)

/* 4.9 converter */
#define ADC_CS 0x4004C000u
#define ADC_RESULT 0x4004C004u
#define ADC_EN BIT(0)
#define ADC_START_ONE BIT(2)
#define ADC_READY BIT(8)
#define ADC_ERR BIT(9)
#define ADC_AINSEL(channel) ((channel) << 12)

#endif
