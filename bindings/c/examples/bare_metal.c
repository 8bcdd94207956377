/*
 * A gripper on UART4 of the board B-L475E-IOT01A (STM32L475VG), without operating system, C library or HAL.
 *
 * After power-up the program homes the fingers, grips a part, waits until the part is lost, opens the fingers, and ends with a
 * FAST STOP. The pins of port A show the state: see show().
 *
 *     arm-none-eabi-gcc -mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard -Os -ffreestanding -nostdlib -z noexecstack \
 *         -Wl,--gc-sections -I include examples/bare_metal.c -L lib/thumbv7em-none-eabihf -lwsg -T examples/bare_metal.ld \
 *         -o bare_metal.elf
 *
 * Registers: RM0351.
 */
#include "wsg.h"

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
#define CPACR        REGISTER(0xE000ED88)

#define CLOCK_HZ 16000000u
#define UART4_IRQ 52

#define PIN_DONE       (1u << 2)
#define PIN_BUSY       (1u << 3)
#define PIN_HOLDING    (1u << 4)
#define PIN_CONNECTED  (1u << 5)
#define PIN_PART_FAULT (1u << 6)
#define PIN_FAST_STOP  (1u << 7)
#define PIN_REFERENCED (1u << 15)

/* Milliseconds since power-up. */
static volatile uint32_t now_ms;

/* Received bytes between the interrupt and the main loop. The session tolerates lost bytes; here they are only dropped. */
static volatile uint8_t received[64];
static volatile uint32_t received_head;
static uint32_t received_tail;

static wsg_t wsg;
static int is_done;

static void sys_tick(void)
{
    now_ms = now_ms + 1;
}

static void uart4(void)
{
    uint32_t status = UART4_ISR;
    if (status & (1u << 5)) {
        uint32_t head = received_head;
        received[head % sizeof received] = (uint8_t)UART4_RDR;
        received_head = head + 1;
    }
    UART4_ICR = status & 0xFu; /* parity, framing, noise and overrun errors */
}

static void set_up(void)
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
    GPIOA_ODR = 0;
    GPIOA_MODER = (GPIOA_MODER & ~0xC000FFFFu) | 0x4000555Au;

    UART4_BRR = (CLOCK_HZ + 115200u / 2) / 115200u;
    UART4_CR1 = (1u << 5) | (1u << 3) | (1u << 2) | 1u; /* interrupt on reception, transmitter, receiver, on */
    NVIC_ISER1 = 1u << (UART4_IRQ - 32);

    SYST_RVR = CLOCK_HZ / 1000 - 1;
    SYST_CVR = 0;
    SYST_CSR = 7;
}

/* Each result of a step requests the next one. */
static void on_event(void *context, const wsg_event_t *event)
{
    (void)context;
    if (event->kind == WSG_EVENT_CONNECTED) {
        wsg_homing(&wsg, WSG_HOMING_DEFAULT);
    } else if (event->kind == WSG_EVENT_ANSWERED && event->status == WSG_E_SUCCESS) {
        switch (event->command) {
        case WSG_COMMAND_HOMING:
            wsg_grip_part(&wsg, 20.0f, 100.0f);
            break;
        case WSG_COMMAND_RELEASE_PART:
            wsg_fast_stop(&wsg);
            break;
        case WSG_COMMAND_FAST_STOP:
            is_done = 1;
            break;
        default:
            break;
        }
    } else if (event->kind == WSG_EVENT_REPORTED && event->value_kind == WSG_VALUE_STATE &&
               event->value.state == WSG_STATE_PART_LOST) {
        wsg_release_part(&wsg, 50.0f, 200.0f);
    }
}

static void show(void)
{
    wsg_known_t known;
    uint32_t pins = 0;

    wsg_known(&wsg, &known);
    pins |= is_done ? PIN_DONE : 0;
    pins |= known.connected ? PIN_CONNECTED : 0;
    pins |= known.motion ? PIN_BUSY : 0;
    pins |= known.state == WSG_STATE_HOLDING ? PIN_HOLDING : 0;
    pins |= known.state == WSG_STATE_PART_LOST || known.state == WSG_STATE_NO_PART ? PIN_PART_FAULT : 0;
    pins |= known.flags & WSG_FLAG_FAST_STOP ? PIN_FAST_STOP : 0;
    pins |= known.flags & WSG_FLAG_REFERENCED ? PIN_REFERENCED : 0;
    if (GPIOA_ODR != pins) {
        GPIOA_ODR = pins;
    }
}

int main(void)
{
    uint8_t message[WSG_TRANSMIT_LEN];
    int32_t length = 0, sent = 0;

    set_up();
    wsg_init(&wsg, NULL, on_event, NULL);
    GPIOA_ODR = 0;
    for (;;) {
        while (received_tail != received_head) {
            uint8_t byte = received[received_tail % sizeof received];
            received_tail++;
            wsg_receive(&wsg, now_ms, &byte, 1);
        }
        wsg_tick(&wsg, now_ms);
        if (sent == length) {
            length = wsg_transmit(&wsg, now_ms, message, sizeof message);
            sent = 0;
        }
        while (sent < length && (UART4_ISR & (1u << 7))) {
            UART4_TDR = message[sent++];
        }
        show();
        __asm volatile("wfi"); /* at most a millisecond */
    }
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

static void fault(void)
{
    for (;;) {
    }
}

#define EXCEPTIONS 16

__attribute__((used, section(".vectors"))) static void (*const vectors[EXCEPTIONS + UART4_IRQ + 1])(void) = {
    (void (*)(void)) & stack_top,
    reset,
    [2 ... EXCEPTIONS - 2] = fault,
    [EXCEPTIONS - 1] = sys_tick,
    [EXCEPTIONS + UART4_IRQ] = uart4,
};
