/*
 * A gripper on UART4 of the board B-L475E-IOT01A (STM32L475VG), without operating system, C library or HAL.
 *
 * After power-up the program homes the fingers, grips a part, waits until the part is lost, opens the fingers, and ends with a
 * FAST STOP. The pins of port A show the state: see board.h.
 *
 *     arm-none-eabi-gcc -mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard -Os -ffreestanding -nostdlib -z noexecstack \
 *         -Wl,--gc-sections -I include examples/bare_metal.c examples/board.c -L lib/thumbv7em-none-eabihf -lwsg \
 *         -T examples/board.ld -o bare_metal.elf
 */
#include "board.h"

/* Milliseconds since power-up. */
static volatile uint32_t now_ms;

/* Received bytes between the interrupt and the main loop. The session tolerates lost bytes; here they are only dropped. */
static volatile uint8_t received[64];
static volatile uint32_t received_head;
static uint32_t received_tail;

static wsg_t wsg;
static int is_done;

void sys_tick(void)
{
    now_ms = now_ms + 1;
}

void on_byte(uint8_t byte)
{
    uint32_t head = received_head;
    received[head % sizeof received] = byte;
    received_head = head + 1;
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

int main(void)
{
    wsg_known_t known;
    uint8_t message[WSG_TRANSMIT_LEN];
    int32_t length = 0, sent = 0;

    board_start();
    board_start_tick();
    wsg_init(&wsg, NULL, on_event, NULL);
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
        while (sent < length && board_send(message[sent])) {
            sent++;
        }
        wsg_known(&wsg, &known);
        board_show(&known, is_done);
        __asm volatile("wfi"); /* at most a millisecond */
    }
}
