/*
 * Only the parser: finds the frames among received bytes, without a session.
 *
 *     cc -I include examples/parser.c -L lib/x86_64-unknown-linux-gnu -lwsg -o parser
 *     ./parser
 */
#include <stdio.h>

#include "wsg.h"

int main(void)
{
    /* Noise, then the gripper's answer to Grip Part: E_CMD_PENDING. */
    static const uint8_t received[] = {0x00, 0xAA, 0xAA, 0xAA, 0xAA, 0x25, 0x02, 0x00, 0x1A, 0x00, 0x6D, 0x48};
    wsg_parser_t parser = {0};
    size_t at = 0, taken;
    wsg_frame_t frame;

    while (wsg_parser_push(&parser, received + at, sizeof received - at, &taken, &frame) == 1) {
        at += taken;
        if (frame.kind == WSG_FRAME_INTACT) {
            printf("%02Xh: an intact frame with %d bytes of payload\n", frame.id, frame.length);
        }
    }
    return 0;
}
