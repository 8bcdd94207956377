/*
 * A gripper with FreeRTOS: one task owns the session, and another one commands the gripper and waits for results. It is the program
 * of bare_metal.c on the same board.
 *
 * Only gripper_task() calls the library. Other tasks send it requests, and receive its events.
 *
 * Compile it like bare_metal.c, with board.c, and with tasks.c, queue.c, list.c, stream_buffer.c and portable/GCC/ARM_CM4F/port.c of
 * the kernel.
 */
#include "FreeRTOS.h"
#include "board.h"
#include "queue.h"
#include "stream_buffer.h"
#include "task.h"

/* In words. The session's storage is static. */
#define STACK 384

/* The longest wait of the gripper task in milliseconds. */
#define LONGEST_WAIT 100u

typedef struct {
    uint8_t command;
    float width, speed;
} request_t;

static StreamBufferHandle_t received;
static QueueHandle_t requests, events;
static TaskHandle_t gripper_task_handle;
static wsg_t wsg;
static volatile int is_done;

/* Moves bytes from the interrupt to the task. The session tolerates lost bytes. */
void on_byte(uint8_t byte)
{
    BaseType_t is_woken = pdFALSE;

    xStreamBufferSendFromISR(received, &byte, 1, &is_woken);
    vTaskNotifyGiveFromISR(gripper_task_handle, &is_woken);
    portYIELD_FROM_ISR(is_woken);
}

/* Passes events to the application. It reads all of them, so the queue has room. */
static void on_event(void *context, const wsg_event_t *event)
{
    (void)context;
    if (event->kind != WSG_EVENT_PENDING) {
        xQueueSend(events, event, 0);
    }
}

static int32_t start(const request_t *request)
{
    switch (request->command) {
    case WSG_COMMAND_HOMING:
        return wsg_homing(&wsg, WSG_HOMING_DEFAULT);
    case WSG_COMMAND_GRIP_PART:
        return wsg_grip_part(&wsg, request->width, request->speed);
    case WSG_COMMAND_RELEASE_PART:
        return wsg_release_part(&wsg, request->width, request->speed);
    case WSG_COMMAND_FAST_STOP:
        return wsg_fast_stop(&wsg);
    default:
        return WSG_ERROR_ARGUMENT;
    }
}

static void gripper_task(void *context)
{
    uint8_t bytes[WSG_TRANSMIT_LEN];
    request_t request;
    wsg_known_t known;

    (void)context;
    wsg_init(&wsg, NULL, on_event, NULL);
    for (;;) {
        uint32_t delay = LONGEST_WAIT;
        int32_t length;
        size_t count;

        while ((count = xStreamBufferReceive(received, bytes, sizeof bytes, 0)) > 0) {
            wsg_receive(&wsg, xTaskGetTickCount(), bytes, count);
        }
        while (xQueueReceive(requests, &request, 0) == pdTRUE) {
            if (start(&request) < 0) {
                wsg_event_t event = {0};
                event.kind = WSG_EVENT_WITHDRAWN;
                event.command = request.command;
                on_event(NULL, &event);
            }
        }
        wsg_tick(&wsg, xTaskGetTickCount());
        while ((length = wsg_transmit(&wsg, xTaskGetTickCount(), bytes, sizeof bytes)) > 0) {
            int32_t sent = 0;
            uint32_t tries;
            /* A byte takes 87 us. If the UART is stuck, the session repeats the message. */
            for (tries = 0; sent < length && tries < 100000; tries++) {
                sent += board_send(bytes[sent]);
            }
        }
        wsg_known(&wsg, &known);
        board_show(&known, is_done);
        wsg_next_deadline(&wsg, xTaskGetTickCount(), &delay);
        ulTaskNotifyTake(pdTRUE, pdMS_TO_TICKS(delay < LONGEST_WAIT ? delay + 1 : LONGEST_WAIT));
    }
}

/* Requests a command and waits for its outcome. Returns whether it succeeded. */
static int run(uint8_t command, float width, float speed)
{
    request_t request = {0};
    wsg_event_t event;

    request.command = command;
    request.width = width;
    request.speed = speed;
    xQueueSend(requests, &request, portMAX_DELAY);
    xTaskNotifyGive(gripper_task_handle);
    do {
        xQueueReceive(events, &event, portMAX_DELAY);
        if (event.kind == WSG_EVENT_DISCONNECTED) {
            return 0;
        }
    } while (event.command != command || event.kind == WSG_EVENT_REPORTED || event.kind == WSG_EVENT_LATE);
    return event.kind == WSG_EVENT_ANSWERED && event.status == WSG_E_SUCCESS;
}

/* Waits until the gripper is connected, or reports a state. */
static void wait_for(uint8_t kind, uint8_t state)
{
    wsg_event_t event;

    do {
        xQueueReceive(events, &event, portMAX_DELAY);
    } while (event.kind != kind ||
             (kind == WSG_EVENT_REPORTED && (event.value_kind != WSG_VALUE_STATE || event.value.state != state)));
}

static void application_task(void *context)
{
    (void)context;
    wait_for(WSG_EVENT_CONNECTED, 0);
    if (run(WSG_COMMAND_HOMING, 0, 0) && run(WSG_COMMAND_GRIP_PART, 20.0f, 100.0f)) {
        wait_for(WSG_EVENT_REPORTED, WSG_STATE_PART_LOST);
        is_done = run(WSG_COMMAND_RELEASE_PART, 50.0f, 200.0f) && run(WSG_COMMAND_FAST_STOP, 0, 0);
        xTaskNotifyGive(gripper_task_handle);
    }
    vTaskSuspend(NULL);
}

/* Sleeps until the next interrupt. */
void vApplicationIdleHook(void)
{
    __asm volatile("wfi");
}

int main(void)
{
    static StackType_t gripper_stack[STACK], application_stack[STACK];
    static StaticTask_t gripper_block, application_block;
    static StaticStreamBuffer_t received_block;
    static StaticQueue_t requests_block, events_block;
    static uint8_t received_bytes[65], request_bytes[2 * sizeof(request_t)], event_bytes[8 * sizeof(wsg_event_t)];

    received = xStreamBufferCreateStatic(sizeof received_bytes, 1, received_bytes, &received_block);
    requests = xQueueCreateStatic(2, sizeof(request_t), request_bytes, &requests_block);
    events = xQueueCreateStatic(8, sizeof(wsg_event_t), event_bytes, &events_block);
    xTaskCreateStatic(application_task, "application", STACK, NULL, 1, application_stack, &application_block);
    gripper_task_handle = xTaskCreateStatic(gripper_task, "gripper", STACK, NULL, 2, gripper_stack, &gripper_block);
    board_start();
    vTaskStartScheduler();
    return 0;
}
