#ifndef WSG_H
#define WSG_H

/*
 * libwsg: the session with a Weiss Robotics WSG gripper.
 *
 * No heap, no clock, no I/O: the caller owns storage, bytes and time. In a main loop:
 *
 *     wsg_receive(&wsg, now_ms, bytes, length);      received bytes; events go to the callback
 *     wsg_tick(&wsg, now_ms);                        time-outs; events go to the callback
 *     while ((length = wsg_transmit(&wsg, now_ms, buffer, sizeof buffer)) > 0)
 *         send(buffer, length);                      all of them, in order
 *
 * now_ms is any millisecond counter, which may wrap. Requests such as wsg_grip_part() return at once; their outcome is an event.
 *
 * Rules for all functions:
 * - A pointer is null or points to an object of its type, or to an array of the length passed with it.
 * - An object is used by one thread or interrupt at a time. The library has no global state.
 * - Functions that return int32_t return a negative WSG_ERROR_... code on error.
 *
 * Generated from the crate wsg-c: do not edit.
 */
#include <stddef.h>
#include <stdint.h>

#define WSG_VERSION_MAJOR 0
#define WSG_VERSION_MINOR 1
#define WSG_VERSION_PATCH 0

/* Changes when a program must be compiled again. */
#define WSG_ABI_VERSION 0

/* Storage in 64-bit words. */
#define WSG_WORDS (UINTPTR_MAX > 0xFFFFFFFFu ? 104 : 80)
#define WSG_PARSER_WORDS 11
#define WSG_CAN_WORDS 16
#define WSG_FIELDBUS_WORDS (UINTPTR_MAX > 0xFFFFFFFFu ? 40 : 32)

/* Status codes (command set, appendix A). */
enum wsg_status {
    /* no error */
    WSG_E_SUCCESS = 0,
    /* function or data not available */
    WSG_E_NOT_AVAILABLE = 1,
    /* no measurement converter connected */
    WSG_E_NO_SENSOR = 2,
    /* device not initialized: the fingers are not referenced */
    WSG_E_NOT_INITIALIZED = 3,
    /* already running: the fingers move or hold a part */
    WSG_E_ALREADY_RUNNING = 4,
    /* feature currently not available */
    WSG_E_FEATURE_NOT_SUPPORTED = 5,
    /* parameters contradict each other */
    WSG_E_INCONSISTENT_DATA = 6,
    /* time-out */
    WSG_E_TIMEOUT = 7,
    /* error while reading */
    WSG_E_READ_ERROR = 8,
    /* error while writing */
    WSG_E_WRITE_ERROR = 9,
    /* out of memory */
    WSG_E_INSUFFICIENT_RESOURCES = 10,
    /* wrong checksum */
    WSG_E_CHECKSUM_ERROR = 11,
    /* parameter given where none is expected */
    WSG_E_NO_PARAM_EXPECTED = 12,
    /* too few parameters */
    WSG_E_NOT_ENOUGH_PARAMS = 13,
    /* unknown command */
    WSG_E_CMD_UNKNOWN = 14,
    /* command format wrong, its length for example */
    WSG_E_CMD_FORMAT_ERROR = 15,
    /* access denied, in FAST STOP for example */
    WSG_E_ACCESS_DENIED = 16,
    /* interface already open */
    WSG_E_ALREADY_OPEN = 17,
    /* command failed; after Grip Part: no part found */
    WSG_E_CMD_FAILED = 18,
    /* command aborted, by Stop for example */
    WSG_E_CMD_ABORTED = 19,
    /* invalid handle */
    WSG_E_INVALID_HANDLE = 20,
    /* device or file not found */
    WSG_E_NOT_FOUND = 21,
    /* device or file not open */
    WSG_E_NOT_OPEN = 22,
    /* input or output error */
    WSG_E_IO_ERROR = 23,
    /* wrong parameter */
    WSG_E_INVALID_PARAMETER = 24,
    /* index out of bounds */
    WSG_E_INDEX_OUT_OF_BOUNDS = 25,
    /* no error: the command runs, another reply brings its result */
    WSG_E_CMD_PENDING = 26,
    /* data overrun */
    WSG_E_OVERRUN = 27,
    /* range error */
    WSG_E_RANGE_ERROR = 28,
    /* axis blocked */
    WSG_E_AXIS_BLOCKED = 29,
    /* file exists already */
    WSG_E_FILE_EXISTS = 30
};

/* Commands (command set, chapter 3). */
enum wsg_command {
    /* Loop (3.1.1) */
    WSG_COMMAND_LOOP = 0x06,
    /* Disconnect Announcement (3.1.2) */
    WSG_COMMAND_DISCONNECT_ANNOUNCEMENT = 0x07,
    /* Homing (3.2.1) */
    WSG_COMMAND_HOMING = 0x20,
    /* Pre-position Fingers (3.2.2) */
    WSG_COMMAND_PRE_POSITION = 0x21,
    /* Stop (3.2.3) */
    WSG_COMMAND_STOP = 0x22,
    /* Issue FAST STOP (3.2.4) */
    WSG_COMMAND_FAST_STOP = 0x23,
    /* Acknowledge FAST STOP (3.2.5) */
    WSG_COMMAND_ACKNOWLEDGE = 0x24,
    /* Grip Part (3.2.6) */
    WSG_COMMAND_GRIP_PART = 0x25,
    /* Release Part (3.2.7) */
    WSG_COMMAND_RELEASE_PART = 0x26,
    /* Set Acceleration (3.3.1) */
    WSG_COMMAND_SET_ACCELERATION = 0x30,
    /* Get Acceleration (3.3.2) */
    WSG_COMMAND_GET_ACCELERATION = 0x31,
    /* Set Force Limit (3.3.3) */
    WSG_COMMAND_SET_FORCE_LIMIT = 0x32,
    /* Get Force Limit (3.3.4) */
    WSG_COMMAND_GET_FORCE_LIMIT = 0x33,
    /* Set Soft Limits (3.3.5) */
    WSG_COMMAND_SET_SOFT_LIMITS = 0x34,
    /* Get Soft Limits (3.3.6) */
    WSG_COMMAND_GET_SOFT_LIMITS = 0x35,
    /* Clear Soft Limits (3.3.7) */
    WSG_COMMAND_CLEAR_SOFT_LIMITS = 0x36,
    /* Overdrive Mode (3.3.8) */
    WSG_COMMAND_OVERDRIVE_MODE = 0x37,
    /* Tare Force Sensor (3.3.9) */
    WSG_COMMAND_TARE_FORCE_SENSOR = 0x38,
    /* Get System State (3.4.1) */
    WSG_COMMAND_GET_SYSTEM_STATE = 0x40,
    /* Get Gripper State (3.4.2) */
    WSG_COMMAND_GET_GRIPPER_STATE = 0x41,
    /* Get Gripping Statistics (3.4.3) */
    WSG_COMMAND_GET_GRIPPING_STATISTICS = 0x42,
    /* Get Opening Width (3.4.4) */
    WSG_COMMAND_GET_OPENING_WIDTH = 0x43,
    /* Get Speed (3.4.5) */
    WSG_COMMAND_GET_SPEED = 0x44,
    /* Get Force (3.4.6) */
    WSG_COMMAND_GET_FORCE = 0x45,
    /* Get Temperature (3.4.7) */
    WSG_COMMAND_GET_TEMPERATURE = 0x46,
    /* Get System Information (3.5.1) */
    WSG_COMMAND_GET_SYSTEM_INFO = 0x50,
    /* Set Device Tag (3.5.2) */
    WSG_COMMAND_SET_DEVICE_TAG = 0x51,
    /* Get Device Tag (3.5.3) */
    WSG_COMMAND_GET_DEVICE_TAG = 0x52,
    /* Get System Limits (3.5.4) */
    WSG_COMMAND_GET_SYSTEM_LIMITS = 0x53,
    /* Get Finger 1 Info (3.6.1) */
    WSG_COMMAND_GET_FINGER1_INFO = 0x60,
    /* Get Finger 1 Flags (3.6.2) */
    WSG_COMMAND_GET_FINGER1_FLAGS = 0x61,
    /* Finger 1 Power Control (3.6.3) */
    WSG_COMMAND_FINGER1_POWER = 0x62,
    /* Get Finger 1 Data (3.6.4) */
    WSG_COMMAND_GET_FINGER1_DATA = 0x63,
    /* Get Finger 2 Info (3.6.5) */
    WSG_COMMAND_GET_FINGER2_INFO = 0x70,
    /* Get Finger 2 Flags (3.6.6) */
    WSG_COMMAND_GET_FINGER2_FLAGS = 0x71,
    /* Finger 2 Power Control (3.6.7) */
    WSG_COMMAND_FINGER2_POWER = 0x72,
    /* Get Finger 2 Data (3.6.8) */
    WSG_COMMAND_GET_FINGER2_DATA = 0x73
};

/* Gripper states (command set, appendix C). */
enum wsg_state {
    /* IDLE */
    WSG_STATE_IDLE = 0,
    /* GRIPPING */
    WSG_STATE_GRIPPING = 1,
    /* NO PART */
    WSG_STATE_NO_PART = 2,
    /* PART LOST */
    WSG_STATE_PART_LOST = 3,
    /* HOLDING */
    WSG_STATE_HOLDING = 4,
    /* RELEASING */
    WSG_STATE_RELEASING = 5,
    /* POSITIONING */
    WSG_STATE_POSITIONING = 6,
    /* ERROR */
    WSG_STATE_ERROR = 7
};

/* System state flags (command set, appendix B). */
enum wsg_flag {
    /* D0 */
    WSG_FLAG_REFERENCED = 0x000001,
    /* D1 */
    WSG_FLAG_MOVING = 0x000002,
    /* D2 */
    WSG_FLAG_BLOCKED_MINUS = 0x000004,
    /* D3 */
    WSG_FLAG_BLOCKED_PLUS = 0x000008,
    /* D4 */
    WSG_FLAG_SOFT_LIMIT_MINUS = 0x000010,
    /* D5 */
    WSG_FLAG_SOFT_LIMIT_PLUS = 0x000020,
    /* D6 */
    WSG_FLAG_AXIS_STOPPED = 0x000040,
    /* D7 */
    WSG_FLAG_TARGET_POS_REACHED = 0x000080,
    /* D8 */
    WSG_FLAG_OVERDRIVE_MODE = 0x000100,
    /* D9 */
    WSG_FLAG_FORCECNTL_MODE = 0x000200,
    /* D12 */
    WSG_FLAG_FAST_STOP = 0x001000,
    /* D13 */
    WSG_FLAG_TEMP_WARNING = 0x002000,
    /* D14 */
    WSG_FLAG_TEMP_FAULT = 0x004000,
    /* D15 */
    WSG_FLAG_POWER_FAULT = 0x008000,
    /* D16 */
    WSG_FLAG_CURR_FAULT = 0x010000,
    /* D17 */
    WSG_FLAG_FINGER_FAULT = 0x020000,
    /* D18 */
    WSG_FLAG_CMD_FAILURE = 0x040000,
    /* D19 */
    WSG_FLAG_SCRIPT_RUNNING = 0x080000,
    /* D20 */
    WSG_FLAG_SCRIPT_FAILURE = 0x100000
};

/* Finger flags (command set, 3.6.2). */
enum wsg_finger_flag {
    /* D0 */
    WSG_FINGER_FLAG_POWER_ON = 0x000001,
    /* D1 */
    WSG_FINGER_FLAG_CONFIG_AVAIL = 0x000002,
    /* D2 */
    WSG_FINGER_FLAG_COMM_OPEN = 0x000004,
    /* D8 */
    WSG_FINGER_FLAG_POWER_FAULT = 0x000100,
    /* D9 */
    WSG_FINGER_FLAG_COMM_FAULT = 0x000200,
    /* D10 */
    WSG_FINGER_FLAG_INIT_FAULT = 0x000400
};


/* Bit of `updates`: subscribe to the opening width. */
#define WSG_UPDATE_WIDTH 1

/* Bit of `updates`: subscribe to the finger speed. */
#define WSG_UPDATE_SPEED 2

/* Bit of `updates`: subscribe to the gripping force. */
#define WSG_UPDATE_FORCE 4

/* Maximum of every time in the configuration: one hour. */
#define WSG_CONFIG_MAX_MS 3600000

/*
 Maximum payload of a received frame in bytes: a status and a device tag. The protocol permits 65 535: longer replies, which
 only scripts, fingers and Loop have, are not received. They are counted as `oversize` in wsg_counters_t, and their request
 ends with WSG_EVENT_UNANSWERED after its time-out.
 */
#define WSG_MAX_PAYLOAD 66

/* Buffer length for wsg_transmit() that holds every request without caller-owned data. */
#define WSG_TRANSMIT_LEN 32

/* Direction of wsg_homing(): as configured in the gripper. */
#define WSG_HOMING_DEFAULT 0

/* Direction of wsg_homing(): outward, the fingers open. */
#define WSG_HOMING_POSITIVE 1

/* Direction of wsg_homing(): inward, the fingers close. */
#define WSG_HOMING_NEGATIVE 2

/* Flag of wsg_pre_position(): the width is an offset to the current one. */
#define WSG_RELATIVE 1

/* Flag of wsg_pre_position(): the motor is turned off if the fingers are blocked. Without it they clamp. */
#define WSG_STOP_ON_BLOCK 2

/* Bit of `valid`: `info` is known. */
#define WSG_KNOWN_INFO 1

/* Bit of `valid`: `limits` are known. */
#define WSG_KNOWN_LIMITS 2

/* Bit of `valid`: `flags` are known. */
#define WSG_KNOWN_FLAGS 4

/* Bit of `valid`: `state` is known. */
#define WSG_KNOWN_STATE 8

/* Bit of `valid`: `width` is known. */
#define WSG_KNOWN_WIDTH 16

/* Bit of `valid`: `speed` is known. */
#define WSG_KNOWN_SPEED 32

/* Bit of `valid`: `force` is known. */
#define WSG_KNOWN_FORCE 64

/* Bit of `valid`: `force_limit` is known. */
#define WSG_KNOWN_FORCE_LIMIT 128

/* Kind of wsg_frame_t: an intact frame. */
#define WSG_FRAME_INTACT 1

/* Kind of wsg_frame_t: a frame with a wrong checksum. Its bytes are scanned again for frames. */
#define WSG_FRAME_BAD_CHECKSUM 2

/* Kind of wsg_frame_t: the head of a frame that is too long. Its bytes are scanned again for frames. */
#define WSG_FRAME_OVERSIZE 3

/* Identifier of requests by default. The gripper replies on the next one. */
#define WSG_CAN_DEFAULT_ID 288

/* Number of CAN frames of the longest message that is sent or received. */
#define WSG_CAN_MAX_FRAMES 10

/* Length of the output image, from the PLC. */
#define WSG_FIELDBUS_OUTPUT_LEN 8

/* Length of the input image, to the PLC. */
#define WSG_FIELDBUS_INPUT_LEN 12

/* Reaction of wsg_fieldbus_silence(): the motion in progress continues. */
#define WSG_SILENCE_HOLD 0

/* Reaction of wsg_fieldbus_silence(): a motion is stopped, a held part stays held. */
#define WSG_SILENCE_STOP 1

/* Reaction of wsg_fieldbus_silence(): FAST STOP. */
#define WSG_SILENCE_FAST_STOP 2

/*
 Return values of all functions. Positive values are results: a length, a count, or 1 for "yes".

 A later version may return further negative values. Treat every negative value as an error.
 */
typedef enum {
    /* No error. */
    WSG_ERROR_NONE = 0,
    /* A pointer is null. */
    WSG_ERROR_NULL_POINTER = -1,
    /* The storage was not initialized by wsg_init(). */
    WSG_ERROR_NOT_INITIALIZED = -2,
    /* A value of the configuration is outside its range. */
    WSG_ERROR_CONFIG = -3,
    /* The function must not be called from the event callback. */
    WSG_ERROR_IN_CALLBACK = -4,
    /* The buffer is too short. Nothing was written. */
    WSG_ERROR_BUFFER_TOO_SMALL = -5,
    /* An argument is outside its range. */
    WSG_ERROR_ARGUMENT = -6,
    /* Data is too long for the message or the library. */
    WSG_ERROR_TOO_LONG = -7,
    /* A floating-point argument is infinite or NaN. */
    WSG_ERROR_NOT_FINITE = -8,
    /* A text contains a control character or a non-ASCII character. */
    WSG_ERROR_CHARACTER = -9,
    /* There is no connection. Only Stop and FAST STOP are accepted. */
    WSG_ERROR_NOT_CONNECTED = -10,
    /* A motion is running. */
    WSG_ERROR_MOTION_RUNNING = -11,
    /* A FAST STOP is not confirmed yet. */
    WSG_ERROR_FAST_STOP_RUNNING = -12,
    /* Too many requests are queued, or one with caller-owned data is still open. */
    WSG_ERROR_QUEUE_FULL = -13,
    /* The payload of a frame violates the manual. */
    WSG_ERROR_MALFORMED = -14,
    /*
     A width, speed, acceleration or force is outside the limits of the connected gripper, which wsg_known() has. Nothing was
     sent.
     */
    WSG_ERROR_OUT_OF_LIMITS = -15,
    /* Any other error. */
    WSG_ERROR_OTHER = -100
} wsg_error;

/* Kinds of events. */
typedef enum {
    /* The gripper replies, and all subscribed values are known. */
    WSG_EVENT_CONNECTED = 1,
    /* The gripper does not reply, and its state is unknown from now on. Discard unsent bytes, except a FAST STOP. */
    WSG_EVENT_DISCONNECTED = 2,
    /* A requested motion has begun. */
    WSG_EVENT_PENDING = 3,
    /* The final reply to a request: `status`, and on WSG_E_SUCCESS the value. */
    WSG_EVENT_ANSWERED = 4,
    /* A request was sent, and its outcome is unknown. */
    WSG_EVENT_UNANSWERED = 5,
    /* The reply to a Stop is late and the Stop is repeated: the fingers may still move. */
    WSG_EVENT_LATE = 6,
    /* A request was not sent and will not be sent. */
    WSG_EVENT_WITHDRAWN = 7,
    /* The gripper reported a value of its own accord. */
    WSG_EVENT_REPORTED = 8
} wsg_event;

/* Kinds of values: the member of wsg_value_t to read. */
typedef enum {
    /* No value. */
    WSG_VALUE_NONE = 0,
    /* `number`, in mm, mm/s, mm/s² or N, depending on the command. */
    WSG_VALUE_NUMBER = 1,
    /* `flags`: system state flags (WSG_FLAG_...), or finger flags (WSG_FINGER_FLAG_...) for Get Finger Flags. */
    WSG_VALUE_FLAGS = 2,
    /* `state`: WSG_STATE_... */
    WSG_VALUE_STATE = 3,
    /* `soft_limits`. */
    WSG_VALUE_SOFT_LIMITS = 4,
    /* `statistics`. */
    WSG_VALUE_STATISTICS = 5,
    /* `temperature`. */
    WSG_VALUE_TEMPERATURE = 6,
    /* `info`. */
    WSG_VALUE_INFO = 7,
    /* `limits`. */
    WSG_VALUE_LIMITS = 8,
    /* `finger`. */
    WSG_VALUE_FINGER = 9,
    /* `bytes`: echoed data, a device tag, finger data, or the reply to a custom request. */
    WSG_VALUE_BYTES = 10
} wsg_value;

/* Time-outs and subscriptions of a session. Times are in milliseconds, from 1 to WSG_CONFIG_MAX_MS. */
typedef struct {
    /* Time-out for the first reply to a request. Default: 200. */
    uint32_t reply_timeout_ms;
    /* Polling period of each subscribed value, in addition to automatic updates. Default: 500. */
    uint32_t refresh_ms;
    /* Delay before the next attempt to connect. Default: 600. */
    uint32_t reconnect_ms;
    /* Time-out for the result of a motion. Default: 60 000. */
    uint32_t motion_timeout_ms;
    /* Time-out for the result of a motion after the gripper reports standstill. Default: 1 000. */
    uint32_t result_grace_ms;
    /* Time-out for the reply to a FAST STOP before it is repeated in bursts. Default: 30. */
    uint32_t fast_stop_answer_ms;
    /* Silence after a burst of FAST STOP frames. Default: 600. */
    uint32_t fast_stop_pause_ms;
    /* Time-out for the next byte of an incomplete frame. Default: 20. */
    uint16_t frame_timeout_ms;
    /* Number of FAST STOP frames in a burst, at least 1. Default: 130. */
    uint16_t fast_stop_burst_frames;
    /* Minimum time between two automatic updates of a value, 10 to 65 535. Default: 10. */
    uint16_t update_period_ms;
    /* Number of times a repeatable request is sent before the connection counts as lost, at least 1. Default: 3. */
    uint8_t attempts;
    /* Values to subscribe to in addition to the two states: WSG_UPDATE_WIDTH, WSG_UPDATE_SPEED, WSG_UPDATE_FORCE. Default: 0. */
    uint8_t updates;
    /*
     1 to read Set Acceleration, Set Force Limit and Set Soft Limits back, 0 (default) to trust their replies. A
     different value is reported as WSG_E_WRITE_ERROR.
     */
    uint8_t verify_settings;
    /* Must be 0. */
    uint8_t reserved[3];
} wsg_config_t;

/*
 A session with one gripper, owned by the caller. Initialize it with wsg_init().

 It contains no pointer to itself: it may lie anywhere, and a copy of it is a second session.
 */
typedef struct {
    /* Private. */
    uint64_t opaque[WSG_WORDS];
} wsg_t;

/* Permitted range of the opening width (command set, 3.3.6). */
typedef struct {
    /* Minimum opening width in mm. */
    float minus;
    /* Maximum opening width in mm. */
    float plus;
} wsg_soft_limits_t;

/* Grip counters (command set, 3.4.3). */
typedef struct {
    /* Total number of grips. */
    uint32_t total;
    /* Number of grips that found no part. */
    uint16_t no_part;
    /* Number of grips whose part was lost before release. */
    uint16_t part_lost;
} wsg_statistics_t;

/* Device type, versions and serial number (command set, 3.5.1). */
typedef struct {
    /* Product type: 0 unknown, 1 WSG 50, 2 WSG 32, 3 KMS 40, 4 WTS, 5 WSG 25, 6 WSG 70. */
    uint8_t device;
    /* Hardware revision. */
    uint8_t hardware_revision;
    /* Firmware version: four bits each of major, minor 1, minor 2 and release candidate (0 for a release). */
    uint16_t firmware;
    /* Serial number. */
    uint32_t serial_number;
} wsg_system_info_t;

/* Physical limits (command set, 3.5.4). Forces are the sum over both fingers. */
typedef struct {
    /* Maximum stroke in mm. */
    float stroke;
    /* Minimum speed in mm/s. */
    float min_speed;
    /* Maximum speed in mm/s. */
    float max_speed;
    /* Minimum acceleration in mm/s². */
    float min_acceleration;
    /* Maximum acceleration in mm/s². */
    float max_acceleration;
    /* Minimum gripping force in N. */
    float min_force;
    /* Nominal gripping force in N, at a duty cycle of 100 %. */
    float nominal_force;
    /* Maximum gripping force in overdrive mode, in N. */
    float overdrive_force;
} wsg_system_limits_t;

/* The device at a finger's sensor port (command set, 3.6.1). */
typedef struct {
    /* Always 0. */
    uint8_t reserved;
    /* Type of the finger: 0 generic or none, 1 WSG-FMF, 2 WSG-DSA. */
    uint8_t finger;
    /* Length of one data frame in bytes; 0 if the finger provides no data. */
    uint16_t data_len;
} wsg_finger_info_t;

/* Bytes in the memory of the library. They are valid until the event callback returns. */
typedef struct {
    /* The first byte. Not NUL-terminated, and null if a queue could not keep the bytes. */
    const uint8_t *data;
    /* Number of bytes. */
    uint16_t length;
} wsg_bytes_t;

/* The value of a reply or report. `value_kind` of the event selects the member. */
typedef union {
    /* WSG_VALUE_NUMBER. */
    float number;
    /* WSG_VALUE_FLAGS. */
    uint32_t flags;
    /* WSG_VALUE_STATE. */
    uint8_t state;
    /* WSG_VALUE_TEMPERATURE: in 0.1 °C. */
    int16_t temperature;
    /* WSG_VALUE_SOFT_LIMITS. */
    wsg_soft_limits_t soft_limits;
    /* WSG_VALUE_STATISTICS. */
    wsg_statistics_t statistics;
    /* WSG_VALUE_INFO. */
    wsg_system_info_t info;
    /* WSG_VALUE_LIMITS. */
    wsg_system_limits_t limits;
    /* WSG_VALUE_FINGER. */
    wsg_finger_info_t finger;
    /* WSG_VALUE_BYTES. */
    wsg_bytes_t bytes;
    /* Private. */
    uint8_t payload[32];
} wsg_value_t;

/* An event of a session. */
typedef struct {
    /* WSG_EVENT_... */
    uint8_t kind;
    /* WSG_COMMAND_... of the request or value; 0 for WSG_EVENT_CONNECTED and WSG_EVENT_DISCONNECTED. */
    uint8_t command;
    /* WSG_E_... of WSG_EVENT_ANSWERED. WSG_E_CMD_PENDING of WSG_EVENT_PENDING. Otherwise 0. */
    uint16_t status;
    /* WSG_VALUE_...: the member of `value`. */
    uint8_t value_kind;
    /* The value, if there is one. */
    wsg_value_t value;
} wsg_event_t;

/*
 Receives each event. `event` is valid until the function returns.

 The function may make requests, which the next wsg_tick() and wsg_transmit() send, and read the known state. Functions
 that receive, tick, transmit or disconnect return WSG_ERROR_IN_CALLBACK.
 */
typedef void (*wsg_callback_t)(void *context, const wsg_event_t *event);

/* The known state of the gripper. Nothing is known without a connection. */
typedef struct {
    /* System state flags: WSG_FLAG_... */
    uint32_t flags;
    /* Opening width in mm. */
    float width;
    /* Finger speed in mm/s. */
    float speed;
    /* Gripping force in N, summed over both fingers. */
    float force;
    /* Force limit in N, known after it was set and read back (`verify_settings`). */
    float force_limit;
    /* Device type, versions and serial number. */
    wsg_system_info_t info;
    /* Physical limits of the gripper (53h). */
    wsg_system_limits_t limits;
    /* The known values: WSG_KNOWN_... Unknown values are 0. */
    uint8_t valid;
    /* Gripper state: WSG_STATE_... */
    uint8_t state;
    /* 1 while the gripper is connected. */
    uint8_t connected;
    /* WSG_COMMAND_... of the requested motion whose result is outstanding, or 0. */
    uint8_t motion;
    /* 1 while a request is queued, or its first reply is outstanding. */
    uint8_t busy;
    /* 1 while a FAST STOP was requested and is not confirmed. */
    uint8_t fast_stop_pending;
} wsg_known_t;

/* Counters of rejected input, retries and disconnects. Each saturates at 65 535. */
typedef struct {
    /* Received bytes that were not part of an intact frame. */
    uint16_t dropped;
    /* Frames with a wrong checksum. */
    uint16_t bad_checksum;
    /* Frames with more than WSG_MAX_PAYLOAD bytes of payload. */
    uint16_t oversize;
    /* Replies that were unsolicited or too late. */
    uint16_t unsolicited;
    /* Frames whose content violates the manual. */
    uint16_t refused;
    /* Requests sent again after a time-out. */
    uint16_t repeated;
    /* Lost connections since wsg_init; stops at 65535. */
    uint16_t disconnects;
} wsg_counters_t;

/*
 A queue of events, owned by the caller, of which all members are private. Pass wsg_queue_push() as the callback and the
 queue as its context: `wsg_init(&wsg, NULL, wsg_queue_push, &queue)`.
 */
typedef struct {
    /* Private. */
    wsg_event_t *events;
    /* Private. */
    uint8_t *bytes;
    /* Private. */
    size_t bytes_size;
    /* Private. */
    uint16_t capacity;
    /* Private. */
    uint16_t count;
    /* Private. */
    uint16_t lost;
    /* Private. */
    uint8_t bytes_state;
} wsg_queue_t;

/*
 A parser for frames with up to WSG_MAX_PAYLOAD bytes of payload, owned by the caller. All bytes 0 are an initialized
 parser.
 */
typedef struct {
    /* Private. */
    uint64_t opaque[WSG_PARSER_WORDS];
} wsg_parser_t;

/* A frame found by a parser. */
typedef struct {
    /* The payload of an intact frame, valid until the next call with the same parser; otherwise null. */
    const uint8_t *payload;
    /* Length of the payload in bytes. */
    uint16_t length;
    /* Command id. */
    uint8_t id;
    /* WSG_FRAME_... */
    uint8_t kind;
} wsg_frame_t;

/* Reassembles messages from CAN frames, owned by the caller. Initialize it with wsg_can_init(). */
typedef struct {
    /* Private. */
    uint64_t opaque[WSG_CAN_WORDS];
} wsg_can_t;

/* A classic CAN data frame with an 11-bit identifier. */
typedef struct {
    /* Identifier, 11 bits. */
    uint16_t id;
    /* Number of data bytes, up to 8. */
    uint8_t length;
    /* Data bytes; only the first `length` are sent. */
    uint8_t data[8];
} wsg_can_frame_t;

/* Counters of rejected CAN frames and messages. Each saturates at 65 535. */
typedef struct {
    /* Frames that cannot be part of a reply: other identifiers, or no data. */
    uint16_t foreign;
    /* Frames that were not part of an intact message. */
    uint16_t dropped;
    /* Messages with a frame whose length contradicts the size field: a frame was lost or duplicated. */
    uint16_t miscut;
    /* Messages with a wrong checksum. */
    uint16_t bad_checksum;
    /* Messages of more than WSG_CAN_MAX_FRAMES frames. */
    uint16_t oversize;
    /* Incomplete messages discarded after the time-out of 50 ms. */
    uint16_t expired;
} wsg_can_counters_t;

/* The controller of the register interface, owned by the caller. Attach it to a session with wsg_fieldbus_attach(). */
typedef struct {
    /* Private. */
    uint64_t opaque[WSG_FIELDBUS_WORDS];
} wsg_fieldbus_t;

#ifdef __cplusplus
extern "C" {
#endif /* __cplusplus */

/* Writes the default configuration: a serial line at 115 200 bit/s, subscribed to the two states only. */
int32_t wsg_config_default(wsg_config_t *config);

/*
 Initializes a session, which begins to connect with the first wsg_tick(). `config` may be null for the defaults.
 `callback` receives all events and may be null; `context` is passed to it.

 Initializing a session again discards it without an event.
 */
int32_t wsg_init(wsg_t *wsg, const wsg_config_t *config, wsg_callback_t callback, void *context);

/* Takes bytes from the gripper and passes each resulting event to the callback. Call it with any number of bytes. */
int32_t wsg_receive(wsg_t *wsg, uint32_t now_ms, const uint8_t *bytes, size_t length);

/*
 Processes time-outs, opens the next request, and passes each resulting event to the callback. Call it after
 wsg_receive(), after requests, and at the latest when wsg_next_deadline() expires.
 */
int32_t wsg_tick(wsg_t *wsg, uint32_t now_ms);

/*
 Ends an incomplete frame at once, for a caller that knows that the line is idle. wsg_tick() does so after the time-out
 of the configuration.
 */
int32_t wsg_expire(wsg_t *wsg, uint32_t now_ms);

/*
 Writes the next message to `buffer` and returns its length, or 0 if there is nothing to send. The message counts as
 sent. Call it after wsg_tick() until it returns 0, and send all messages in order.

 `size` must be at least WSG_TRANSMIT_LEN, and at least 8 bytes more than the caller-owned data of an open request.
 Otherwise the result is WSG_ERROR_BUFFER_TOO_SMALL, and the message remains to be sent.
 */
int32_t wsg_transmit(wsg_t *wsg, uint32_t now_ms, uint8_t *buffer, size_t size);

/*
 Writes the time until the next call of wsg_tick() is due, in milliseconds, and returns 1. Returns 0 if no call is due
 unless something else happens. After a request, call wsg_tick() at once.
 */
int32_t wsg_next_deadline(const wsg_t *wsg, uint32_t now_ms, uint32_t *delay_ms);

/*
 Closes the connection because the caller has lost or reopened the line. The next wsg_tick() reports the outcome of open
 requests, then the session reconnects. An unconfirmed FAST STOP is sent again.
 */
int32_t wsg_disconnect(wsg_t *wsg);

/* Cancels every unsent request without an event, and releases caller-owned data. Stop and FAST STOP are kept. */
int32_t wsg_withdraw(wsg_t *wsg);

/*
 Loop (06h): the gripper echoes `length` bytes, at most 64.

 The data must stay valid and unchanged until the final event of the request, or until wsg_withdraw() or wsg_init(). At
 most one request with such data is open at a time; a further one returns WSG_ERROR_QUEUE_FULL.
 */
int32_t wsg_loop(wsg_t *wsg, const uint8_t *data, size_t length);

/* Disconnect Announcement (07h): announces the end of a TCP connection, so that it does not cause a FAST STOP. */
int32_t wsg_disconnect_announcement(wsg_t *wsg);

/* Homing (20h): references the fingers at an end stop. `direction` is WSG_HOMING_... */
int32_t wsg_homing(wsg_t *wsg, uint8_t direction);

/*
 Pre-position Fingers (21h): moves to an opening width in mm, or by an offset, at `speed` in mm/s. `flags` is 0 or a
 combination of WSG_RELATIVE and WSG_STOP_ON_BLOCK.
 */
int32_t wsg_pre_position(wsg_t *wsg, uint8_t flags, float width, float speed);

/*
 Stop (22h): stops any finger movement. Overtakes and withdraws all queued requests. Without a connection it is sent
 once, immediately.
 */
int32_t wsg_stop(wsg_t *wsg);

/*
 FAST STOP (23h): stops any finger movement as fast as possible and locks motion until wsg_acknowledge(). It is sent
 before everything else and repeated until the gripper confirms it, even across a reconnect.
 */
int32_t wsg_fast_stop(wsg_t *wsg);

/* Acknowledge FAST STOP (24h): acknowledges a FAST STOP or a fault and unlocks motion. */
int32_t wsg_acknowledge(wsg_t *wsg);

/* Grip Part (25h): grips a part of a nominal `width` in mm at `speed` in mm/s with the current force limit. */
int32_t wsg_grip_part(wsg_t *wsg, float width, float speed);

/* Release Part (26h): opens the fingers to `width` in mm at `speed` in mm/s. */
int32_t wsg_release_part(wsg_t *wsg, float width, float speed);

/* Set Acceleration (30h), in mm/s². */
int32_t wsg_set_acceleration(wsg_t *wsg, float acceleration);

/* Get Acceleration (31h): WSG_VALUE_NUMBER in mm/s². */
int32_t wsg_get_acceleration(wsg_t *wsg);

/* Set Force Limit (32h), in N, summed over both fingers. */
int32_t wsg_set_force_limit(wsg_t *wsg, float force);

/* Get Force Limit (33h): WSG_VALUE_NUMBER in N. */
int32_t wsg_get_force_limit(wsg_t *wsg);

/* Set Soft Limits (34h): the permitted range of the opening width in mm. */
int32_t wsg_set_soft_limits(wsg_t *wsg, float minus, float plus);

/* Get Soft Limits (35h): WSG_VALUE_SOFT_LIMITS. */
int32_t wsg_get_soft_limits(wsg_t *wsg);

/* Clear Soft Limits (36h). */
int32_t wsg_clear_soft_limits(wsg_t *wsg);

/* Overdrive Mode (37h): 1 permits forces up to the overdrive limit, 0 up to the nominal force. */
int32_t wsg_overdrive_mode(wsg_t *wsg, uint8_t enabled);

/* Tare Force Sensor (38h): zeroes the force sensor. */
int32_t wsg_tare_force_sensor(wsg_t *wsg);

/* Get System State (40h): WSG_VALUE_FLAGS. The session polls it anyway; see wsg_known(). */
int32_t wsg_get_system_state(wsg_t *wsg);

/* Get Gripper State (41h): WSG_VALUE_STATE. The session polls it anyway; see wsg_known(). */
int32_t wsg_get_gripper_state(wsg_t *wsg);

/* Get Gripping Statistics (42h): WSG_VALUE_STATISTICS. `reset` of 1 resets the counters, 0 keeps them. */
int32_t wsg_get_gripping_statistics(wsg_t *wsg, uint8_t reset);

/* Get Opening Width (43h): WSG_VALUE_NUMBER in mm. */
int32_t wsg_get_opening_width(wsg_t *wsg);

/* Get Speed (44h): WSG_VALUE_NUMBER in mm/s. */
int32_t wsg_get_speed(wsg_t *wsg);

/* Get Force (45h): WSG_VALUE_NUMBER in N, summed over both fingers. */
int32_t wsg_get_force(wsg_t *wsg);

/* Get Temperature (46h): WSG_VALUE_TEMPERATURE. */
int32_t wsg_get_temperature(wsg_t *wsg);

/* Get System Information (50h): WSG_VALUE_INFO. The session queries it when it connects; see wsg_known(). */
int32_t wsg_get_system_info(wsg_t *wsg);

/*
 Set Device Tag (51h): up to 64 printable ASCII characters, NUL-terminated. The text must stay valid as described at
 wsg_loop().
 */
int32_t wsg_set_device_tag(wsg_t *wsg, const char *tag);

/* Get Device Tag (52h): WSG_VALUE_BYTES. */
int32_t wsg_get_device_tag(wsg_t *wsg);

/* Get System Limits (53h): WSG_VALUE_LIMITS. The session queries them when it connects; see wsg_known(). */
int32_t wsg_get_system_limits(wsg_t *wsg);

/* Get Finger Info (60h, 70h) of `finger` 1 or 2: WSG_VALUE_FINGER. */
int32_t wsg_get_finger_info(wsg_t *wsg, uint8_t finger);

/* Get Finger Flags (61h, 71h) of `finger` 1 or 2: WSG_VALUE_FLAGS. */
int32_t wsg_get_finger_flags(wsg_t *wsg, uint8_t finger);

/* Finger Power Control (62h, 72h): switches the supply of `finger` 1 or 2 on (1) or off (0). */
int32_t wsg_finger_power(wsg_t *wsg, uint8_t finger, uint8_t enabled);

/*
 Get Finger Data (63h, 73h) of `finger` 1 or 2: WSG_VALUE_BYTES. Data frames of more than 64 bytes are not received; see
 WSG_MAX_PAYLOAD.
 */
int32_t wsg_get_finger_data(wsg_t *wsg, uint8_t finger);

/*
 A command of a script on the gripper, with up to 64 bytes of payload: WSG_VALUE_BYTES. The session treats it as a motion
 and never repeats it. The data must stay valid as described at wsg_loop().

 Returns WSG_ERROR_ARGUMENT for the id of a command of the manual, and WSG_ERROR_TOO_LONG for more data. A reply with more
 than 64 bytes after its status is not received; see WSG_MAX_PAYLOAD.
 */
int32_t wsg_custom(wsg_t *wsg, uint8_t id, const uint8_t *data, size_t length);

/*
 Subscribes to a value: WSG_COMMAND_GET_SYSTEM_STATE, _GRIPPER_STATE, _OPENING_WIDTH, _SPEED or _FORCE. The gripper reports
 it every `period_ms` milliseconds (at least 10), or with `on_change` of 1 on a change only. A period of 0 ends the
 subscription. The session restores subscriptions after a reconnect.
 */
int32_t wsg_subscribe(wsg_t *wsg, uint8_t command, uint16_t period_ms, uint8_t on_change);

/* Writes the known state of the gripper. */
int32_t wsg_known(const wsg_t *wsg, wsg_known_t *known);

/* Writes the counters of parser and session. */
int32_t wsg_counters(const wsg_t *wsg, wsg_counters_t *counters);

/*
 Initializes a queue for `capacity` events, at least 1. `bytes` holds the data of one event with WSG_VALUE_BYTES from the
 time it is queued until the wsg_queue_pop() after the one that returned it; with a null pointer such events have no
 data.
 */
int32_t wsg_queue_init(wsg_queue_t *queue, wsg_event_t *events, uint16_t capacity, uint8_t *bytes, size_t bytes_size);

/*
 Appends an event; the callback for wsg_init(), with the queue as context. If the queue is full, the oldest
 WSG_EVENT_REPORTED makes room, or else the new event is lost.
 */
void wsg_queue_push(void *queue, const wsg_event_t *event);

/* Removes the oldest event, writes it to `event` and returns 1. Returns 0 if the queue is empty. */
int32_t wsg_queue_pop(wsg_queue_t *queue, wsg_event_t *event);

/* Returns the number of events and of data of events that were lost, up to 65 535. */
int32_t wsg_queue_lost(const wsg_queue_t *queue);

/* Initializes a parser, or resets one that holds part of a frame. */
int32_t wsg_parser_init(wsg_parser_t *parser);

/*
 Takes bytes up to the first frame. Writes the number of bytes taken to `taken`, and the frame to `frame`. Returns 1 if there is
 a frame. Call it with the remaining bytes until it returns 0.
 */
int32_t wsg_parser_push(wsg_parser_t *parser, const uint8_t *bytes, size_t length, size_t *taken, wsg_frame_t *frame);

/*
 Ends an incomplete frame after a time-out. Returns 1 if its bytes contain another frame, which is written to `frame`. Call
 it until it returns 0.
 */
int32_t wsg_parser_expire(wsg_parser_t *parser, wsg_frame_t *frame);

/* Encodes a frame with this command id and payload into `buffer`. Returns its length: 8 bytes more than the payload. */
int32_t wsg_frame_encode(uint8_t id, const uint8_t *payload, size_t payload_length, uint8_t *buffer, size_t size);

/*
 Decodes an intact frame as a reply of a gripper: writes a WSG_EVENT_ANSWERED whose bytes are in the frame's payload.
 Returns WSG_ERROR_MALFORMED if the frame violates the manual.
 */
int32_t wsg_reply_decode(const wsg_frame_t *frame, wsg_event_t *event);

/*
 Initializes a reassembler for the gripper that receives requests on `id` (WSG_CAN_DEFAULT_ID unless configured) and replies
 on `id` + 1, up to 0x7FE.
 */
int32_t wsg_can_init(wsg_can_t *can, uint16_t id);

/*
 Splits a message from wsg_transmit() into CAN frames with identifier `id`, and returns their number, up to
 WSG_CAN_MAX_FRAMES. Send all of them in order before the frames of the next message.
 */
int32_t wsg_can_split(uint16_t id, const uint8_t *message, size_t message_length, wsg_can_frame_t *frames, size_t capacity);

/*
 Takes a CAN frame with any identifier, and passes each resulting event to the callback of the session. The
 callback must not use the reassembler.
 */
int32_t wsg_can_receive(wsg_can_t *can, wsg_t *wsg, uint32_t now_ms, const wsg_can_frame_t *frame);

/* Discards an incomplete message after its time-out. Call it with each wsg_tick(). */
int32_t wsg_can_tick(wsg_can_t *can, wsg_t *wsg, uint32_t now_ms);

/* Writes the counters of discarded frames and messages. */
int32_t wsg_can_counters(wsg_can_t *can, wsg_can_counters_t *counters);

/*
 Initializes a controller and attaches it to a session, after wsg_init() and before the first wsg_tick(). It receives every
 event before the callback, and subscribes to width and force. Initialize the session with `verify_settings` of 1.

 The controller must stay at its place as long as the session is used. Do not send motions of your own.
 */
int32_t wsg_fieldbus_attach(wsg_fieldbus_t *fieldbus, wsg_t *wsg);

/*
 Takes an output image that the PLC wrote, complete: exactly WSG_FIELDBUS_OUTPUT_LEN bytes. Call it for each image, so that
 no edge is lost; the next wsg_tick() requests the commands.
 */
int32_t wsg_fieldbus_write(wsg_fieldbus_t *fieldbus, const wsg_t *wsg, const uint8_t *image, size_t image_length);

/* Writes the input image for the PLC to `image` and returns its length, WSG_FIELDBUS_INPUT_LEN. */
int32_t wsg_fieldbus_read(wsg_fieldbus_t *fieldbus, const wsg_t *wsg, uint8_t *image, size_t size);

/* Reports that the PLC has become silent. `reaction` is WSG_SILENCE_... A jog ends in any case. */
int32_t wsg_fieldbus_silence(wsg_fieldbus_t *fieldbus, const wsg_t *wsg, uint8_t reaction);

/* Returns the manual's name of a status, such as "E_CMD_PENDING", or "E_?". */
const char *wsg_status_name(uint16_t status);

/* Returns the meaning of a status. */
const char *wsg_status_text(uint16_t status);

/* Returns the manual's name of a command, such as "Grip Part", or "unknown command". */
const char *wsg_command_name(uint8_t command);

/* Returns the meaning of a return value. */
const char *wsg_error_text(int32_t error);

/* Returns the version of the library, such as "0.1.0". */
const char *wsg_version(void);

#ifdef __cplusplus
}  /* extern "C" */
#endif  /* __cplusplus */

#endif  /* WSG_H */
