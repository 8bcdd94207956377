/*
 * Grips a part, stops a motion from another thread, and follows set-points, over TCP, UDP or a serial port.
 *
 *     cc -I include examples/host.c -L lib/x86_64-unknown-linux-gnu -lwsg_host -lpthread -ldl -lm -o host
 *     ./host 192.168.1.20 1000              (TCP)
 *     ./host 192.168.1.20 1500 1501         (UDP, and the port for the replies)
 *     ./host /dev/ttyUSB0
 *
 * On Windows with MinGW:
 *
 *     gcc -I include examples/host.c -L lib/x86_64-pc-windows-gnu -lwsg_host -lws2_32 -luserenv -lntdll -lpthread -static -o host
 *     host COM3
 */
#define _POSIX_C_SOURCE 200809L

#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "wsg_host.h"

static void sleep_ms(long ms)
{
    struct timespec time = {ms / 1000, ms % 1000 * 1000000};
    nanosleep(&time, NULL);
}

/* Prints the outcome of a call and ends the program if it is not the expected one. */
static void expect(const char *what, int32_t outcome, int32_t expected)
{
    printf("%s: %s\n", what, wsg_host_error_text(outcome));
    fflush(stdout);
    if (outcome != expected) {
        exit(1);
    }
}

/* A button that is pressed while the fingers move. */
static void *press_button(void *handle)
{
    sleep_ms(100);
    return wsg_host_stop_now(handle, 0) == 0 ? handle : NULL;
}

static int32_t open_line(int count, char **arguments, wsg_host_t **gripper)
{
    uint16_t port = (uint16_t)(count > 2 ? atoi(arguments[2]) : 0);

    switch (count) {
    case 2:
        return wsg_host_open_serial(arguments[1], 115200, gripper);
    case 3:
        return wsg_host_open_tcp(arguments[1], port, gripper);
    case 4:
        return wsg_host_open_udp(arguments[1], port, (uint16_t)atoi(arguments[3]), gripper);
    default:
        fprintf(stderr, "usage: host HOST PORT | host HOST PORT REPLY_PORT | host DEVICE\n");
        exit(2);
    }
}

int main(int count, char **arguments)
{
    wsg_host_t *gripper;
    wsg_host_stop_t *handle;
    wsg_host_stream_t *stream;
    wsg_host_sample_t sample;
    pthread_t button;
    uint8_t held = 0;
    uint32_t now = 0;
    float width = 0;
    int tries;

    expect("open", open_line(count, arguments, &gripper), 0);
    expect("home", wsg_host_home(gripper, WSG_HOMING_DEFAULT), 0);
    expect("grip", wsg_host_grip(gripper, 20.0f, 100.0f, &held), 0);
    expect("width", wsg_host_width(gripper, &width), 0);
    printf("%s, %.0f mm\n", held ? "held" : "no part", (double)width);
    expect("release", wsg_host_release(gripper, 60.0f, 200.0f), 0);

    expect("stop handle", wsg_host_stop_handle(gripper, &handle), 0);
    pthread_create(&button, NULL, press_button, handle);
    expect("move", wsg_host_move(gripper, 100.0f, 5.0f), WSG_HOST_ERROR_STOPPED);
    pthread_join(button, NULL);
    wsg_host_stop_free(handle);

    expect("stream", wsg_host_stream_start(gripper, 100, &stream), 0);
    expect("target", wsg_host_stream_set_target(stream, 40.0f), 0);
    /* Outside the stroke, and in microseconds instead of milliseconds. */
    expect("width", wsg_host_stream_set_target(stream, 200.0f), WSG_HOST_ERROR_OUT_OF_LIMITS);
    expect("now", wsg_host_stream_now(stream, &now), 0);
    expect("time", wsg_host_stream_schedule(stream, 50.0f, now + 500000000), WSG_HOST_ERROR_ARGUMENT);
    for (tries = 0; tries < 1000; tries++) {
        if (wsg_host_stream_latest(stream, &sample) != 0) {
            return 1;
        }
        if (fabsf(sample.position - 40.0f) < 0.5f) {
            break;
        }
        sleep_ms(10);
    }
    printf("at %.0f mm\n", (double)sample.position);
    expect("end", wsg_host_stream_end(stream, &gripper), 0);
    expect("fast stop", wsg_host_fast_stop(gripper), 0);
    expect("move", wsg_host_move(gripper, 50.0f, 100.0f), WSG_E_ACCESS_DENIED);
    expect("acknowledge", wsg_host_acknowledge(gripper), 0);
    wsg_host_close(gripper);
    return 0;
}
