#ifndef WSG_HOST_H
#define WSG_HOST_H

/*
 * Blocking calls for a Weiss Robotics WSG gripper over TCP, UDP or a serial port: libwsg_host, which contains libwsg.
 *
 *     wsg_host_t *gripper;
 *     if (wsg_host_open_tcp("192.168.1.20", WSG_HOST_TCP_PORT, &gripper) == 0) {
 *         wsg_host_home(gripper, WSG_HOMING_DEFAULT);
 *         wsg_host_close(gripper);
 *     }
 *
 * Rules for all functions:
 * - A pointer is null or points to an object of its type, or to an array of the length passed with it.
 * - A gripper is used by one thread at a time. Stop handles are used by any thread, and streams by several.
 * - Functions that return int32_t return 0 on success; see wsg_host_error for other values.
 *
 * Generated from the crate wsg-c-host: do not edit.
 */
#include "wsg.h"


/* Default TCP port of a gripper. */
#define WSG_HOST_TCP_PORT 1000

/* Default UDP port of a gripper. */
#define WSG_HOST_UDP_PORT 1500

/* Default port to which a gripper replies over UDP. */
#define WSG_HOST_UDP_REPLY_PORT 1501

/*
 Return values of all functions: 0 on success. A positive value is the status with which the gripper rejected or ended the
 command (WSG_E_...), for wsg_status_text(). For negative values there is wsg_host_error_text().

 A later version may return further negative values. Treat every value but 0 as an error.
 */
typedef enum {
    /* No error. */
    WSG_HOST_ERROR_NONE = 0,
    /* A pointer is null. */
    WSG_HOST_ERROR_NULL_POINTER = -1,
    /* An argument is outside its range, or a text is not UTF-8. */
    WSG_HOST_ERROR_ARGUMENT = -6,
    /* Data does not fit the message or the buffer. */
    WSG_HOST_ERROR_TOO_LONG = -7,
    /* There is no connection to the gripper. */
    WSG_HOST_ERROR_NOT_CONNECTED = -10,
    /* A motion is running. */
    WSG_HOST_ERROR_MOTION_RUNNING = -11,
    /* A FAST STOP is not confirmed yet. */
    WSG_HOST_ERROR_FAST_STOP_RUNNING = -12,
    /*
     A width, speed, acceleration or force is outside the limits of the gripper, which wsg_host_limits() returns. Nothing was
     changed.
     */
    WSG_HOST_ERROR_OUT_OF_LIMITS = -15,
    /* The line cannot be opened, or failed. */
    WSG_HOST_ERROR_LINE = -20,
    /* The gripper closed the connection. */
    WSG_HOST_ERROR_CLOSED = -21,
    /* The request was sent without a reply, so its outcome is unknown. */
    WSG_HOST_ERROR_UNANSWERED = -22,
    /* A handle has stopped the fingers during this call or since the last one. */
    WSG_HOST_ERROR_STOPPED = -23,
    /* A handle has stopped the fingers by FAST STOP. */
    WSG_HOST_ERROR_FAST_STOPPED = -24,
    /* The gripper confirmed a setting but did not apply it. */
    WSG_HOST_ERROR_MISMATCH = -25,
    /* The system has no thread or descriptor left. */
    WSG_HOST_ERROR_SYSTEM = -26,
    /* Too many set-points are queued. */
    WSG_HOST_ERROR_QUEUE_FULL = -27,
    /* The stream has ended. */
    WSG_HOST_ERROR_ENDED = -28,
    /* Any other error. */
    WSG_HOST_ERROR_OTHER = -100
} wsg_host_error;

/* A handle that stops the fingers. Free it with wsg_host_stop_free(). It may outlive the gripper, and then returns an error. */
typedef struct wsg_host_stop_t wsg_host_stop_t;

/* A gripper that follows set-points. End it with wsg_host_stream_end(). */
typedef struct wsg_host_stream_t wsg_host_stream_t;

/* A gripper that the library has opened. Close it with wsg_host_close(). */
typedef struct wsg_host_t wsg_host_t;

/* The state of the gripper at one instant. */
typedef struct {
    /* Sample number, which may wrap. */
    uint32_t number;
    /* Time of the measurement in milliseconds, on the clock of wsg_host_stream_now(). */
    uint32_t measured_at;
    /* Time of the reception. */
    uint32_t received_at;
    /* Opening width in mm. */
    float position;
    /* Finger speed in mm/s; closing is negative. */
    float speed;
    /* Gripping force in N, summed over both fingers. */
    float force;
    /* System state flags: WSG_FLAG_... */
    uint32_t flags;
    /* The last commanded position in mm, or NaN before the first set-point. */
    float set_point;
} wsg_host_sample_t;

#ifdef __cplusplus
extern "C" {
#endif /* __cplusplus */

/* Returns the meaning of a return value: an error, or a status of the gripper. */
const char *wsg_host_error_text(int32_t error);

/* Connects to a gripper over TCP. `host` is a name or an address. On success `gripper` is set, otherwise it is null. */
int32_t wsg_host_open_tcp(const char *host, uint16_t port, wsg_host_t **gripper);

/* Connects over UDP. The gripper replies to `reply_port` of this computer. */
int32_t wsg_host_open_udp(const char *host, uint16_t port, uint16_t reply_port, wsg_host_t **gripper);

/* Connects over a serial port, such as /dev/ttyUSB0 or COM3, at `rate` in bit/s (115200 by default). */
int32_t wsg_host_open_serial(const char *device, uint32_t rate, wsg_host_t **gripper);

/* Closes a gripper. Over TCP it announces the end of the connection, which otherwise causes a FAST STOP. Null is accepted. */
void wsg_host_close(wsg_host_t *gripper);

/* References the fingers at an end stop and waits for the end of the motion. `direction` is WSG_HOMING_... */
int32_t wsg_host_home(wsg_host_t *gripper, uint8_t direction);

/*
 Moves the fingers to `width` in mm at `speed` in mm/s and waits for the end of the motion. Blocked fingers are an error
 (WSG_E_AXIS_BLOCKED), and the motor is off then.
 */
int32_t wsg_host_move(wsg_host_t *gripper, float width, float speed);

/* Grips a part of `width` in mm at `speed` in mm/s and waits for the result: `held` is 1 if a part is held and 0 if there was none. */
int32_t wsg_host_grip(wsg_host_t *gripper, float width, float speed, uint8_t *held);

/* Opens the fingers to `width` in mm at `speed` in mm/s and waits for the end of the motion. */
int32_t wsg_host_release(wsg_host_t *gripper, float width, float speed);

/* Stops the fingers. To stop them during another call, use wsg_host_stop_handle(). */
int32_t wsg_host_stop(wsg_host_t *gripper);

/* Stops the fingers as fast as possible and locks motion until wsg_host_acknowledge(). */
int32_t wsg_host_fast_stop(wsg_host_t *gripper);

/* Acknowledges a FAST STOP or a fault and unlocks motion. */
int32_t wsg_host_acknowledge(wsg_host_t *gripper);

/* Sets the force limit in N, summed over both fingers. */
int32_t wsg_host_set_force_limit(wsg_host_t *gripper, float force);

/* Sets the acceleration in mm/s². */
int32_t wsg_host_set_acceleration(wsg_host_t *gripper, float acceleration);

/* Queries the opening width in mm. */
int32_t wsg_host_width(wsg_host_t *gripper, float *width);

/* Queries the finger speed in mm/s. */
int32_t wsg_host_speed(wsg_host_t *gripper, float *speed);

/* Queries the gripping force in N, summed over both fingers. */
int32_t wsg_host_force(wsg_host_t *gripper, float *force);

/* Queries the gripper state: WSG_STATE_... */
int32_t wsg_host_state(wsg_host_t *gripper, uint8_t *state);

/* Queries the system state flags: WSG_FLAG_... */
int32_t wsg_host_flags(wsg_host_t *gripper, uint32_t *flags);

/* Queries the physical limits. */
int32_t wsg_host_limits(wsg_host_t *gripper, wsg_system_limits_t *limits);

/* Queries device type, versions and serial number. */
int32_t wsg_host_info(wsg_host_t *gripper, wsg_system_info_t *info);

/*
 Sends any command with a payload, and waits for its final reply. Writes the payload of the reply after its status to `reply`,
 and its length to `reply_length`, which holds the size of `reply` before. The lengths may be 0.

 WSG_HOST_ERROR_TOO_LONG: `payload` has more than 256 bytes, or the reply does not fit into `reply`. A reply with more than 256
 bytes after its status is not received: WSG_HOST_ERROR_UNANSWERED, as without a reply.
 */
int32_t wsg_host_raw(wsg_host_t *gripper,
                     uint8_t command,
                     const uint8_t *payload,
                     size_t payload_length,
                     uint8_t *reply,
                     size_t *reply_length);

/* Creates a handle for a gripper. */
int32_t wsg_host_stop_handle(wsg_host_t *gripper, wsg_host_stop_t **handle);

/*
 Stops the fingers now, from any thread. `fast` of 1 is a FAST STOP. The running call of the gripper, or else the next one, returns
 WSG_HOST_ERROR_STOPPED or WSG_HOST_ERROR_FAST_STOPPED.

 WSG_HOST_ERROR_LINE: the line accepts no bytes; the running call sends the stop as soon as possible.
 */
int32_t wsg_host_stop_now(const wsg_host_stop_t *handle, uint8_t fast);

/* Frees a handle. Null is accepted. */
void wsg_host_stop_free(wsg_host_stop_t *handle);

/*
 Starts to stream at `rate_hz` set-points per second, 1 to 500. The fingers must be referenced. The stream takes over the
 gripper, which must not be used any more, even after an error; wsg_host_stream_end() gives it back.
 */
int32_t wsg_host_stream_start(wsg_host_t *gripper, uint16_t rate_hz, wsg_host_stream_t **stream);

/* Sets the position in mm to move to at once, within the speed limit. It must be inside the stroke. Does not wait. */
int32_t wsg_host_stream_set_target(const wsg_host_stream_t *stream, float position);

/*
 Schedules a position in mm for the time `at_ms` on the clock of wsg_host_stream_now(), and replaces later ones. The position
 must be inside the stroke, and the time at most one hour from now. A time in the past counts as now. Does not wait.
 */
int32_t wsg_host_stream_schedule(const wsg_host_stream_t *stream, float position, uint32_t at_ms);

/* Limits the speed in mm/s. A value outside the gripper's limits is refused. */
int32_t wsg_host_stream_set_speed_limit(const wsg_host_stream_t *stream, float speed);

/* Limits the force in N. A value outside the gripper's limits is refused. */
int32_t wsg_host_stream_set_force_limit(const wsg_host_stream_t *stream, float force);

/* Writes the time of the stream's clock in milliseconds. */
int32_t wsg_host_stream_now(const wsg_host_stream_t *stream, uint32_t *now_ms);

/*
 Writes the latest sample. Its age is the time of wsg_host_stream_now() minus `measured_at`. Does not wait. After the end of
 the stream it returns WSG_HOST_ERROR_ENDED and writes nothing.
 */
int32_t wsg_host_stream_latest(const wsg_host_stream_t *stream, wsg_host_sample_t *sample);

/* Creates a handle that stops the fingers and ends the stream. */
int32_t wsg_host_stream_stop_handle(const wsg_host_stream_t *stream, wsg_host_stop_t **handle);

/*
 Stops the fingers, ends the stream and gives the gripper back. `gripper` may be null: it is closed then. Returns 0 if the stream
 ran until this call, and otherwise why it ended; the gripper is given back in either case.
 */
int32_t wsg_host_stream_end(wsg_host_stream_t *stream, wsg_host_t **gripper);

#ifdef __cplusplus
}  /* extern "C" */
#endif  /* __cplusplus */

#endif  /* WSG_HOST_H */
