/* The recorded ABI: sizes, offsets and values on 32 and on 64 bits, and functions. Generated: do not edit. */
#include "wsg_host.h"
#include "abi.h"
#if WSG_ABI_VERSION == 0
VALUE(WSG_HOST_TCP_PORT, 1000, 1000);
VALUE(WSG_HOST_UDP_PORT, 1500, 1500);
VALUE(WSG_HOST_UDP_REPLY_PORT, 1501, 1501);
VALUE(WSG_HOST_ERROR_NONE, 0, 0);
VALUE(WSG_HOST_ERROR_NULL_POINTER, -1, -1);
VALUE(WSG_HOST_ERROR_ARGUMENT, -6, -6);
VALUE(WSG_HOST_ERROR_TOO_LONG, -7, -7);
VALUE(WSG_HOST_ERROR_NOT_CONNECTED, -10, -10);
VALUE(WSG_HOST_ERROR_MOTION_RUNNING, -11, -11);
VALUE(WSG_HOST_ERROR_FAST_STOP_RUNNING, -12, -12);
VALUE(WSG_HOST_ERROR_OUT_OF_LIMITS, -15, -15);
VALUE(WSG_HOST_ERROR_LINE, -20, -20);
VALUE(WSG_HOST_ERROR_CLOSED, -21, -21);
VALUE(WSG_HOST_ERROR_UNANSWERED, -22, -22);
VALUE(WSG_HOST_ERROR_STOPPED, -23, -23);
VALUE(WSG_HOST_ERROR_FAST_STOPPED, -24, -24);
VALUE(WSG_HOST_ERROR_MISMATCH, -25, -25);
VALUE(WSG_HOST_ERROR_SYSTEM, -26, -26);
VALUE(WSG_HOST_ERROR_QUEUE_FULL, -27, -27);
VALUE(WSG_HOST_ERROR_ENDED, -28, -28);
VALUE(WSG_HOST_ERROR_OTHER, -100, -100);
SIZE(wsg_host_sample_t, 32, 32);
FIELD(wsg_host_sample_t, number, 4, 4, 0, 0);
FIELD(wsg_host_sample_t, measured_at, 4, 4, 4, 4);
FIELD(wsg_host_sample_t, received_at, 4, 4, 8, 8);
FIELD(wsg_host_sample_t, position, 4, 4, 12, 12);
FIELD(wsg_host_sample_t, speed, 4, 4, 16, 16);
FIELD(wsg_host_sample_t, force, 4, 4, 20, 20);
FIELD(wsg_host_sample_t, flags, 4, 4, 24, 24);
FIELD(wsg_host_sample_t, set_point, 4, 4, 28, 28);
FUNCTION(const char *, wsg_host_error_text, (int32_t error))
FUNCTION(int32_t, wsg_host_open_tcp, (const char *host, uint16_t port, wsg_host_t **gripper))
FUNCTION(int32_t, wsg_host_open_udp, (const char *host, uint16_t port, uint16_t reply_port, wsg_host_t **gripper))
FUNCTION(int32_t, wsg_host_open_serial, (const char *device, uint32_t rate, wsg_host_t **gripper))
FUNCTION(void, wsg_host_close, (wsg_host_t *gripper))
FUNCTION(int32_t, wsg_host_home, (wsg_host_t *gripper, uint8_t direction))
FUNCTION(int32_t, wsg_host_move, (wsg_host_t *gripper, float width, float speed))
FUNCTION(int32_t, wsg_host_grip, (wsg_host_t *gripper, float width, float speed, uint8_t *held))
FUNCTION(int32_t, wsg_host_release, (wsg_host_t *gripper, float width, float speed))
FUNCTION(int32_t, wsg_host_stop, (wsg_host_t *gripper))
FUNCTION(int32_t, wsg_host_fast_stop, (wsg_host_t *gripper))
FUNCTION(int32_t, wsg_host_acknowledge, (wsg_host_t *gripper))
FUNCTION(int32_t, wsg_host_set_force_limit, (wsg_host_t *gripper, float force))
FUNCTION(int32_t, wsg_host_set_acceleration, (wsg_host_t *gripper, float acceleration))
FUNCTION(int32_t, wsg_host_width, (wsg_host_t *gripper, float *width))
FUNCTION(int32_t, wsg_host_speed, (wsg_host_t *gripper, float *speed))
FUNCTION(int32_t, wsg_host_force, (wsg_host_t *gripper, float *force))
FUNCTION(int32_t, wsg_host_state, (wsg_host_t *gripper, uint8_t *state))
FUNCTION(int32_t, wsg_host_flags, (wsg_host_t *gripper, uint32_t *flags))
FUNCTION(int32_t, wsg_host_limits, (wsg_host_t *gripper, wsg_system_limits_t *limits))
FUNCTION(int32_t, wsg_host_info, (wsg_host_t *gripper, wsg_system_info_t *info))
FUNCTION(int32_t, wsg_host_raw, (wsg_host_t *gripper, uint8_t command, const uint8_t *payload, size_t payload_length, uint8_t *reply, size_t *reply_length))
FUNCTION(int32_t, wsg_host_stop_handle, (wsg_host_t *gripper, wsg_host_stop_t **handle))
FUNCTION(int32_t, wsg_host_stop_now, (const wsg_host_stop_t *handle, uint8_t fast))
FUNCTION(void, wsg_host_stop_free, (wsg_host_stop_t *handle))
FUNCTION(int32_t, wsg_host_stream_start, (wsg_host_t *gripper, uint16_t rate_hz, wsg_host_stream_t **stream))
FUNCTION(int32_t, wsg_host_stream_set_target, (const wsg_host_stream_t *stream, float position))
FUNCTION(int32_t, wsg_host_stream_schedule, (const wsg_host_stream_t *stream, float position, uint32_t at_ms))
FUNCTION(int32_t, wsg_host_stream_set_speed_limit, (const wsg_host_stream_t *stream, float speed))
FUNCTION(int32_t, wsg_host_stream_set_force_limit, (const wsg_host_stream_t *stream, float force))
FUNCTION(int32_t, wsg_host_stream_now, (const wsg_host_stream_t *stream, uint32_t *now_ms))
FUNCTION(int32_t, wsg_host_stream_latest, (const wsg_host_stream_t *stream, wsg_host_sample_t *sample))
FUNCTION(int32_t, wsg_host_stream_stop_handle, (const wsg_host_stream_t *stream, wsg_host_stop_t **handle))
FUNCTION(int32_t, wsg_host_stream_end, (wsg_host_stream_t *stream, wsg_host_t **gripper))
#endif
