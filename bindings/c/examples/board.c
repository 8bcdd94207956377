/* See board.h. Registers: RM0351. */
#include "board.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))

#define RCC_CR       REGISTER(0x40021000)
#define RCC_CFGR     REGISTER(0x40021008)
#define RCC_AHB2ENR  REGISTER(0x4002104C)
#define RCC_APB1ENR1 REGISTER(0x40021058)
#define GPIOA_MODER  REGISTER(0x48000000)
#define GPIOA_PUPDR  REGISTER(0x4800000C)
#define GPIOA_ODR    REGISTER(0x48000014)
#define GPIOA_AFRL   REGISTER(0x48000020)
#define UART4_CR1    REGISTER(0x40004C00)
#define UART4_BRR    REGISTER(0x40004C0C)
#define UART4_ISR    REGISTER(0x40004C1C)
#define UART4_ICR    REGISTER(0x40004C20)
#define UART4_RDR    REGISTER(0x40004C24)
#define UART4_TDR    REGISTER(0x40004C28)
#define SYST_CSR     REGISTER(0xE000E010)
#define SYST_RVR     REGISTER(0xE000E014)
#define SYST_CVR     REGISTER(0xE000E018)
#define NVIC_ISER1   REGISTER(0xE000E104)
#define NVIC_IPR13   REGISTER(0xE000E434)
#define CPACR        REGISTER(0xE000ED88)

#define UART4_IRQ 52

void board_start(void)
{
    uint32_t tries;

    RCC_CR |= 1u << 8; /* HSI16 on */
    for (tries = 0; tries < 1000 && !(RCC_CR & (1u << 10)); tries++) {
    }
    RCC_CFGR = (RCC_CFGR & ~3u) | 1u; /* as the system clock */
    RCC_AHB2ENR |= 1u;
    RCC_APB1ENR1 |= 1u << 19;
    (void)RCC_APB1ENR1;

    /* PA0 and PA1 are UART4 (alternate function 8), PA1 with a pull-up; PA2 to PA7 and PA15 are outputs. */
    GPIOA_AFRL = (GPIOA_AFRL & ~0xFFu) | 0x88u;
    GPIOA_PUPDR = (GPIOA_PUPDR & ~0xFu) | (1u << 2);
    GPIOA_MODER = (GPIOA_MODER & ~0xC000FFFFu) | 0x4000555Au;
    GPIOA_ODR = 0;

    UART4_BRR = (BOARD_CLOCK_HZ + 115200u / 2) / 115200u;
    UART4_CR1 = (1u << 5) | (1u << 3) | (1u << 2) | 1u; /* interrupt on reception, transmitter, receiver, on */
    NVIC_IPR13 = 0x80u;                                 /* below the interrupts that an operating system cannot mask */
    NVIC_ISER1 = 1u << (UART4_IRQ - 32);
}

void board_start_tick(void)
{
    SYST_RVR = BOARD_CLOCK_HZ / 1000 - 1;
    SYST_CVR = 0;
    SYST_CSR = 7;
}

int board_send(uint8_t byte)
{
    if (!(UART4_ISR & (1u << 7))) {
        return 0;
    }
    UART4_TDR = byte;
    return 1;
}

void board_show(const wsg_known_t *known, int is_done)
{
    uint32_t pins = 0;

    pins |= is_done ? 1u << 2 : 0;
    pins |= known->motion ? 1u << 3 : 0;
    pins |= known->state == WSG_STATE_HOLDING ? 1u << 4 : 0;
    pins |= known->connected ? 1u << 5 : 0;
    pins |= known->state == WSG_STATE_PART_LOST || known->state == WSG_STATE_NO_PART ? 1u << 6 : 0;
    pins |= known->flags & WSG_FLAG_FAST_STOP ? 1u << 7 : 0;
    pins |= known->flags & WSG_FLAG_REFERENCED ? 1u << 15 : 0;
    if (GPIOA_ODR != pins) {
        GPIOA_ODR = pins;
    }
}

static void uart4(void)
{
    uint32_t status = UART4_ISR;
    if (status & (1u << 5)) {
        on_byte((uint8_t)UART4_RDR);
    }
    UART4_ICR = status & 0xFu; /* parity, framing, noise and overrun errors */
}

extern uint32_t data_begin, data_end, data_load, bss_begin, bss_end, stack_top;

void reset(void);
void reset(void)
{
    volatile uint32_t *to;
    const uint32_t *from = &data_load;

    for (to = &data_begin; to < &data_end; to++) {
        *to = *from++;
    }
    for (to = &bss_begin; to < &bss_end; to++) {
        *to = 0;
    }
    CPACR |= 0xFu << 20; /* floating-point unit on */
    __asm volatile("dsb\n isb");
    main();
}

void fault(void);
void fault(void)
{
    for (;;) {
    }
}

#pragma weak svc = fault
#pragma weak pend_sv = fault

#define EXCEPTIONS 16

__attribute__((used, section(".vectors"))) static void (*const vectors[EXCEPTIONS + UART4_IRQ + 1])(void) = {
    (void (*)(void)) & stack_top,
    reset,
    [2 ... 10] = fault,
    [11] = svc,
    [12 ... 13] = fault,
    [14] = pend_sv,
    [15] = sys_tick,
    [EXCEPTIONS + UART4_IRQ] = uart4,
};
