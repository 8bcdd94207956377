/*
 * Calls every function in any order, with null pointers, wrong lengths, values outside their ranges, uninitialized storage and
 * damaged configurations. Each call must return a documented value. Memory comes from malloc() with the exact length, so that
 * Valgrind and the sanitizers see every access beyond it.
 *
 *     ./misuse STEPS SEED
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "wsg.h"

static uint64_t state;

static uint32_t below(uint32_t limit)
{
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(state >> 33) % limit;
}

static int one_in(uint32_t n)
{
    return below(n) == 0;
}

/* A pointer that is sometimes null. */
static void *maybe(void *pointer)
{
    return one_in(12) ? NULL : pointer;
}

static float number(void)
{
    const float odd[] = {0.0f, -1.0f, 1e30f, INFINITY, -INFINITY, NAN};
    return one_in(4) ? odd[below(6)] : (float)below(1000) / 8.0f;
}

/* Everything a program has, each in memory of its own. */
static wsg_t *wsg;
static wsg_parser_t *parser;
static wsg_can_t *can;
static wsg_fieldbus_t *fieldbus;
static wsg_queue_t *queue;
static wsg_event_t *events;
static uint8_t *bytes;
/* What an open request may refer to. */
static uint8_t kept[64];
static char tag[65];

/* Id of the last message. */
static uint8_t sent;

static unsigned long rejected, accepted, event_count;

static void result(int32_t value, const char *call)
{
    if (value < WSG_ERROR_OTHER || (value < WSG_ERROR_OUT_OF_LIMITS && value > WSG_ERROR_OTHER)) {
        printf("%s returned %d\n", call, (int)value);
        exit(1);
    }
    *(value < 0 ? &rejected : &accepted) += 1;
    if (strlen(wsg_error_text(value)) == 0) {
        printf("%d has no text\n", (int)value);
        exit(1);
    }
}

#define CALL(call) result((call), #call)

/* Reads all that an event gives, and calls what must be rejected. */
static void on_event(void *context, const wsg_event_t *event)
{
    uint8_t line[128];
    unsigned sum = 0;
    uint16_t i;

    event_count++;
    if (event->value_kind == WSG_VALUE_BYTES) {
        for (i = 0; i < event->value.bytes.length; i++) {
            sum += event->value.bytes.data[i];
        }
    }
    if (sum == 0xFFFFFFFFu || wsg_status_text(event->status)[0] == 0 || wsg_command_name(event->command)[0] == 0) {
        exit(1);
    }
    if (context != NULL) {
        wsg_queue_push(context, event);
    }
    if (wsg_tick(wsg, 0) != WSG_ERROR_IN_CALLBACK || wsg_receive(wsg, 0, NULL, 0) != WSG_ERROR_IN_CALLBACK ||
        wsg_transmit(wsg, 0, line, sizeof line) != WSG_ERROR_IN_CALLBACK || wsg_expire(wsg, 0) != WSG_ERROR_IN_CALLBACK ||
        wsg_disconnect(wsg) != WSG_ERROR_IN_CALLBACK) {
        printf("not rejected in the callback\n");
        exit(1);
    }
    if (one_in(4)) {
        wsg_grip_part(wsg, number(), number());
    }
}

static void init(void)
{
    wsg_config_t config;

    if (one_in(3)) {
        CALL(wsg_init(maybe(wsg), NULL, on_event, maybe(queue)));
        return;
    }
    wsg_config_default(&config);
    if (one_in(2)) {
        ((uint8_t *)&config)[below(sizeof config)] ^= (uint8_t)(1u << below(8));
    }
    config.updates = (uint8_t)below(9);
    CALL(wsg_init(maybe(wsg), &config, one_in(4) ? NULL : on_event, maybe(queue)));
}

static void pass(uint32_t now, const uint8_t *frame, int32_t length)
{
    uint8_t *line = malloc((size_t)length + !length);

    memcpy(line, frame, (size_t)length);
    CALL(wsg_receive(maybe(wsg), now, maybe(line), (size_t)length));
    free(line);
}

/* The reply of a gripper to the last message. */
static void answer(uint32_t now)
{
    uint8_t payload[66] = {0}, frame[80];
    uint32_t length = 0;

    switch (sent) {
    case 0x31: case 0x33: case 0x40: case 0x43: case 0x44: case 0x45: length = 4; break;
    case 0x35: case 0x42: case 0x50: length = 8; break;
    case 0x46: case 0x61: case 0x71: length = 2; break;
    case 0x41: length = 1; break;
    case 0x53: length = 32; break;
    case 0x60: case 0x70: length = 3; break;
    case 0x06: case 0x52: case 0x63: case 0x73: length = below(65); break;
    default: break;
    }
    memset(payload + 2, sent == 0x52 ? 'y' : 0, length);
    if (sent == 0x53) {
        const float limits[8] = {110.0f, 0.0f, 420.0f, 0.0f, 5000.0f, 0.0f, 80.0f, 120.0f};
        memcpy(payload + 2, limits, sizeof limits);
    }
    if (sent >= 0x20 && sent <= 0x26 && one_in(2)) {
        payload[0] = WSG_E_CMD_PENDING;
    }
    pass(now, frame, wsg_frame_encode(sent, payload, 2 + length, frame, sizeof frame));
}

/* A frame of a gripper, or something like it. */
static void receive(uint32_t now)
{
    uint8_t payload[80], frame[96];
    uint32_t length = below(8) == 0 ? below(80) : (uint32_t[]){2, 3, 6, 10, 34}[below(5)], i;
    const uint8_t ids[] = {0x06, 0x20, 0x22, 0x23, 0x25, 0x26, 0x40, 0x41, 0x43, 0x50, 0x52, 0x53, 0x63, 0xB0};
    int32_t total;

    for (i = 0; i < length; i++) {
        payload[i] = one_in(3) ? (uint8_t)below(256) : 0;
    }
    total = wsg_frame_encode(ids[below(sizeof ids)], payload, length, frame, sizeof frame);
    if (one_in(6)) {
        frame[below((uint32_t)total)] ^= 1;
    }
    if (one_in(6)) {
        total = (int32_t)below((uint32_t)total);
    }
    pass(now, frame, total);
}

static void transmit(uint32_t now)
{
    size_t size = one_in(3) ? below(WSG_TRANSMIT_LEN) : WSG_TRANSMIT_LEN + below(64);
    uint8_t *buffer = malloc(size + !size);

    int32_t length;

    CALL(length = wsg_transmit(maybe(wsg), now, maybe(buffer), size));
    if (length > 0) {
        sent = buffer[3];
        if (!one_in(6)) {
            answer(now);
        }
    }
    free(buffer);
}

static void request(void)
{
    switch (below(36)) {
    case 0: CALL(wsg_loop(maybe(wsg), maybe(kept), below(66) % (sizeof kept + 1))); break;
    case 1: CALL(wsg_disconnect_announcement(maybe(wsg))); break;
    case 2: CALL(wsg_homing(maybe(wsg), (uint8_t)below(5))); break;
    case 3: CALL(wsg_pre_position(maybe(wsg), (uint8_t)below(6), number(), number())); break;
    case 4: CALL(wsg_stop(maybe(wsg))); break;
    case 5: CALL(one_in(4) ? wsg_fast_stop(maybe(wsg)) : 0); break;
    case 6: CALL(wsg_acknowledge(maybe(wsg))); break;
    case 7: CALL(wsg_grip_part(maybe(wsg), number(), number())); break;
    case 8: CALL(wsg_release_part(maybe(wsg), number(), number())); break;
    case 9: CALL(wsg_set_acceleration(maybe(wsg), number())); break;
    case 10: CALL(wsg_get_acceleration(maybe(wsg))); break;
    case 11: CALL(wsg_set_force_limit(maybe(wsg), number())); break;
    case 12: CALL(wsg_get_force_limit(maybe(wsg))); break;
    case 13: CALL(wsg_set_soft_limits(maybe(wsg), number(), number())); break;
    case 14: CALL(wsg_get_soft_limits(maybe(wsg))); break;
    case 15: CALL(wsg_clear_soft_limits(maybe(wsg))); break;
    case 16: CALL(wsg_overdrive_mode(maybe(wsg), (uint8_t)below(4))); break;
    case 17: CALL(wsg_tare_force_sensor(maybe(wsg))); break;
    case 18: CALL(wsg_get_system_state(maybe(wsg))); break;
    case 19: CALL(wsg_get_gripper_state(maybe(wsg))); break;
    case 20: CALL(wsg_get_gripping_statistics(maybe(wsg), (uint8_t)below(4))); break;
    case 21: CALL(wsg_get_opening_width(maybe(wsg))); break;
    case 22: CALL(wsg_get_speed(maybe(wsg))); break;
    case 23: CALL(wsg_get_force(maybe(wsg))); break;
    case 24: CALL(wsg_get_temperature(maybe(wsg))); break;
    case 25: CALL(wsg_get_system_info(maybe(wsg))); break;
    case 26: CALL(wsg_set_device_tag(maybe(wsg), maybe(tag))); break;
    case 27: CALL(wsg_get_device_tag(maybe(wsg))); break;
    case 28: CALL(wsg_get_system_limits(maybe(wsg))); break;
    case 29: CALL(wsg_get_finger_info(maybe(wsg), (uint8_t)below(4))); break;
    case 30: CALL(wsg_get_finger_flags(maybe(wsg), (uint8_t)below(4))); break;
    case 31: CALL(wsg_finger_power(maybe(wsg), (uint8_t)below(4), (uint8_t)below(3))); break;
    case 32: CALL(wsg_get_finger_data(maybe(wsg), (uint8_t)below(4))); break;
    case 33: CALL(wsg_custom(maybe(wsg), (uint8_t)below(256), maybe(kept), below(sizeof kept + 1))); break;
    case 34: CALL(wsg_subscribe(maybe(wsg), (uint8_t)(0x3F + below(8)), (uint16_t)below(600), (uint8_t)below(3))); break;
    default: CALL(wsg_withdraw(maybe(wsg))); break;
    }
}

static void beside_the_session(uint32_t now)
{
    uint8_t image[16] = {0}, frame[96];
    wsg_frame_t found;
    wsg_event_t event;
    wsg_can_frame_t can_frame = {0}, *frames;
    size_t taken = 0;
    uint32_t count;

    switch (below(12)) {
    case 0: CALL(wsg_parser_init(maybe(parser))); break;
    case 1: CALL(wsg_parser_push(maybe(parser), maybe(kept), sizeof kept, maybe(&taken), maybe(&found))); break;
    case 2: CALL(wsg_parser_expire(maybe(parser), maybe(&found))); break;
    case 3:
        found.payload = maybe(kept);
        found.length = (uint16_t)below(sizeof kept + 1);
        found.id = (uint8_t)below(256);
        found.kind = (uint8_t)(1 + below(3));
        CALL(wsg_reply_decode(maybe(&found), maybe(&event)));
        break;
    case 4: CALL(wsg_can_init(maybe(can), (uint16_t)below(0x900))); break;
    case 5:
        count = below(WSG_CAN_MAX_FRAMES + 1);
        frames = malloc(count * sizeof *frames + !count);
        taken = (size_t)wsg_frame_encode(0x25, kept, below(64), frame, sizeof frame);
        CALL(wsg_can_split((uint16_t)below(0x900), maybe(frame), taken, maybe(frames), count));
        free(frames);
        break;
    case 6:
        can_frame.id = (uint16_t)(one_in(4) ? below(65536) : WSG_CAN_DEFAULT_ID + 1);
        can_frame.length = (uint8_t)below(10);
        memset(can_frame.data, 0xAA, 3);
        can_frame.data[3] = 0x43;
        CALL(wsg_can_receive(maybe(can), maybe(wsg), now, maybe(&can_frame)));
        CALL(wsg_can_tick(maybe(can), maybe(wsg), now));
        break;
    case 7: CALL(wsg_fieldbus_attach(maybe(fieldbus), maybe(wsg))); break;
    case 8:
        image[0] = (uint8_t)(one_in(2) ? below(256) : 0);
        CALL(wsg_fieldbus_write(maybe(fieldbus), maybe(wsg), maybe(image), 6 + below(5)));
        break;
    case 9: CALL(wsg_fieldbus_read(maybe(fieldbus), maybe(wsg), maybe(image), below(16))); break;
    case 10: CALL(wsg_fieldbus_silence(maybe(fieldbus), maybe(wsg), (uint8_t)below(5))); break;
    default:
        CALL(wsg_queue_pop(maybe(queue), maybe(&event)));
        CALL(wsg_queue_lost(maybe(queue)));
        break;
    }
}

int main(int count, char **arguments)
{
    unsigned long steps = count > 1 ? strtoul(arguments[1], NULL, 10) : 100000;
    unsigned long steps_done = steps;
    uint32_t now = 0, delay;

    state = count > 2 ? strtoull(arguments[2], NULL, 10) : 1;
    wsg = calloc(1, sizeof *wsg);
    parser = calloc(1, sizeof *parser);
    can = calloc(1, sizeof *can);
    fieldbus = calloc(1, sizeof *fieldbus);
    queue = calloc(1, sizeof *queue);
    events = malloc(4 * sizeof *events);
    bytes = malloc(16);
    memset(tag, 'x', sizeof tag - 1);
    CALL(wsg_tick(wsg, 0));     /* not initialized */
    CALL(wsg_queue_init(queue, NULL, 4, NULL, 0));
    CALL(wsg_queue_init(queue, events, 0, NULL, 0));
    CALL(wsg_queue_init(queue, events, 4, bytes, 16));
    for (; steps > 0; steps--) {
        wsg_known_t known;
        wsg_counters_t counters;

        switch (below(10)) {
        case 0: receive(now); break;
        case 1: case 2: transmit(now); break;
        case 3: case 4: request(); break;
        case 5: beside_the_session(now); break;
        case 6: now += below(one_in(20) ? 2000 : 30); break;
        case 7: transmit(now); break;
        case 8: if (one_in(60)) init(); else if (one_in(8)) CALL(wsg_disconnect(maybe(wsg))); break;
        default:
            CALL(wsg_known(maybe(wsg), maybe(&known)));
            CALL(wsg_counters(maybe(wsg), maybe(&counters)));
            CALL(wsg_next_deadline(maybe(wsg), now, maybe(&delay)));
            CALL(wsg_expire(maybe(wsg), now));
            break;
        }
        CALL(wsg_tick(maybe(wsg), now));
    }
    printf("%lu accepted, %lu rejected, %lu events\n", accepted, rejected, event_count);
    free(bytes);
    free(events);
    free(queue);
    free(fieldbus);
    free(can);
    free(parser);
    free(wsg);
    return rejected > steps_done / 10 && event_count > steps_done / 200 ? 0 : 1;
}
