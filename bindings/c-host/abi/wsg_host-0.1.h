#ifndef WSG_HOST_H
#define WSG_HOST_H
#include "wsg.h"
#define WSG_HOST_TCP_PORT 1000
#define WSG_HOST_UDP_PORT 1500
#define WSG_HOST_UDP_REPLY_PORT 1501
typedef enum {
    WSG_HOST_ERROR_NONE = 0,
    WSG_HOST_ERROR_NULL_POINTER = -1,
    WSG_HOST_ERROR_ARGUMENT = -6,
    WSG_HOST_ERROR_TOO_LONG = -7,
    WSG_HOST_ERROR_NOT_CONNECTED = -10,
    WSG_HOST_ERROR_MOTION_RUNNING = -11,
    WSG_HOST_ERROR_FAST_STOP_RUNNING = -12,
    WSG_HOST_ERROR_OUT_OF_LIMITS = -15,
    WSG_HOST_ERROR_LINE = -20,
    WSG_HOST_ERROR_CLOSED = -21,
    WSG_HOST_ERROR_UNANSWERED = -22,
    WSG_HOST_ERROR_STOPPED = -23,
    WSG_HOST_ERROR_FAST_STOPPED = -24,
    WSG_HOST_ERROR_MISMATCH = -25,
    WSG_HOST_ERROR_SYSTEM = -26,
    WSG_HOST_ERROR_QUEUE_FULL = -27,
    WSG_HOST_ERROR_ENDED = -28,
    WSG_HOST_ERROR_OTHER = -100
} wsg_host_error;
typedef struct wsg_host_stop_t wsg_host_stop_t;
typedef struct wsg_host_stream_t wsg_host_stream_t;
typedef struct wsg_host_t wsg_host_t;
typedef struct {
    uint32_t number;
    uint32_t measured_at;
    uint32_t received_at;
    float position;
    float speed;
    float force;
    uint32_t flags;
    float set_point;
} wsg_host_sample_t;
#ifdef __cplusplus
extern "C" {
#endif
const char *wsg_host_error_text(int32_t error);
int32_t wsg_host_open_tcp(const char *host, uint16_t port, wsg_host_t **gripper);
int32_t wsg_host_open_udp(const char *host, uint16_t port, uint16_t reply_port, wsg_host_t **gripper);
int32_t wsg_host_open_serial(const char *device, uint32_t rate, wsg_host_t **gripper);
void wsg_host_close(wsg_host_t *gripper);
int32_t wsg_host_home(wsg_host_t *gripper, uint8_t direction);
int32_t wsg_host_move(wsg_host_t *gripper, float width, float speed);
int32_t wsg_host_grip(wsg_host_t *gripper, float width, float speed, uint8_t *held);
int32_t wsg_host_release(wsg_host_t *gripper, float width, float speed);
int32_t wsg_host_stop(wsg_host_t *gripper);
int32_t wsg_host_fast_stop(wsg_host_t *gripper);
int32_t wsg_host_acknowledge(wsg_host_t *gripper);
int32_t wsg_host_set_force_limit(wsg_host_t *gripper, float force);
int32_t wsg_host_set_acceleration(wsg_host_t *gripper, float acceleration);
int32_t wsg_host_width(wsg_host_t *gripper, float *width);
int32_t wsg_host_speed(wsg_host_t *gripper, float *speed);
int32_t wsg_host_force(wsg_host_t *gripper, float *force);
int32_t wsg_host_state(wsg_host_t *gripper, uint8_t *state);
int32_t wsg_host_flags(wsg_host_t *gripper, uint32_t *flags);
int32_t wsg_host_limits(wsg_host_t *gripper, wsg_system_limits_t *limits);
int32_t wsg_host_info(wsg_host_t *gripper, wsg_system_info_t *info);
int32_t wsg_host_raw(wsg_host_t *gripper,
                     uint8_t command,
                     const uint8_t *payload,
                     size_t payload_length,
                     uint8_t *reply,
                     size_t *reply_length);
int32_t wsg_host_stop_handle(wsg_host_t *gripper, wsg_host_stop_t **handle);
int32_t wsg_host_stop_now(const wsg_host_stop_t *handle, uint8_t fast);
void wsg_host_stop_free(wsg_host_stop_t *handle);
int32_t wsg_host_stream_start(wsg_host_t *gripper, uint16_t rate_hz, wsg_host_stream_t **stream);
int32_t wsg_host_stream_set_target(const wsg_host_stream_t *stream, float position);
int32_t wsg_host_stream_schedule(const wsg_host_stream_t *stream, float position, uint32_t at_ms);
int32_t wsg_host_stream_set_speed_limit(const wsg_host_stream_t *stream, float speed);
int32_t wsg_host_stream_set_force_limit(const wsg_host_stream_t *stream, float force);
int32_t wsg_host_stream_now(const wsg_host_stream_t *stream, uint32_t *now_ms);
int32_t wsg_host_stream_latest(const wsg_host_stream_t *stream, wsg_host_sample_t *sample);
int32_t wsg_host_stream_stop_handle(const wsg_host_stream_t *stream, wsg_host_stop_t **handle);
int32_t wsg_host_stream_end(wsg_host_stream_t *stream, wsg_host_t **gripper);
#ifdef __cplusplus
}
#endif
#endif
