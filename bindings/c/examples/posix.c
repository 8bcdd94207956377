/*
 * Homes a gripper, grips a part and releases it, over TCP or a serial port, in one thread.
 *
 *     cc -I include examples/posix.c -L lib/x86_64-unknown-linux-gnu -lwsg -o posix
 *     ./posix 127.0.0.1 1000
 *     ./posix /dev/ttyUSB0
 */
#define _POSIX_C_SOURCE 200809L

#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <poll.h>
#include <stdio.h>
#include <sys/socket.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "wsg.h"

/* The program gives up after this time. */
#define LIMIT_MS 60000u

static uint32_t now_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)now.tv_sec * 1000u + (uint32_t)(now.tv_nsec / 1000000);
}

static int open_tcp(const char *host, const char *port)
{
    struct addrinfo hints = {0}, *found, *each;
    int line = -1;

    hints.ai_socktype = SOCK_STREAM;
    if (getaddrinfo(host, port, &hints, &found) != 0) {
        return -1;
    }
    for (each = found; each != NULL && line < 0; each = each->ai_next) {
        line = socket(each->ai_family, each->ai_socktype, each->ai_protocol);
        if (line >= 0 && connect(line, each->ai_addr, each->ai_addrlen) != 0) {
            close(line);
            line = -1;
        }
    }
    freeaddrinfo(found);
    return line;
}

/* 115 200 bit/s, 8N1, raw. */
static int open_serial(const char *path)
{
    struct termios settings;
    int line = open(path, O_RDWR | O_NOCTTY);

    if (line >= 0 && tcgetattr(line, &settings) == 0) {
        settings.c_iflag = 0;
        settings.c_oflag = 0;
        settings.c_lflag = 0;
        settings.c_cflag = CS8 | CREAD | CLOCAL;
        settings.c_cc[VMIN] = 1;
        settings.c_cc[VTIME] = 0;
        cfsetispeed(&settings, B115200);
        cfsetospeed(&settings, B115200);
        tcsetattr(line, TCSANOW, &settings);
    }
    return line;
}

/* Sends everything that is due. */
static int send_all(wsg_t *wsg, int line)
{
    uint8_t message[WSG_TRANSMIT_LEN];
    int32_t length;

    while ((length = wsg_transmit(wsg, now_ms(), message, sizeof message)) > 0) {
        int32_t sent = 0;
        while (sent < length) {
            ssize_t count = write(line, message + sent, (size_t)(length - sent));
            if (count < 0 && errno != EINTR) {
                return -1;
            }
            sent += count > 0 ? (int32_t)count : 0;
        }
    }
    return (int)length;
}

/*
 * Requests the next step of the cycle. Returns 1 at the end, 0 before, and a negative number after a failure.
 *
 * The last step announces the end of the connection, also after a refused or failed command. Without it, a gripper on TCP enters FAST
 * STOP when the program ends, and refuses the next program's motions until wsg_acknowledge(). Other lines answer that it is not
 * available, which changes nothing.
 */
static int next_step(wsg_t *wsg, const wsg_event_t *event)
{
    static int end = 1;

    switch (event->kind) {
    case WSG_EVENT_CONNECTED:
        puts("connected");
        return wsg_homing(wsg, WSG_HOMING_DEFAULT);
    case WSG_EVENT_ANSWERED:
        if (event->command == WSG_COMMAND_DISCONNECT_ANNOUNCEMENT) {
            return end;
        }
        printf("%s: %s\n", wsg_command_name(event->command), wsg_status_text(event->status));
        if (event->status != WSG_E_SUCCESS) {
            end = -1;
            return wsg_disconnect_announcement(wsg);
        }
        if (event->command == WSG_COMMAND_HOMING) {
            return wsg_grip_part(wsg, 20.0f, 100.0f);
        }
        if (event->command == WSG_COMMAND_GRIP_PART) {
            return wsg_release_part(wsg, 50.0f, 200.0f);
        }
        return wsg_disconnect_announcement(wsg);
    case WSG_EVENT_DISCONNECTED:
    case WSG_EVENT_UNANSWERED:
        printf("no answer from the gripper\n");
        return -1;
    default:
        return 0;
    }
}

int main(int count, char **arguments)
{
    wsg_t wsg;
    wsg_queue_t queue;
    wsg_event_t events[16], event;
    uint32_t start = now_ms();
    int line, outcome = 0;

    if (count != 2 && count != 3) {
        fprintf(stderr, "usage: posix HOST PORT | posix DEVICE\n");
        return 2;
    }
    line = count == 3 ? open_tcp(arguments[1], arguments[2]) : open_serial(arguments[1]);
    if (line < 0) {
        fprintf(stderr, "cannot open %s\n", arguments[1]);
        return 1;
    }
    wsg_queue_init(&queue, events, 16, NULL, 0);
    wsg_init(&wsg, NULL, wsg_queue_push, &queue);
    while (outcome == 0 && now_ms() - start < LIMIT_MS) {
        struct pollfd waiting = {0};
        uint32_t delay = 0;

        wsg_tick(&wsg, now_ms());
        while (outcome == 0 && wsg_queue_pop(&queue, &event) == 1) {
            outcome = next_step(&wsg, &event);
        }
        wsg_tick(&wsg, now_ms()); /* opens the request of the step */
        if (send_all(&wsg, line) < 0) {
            outcome = -1;
        }
        wsg_next_deadline(&wsg, now_ms(), &delay);
        waiting.fd = line;
        waiting.events = POLLIN;
        if (poll(&waiting, 1, delay > 1000 ? 1000 : (int)delay) > 0) {
            uint8_t received[256];
            ssize_t length = read(line, received, sizeof received);
            if (length <= 0) {
                outcome = -1;
            } else {
                wsg_receive(&wsg, now_ms(), received, (size_t)length);
            }
        }
    }
    close(line);
    puts(outcome == 1 ? "done" : "failed");
    return outcome == 1 ? 0 : 1;
}
