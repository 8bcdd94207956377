#ifndef WSG_H
#define WSG_H
#include <stddef.h>
#include <stdint.h>
#define WSG_VERSION_MAJOR 0
#define WSG_VERSION_MINOR 1
#define WSG_VERSION_PATCH 0
#define WSG_ABI_VERSION 0
#define WSG_WORDS (UINTPTR_MAX > 0xFFFFFFFFu ? 104 : 80)
#define WSG_PARSER_WORDS 11
#define WSG_CAN_WORDS 16
#define WSG_FIELDBUS_WORDS (UINTPTR_MAX > 0xFFFFFFFFu ? 40 : 32)
enum wsg_status {
    WSG_E_SUCCESS = 0,
    WSG_E_NOT_AVAILABLE = 1,
    WSG_E_NO_SENSOR = 2,
    WSG_E_NOT_INITIALIZED = 3,
    WSG_E_ALREADY_RUNNING = 4,
    WSG_E_FEATURE_NOT_SUPPORTED = 5,
    WSG_E_INCONSISTENT_DATA = 6,
    WSG_E_TIMEOUT = 7,
    WSG_E_READ_ERROR = 8,
    WSG_E_WRITE_ERROR = 9,
    WSG_E_INSUFFICIENT_RESOURCES = 10,
    WSG_E_CHECKSUM_ERROR = 11,
    WSG_E_NO_PARAM_EXPECTED = 12,
    WSG_E_NOT_ENOUGH_PARAMS = 13,
    WSG_E_CMD_UNKNOWN = 14,
    WSG_E_CMD_FORMAT_ERROR = 15,
    WSG_E_ACCESS_DENIED = 16,
    WSG_E_ALREADY_OPEN = 17,
    WSG_E_CMD_FAILED = 18,
    WSG_E_CMD_ABORTED = 19,
    WSG_E_INVALID_HANDLE = 20,
    WSG_E_NOT_FOUND = 21,
    WSG_E_NOT_OPEN = 22,
    WSG_E_IO_ERROR = 23,
    WSG_E_INVALID_PARAMETER = 24,
    WSG_E_INDEX_OUT_OF_BOUNDS = 25,
    WSG_E_CMD_PENDING = 26,
    WSG_E_OVERRUN = 27,
    WSG_E_RANGE_ERROR = 28,
    WSG_E_AXIS_BLOCKED = 29,
    WSG_E_FILE_EXISTS = 30
};
enum wsg_command {
    WSG_COMMAND_LOOP = 0x06,
    WSG_COMMAND_DISCONNECT_ANNOUNCEMENT = 0x07,
    WSG_COMMAND_HOMING = 0x20,
    WSG_COMMAND_PRE_POSITION = 0x21,
    WSG_COMMAND_STOP = 0x22,
    WSG_COMMAND_FAST_STOP = 0x23,
    WSG_COMMAND_ACKNOWLEDGE = 0x24,
    WSG_COMMAND_GRIP_PART = 0x25,
    WSG_COMMAND_RELEASE_PART = 0x26,
    WSG_COMMAND_SET_ACCELERATION = 0x30,
    WSG_COMMAND_GET_ACCELERATION = 0x31,
    WSG_COMMAND_SET_FORCE_LIMIT = 0x32,
    WSG_COMMAND_GET_FORCE_LIMIT = 0x33,
    WSG_COMMAND_SET_SOFT_LIMITS = 0x34,
    WSG_COMMAND_GET_SOFT_LIMITS = 0x35,
    WSG_COMMAND_CLEAR_SOFT_LIMITS = 0x36,
    WSG_COMMAND_OVERDRIVE_MODE = 0x37,
    WSG_COMMAND_TARE_FORCE_SENSOR = 0x38,
    WSG_COMMAND_GET_SYSTEM_STATE = 0x40,
    WSG_COMMAND_GET_GRIPPER_STATE = 0x41,
    WSG_COMMAND_GET_GRIPPING_STATISTICS = 0x42,
    WSG_COMMAND_GET_OPENING_WIDTH = 0x43,
    WSG_COMMAND_GET_SPEED = 0x44,
    WSG_COMMAND_GET_FORCE = 0x45,
    WSG_COMMAND_GET_TEMPERATURE = 0x46,
    WSG_COMMAND_GET_SYSTEM_INFO = 0x50,
    WSG_COMMAND_SET_DEVICE_TAG = 0x51,
    WSG_COMMAND_GET_DEVICE_TAG = 0x52,
    WSG_COMMAND_GET_SYSTEM_LIMITS = 0x53,
    WSG_COMMAND_GET_FINGER1_INFO = 0x60,
    WSG_COMMAND_GET_FINGER1_FLAGS = 0x61,
    WSG_COMMAND_FINGER1_POWER = 0x62,
    WSG_COMMAND_GET_FINGER1_DATA = 0x63,
    WSG_COMMAND_GET_FINGER2_INFO = 0x70,
    WSG_COMMAND_GET_FINGER2_FLAGS = 0x71,
    WSG_COMMAND_FINGER2_POWER = 0x72,
    WSG_COMMAND_GET_FINGER2_DATA = 0x73
};
enum wsg_state {
    WSG_STATE_IDLE = 0,
    WSG_STATE_GRIPPING = 1,
    WSG_STATE_NO_PART = 2,
    WSG_STATE_PART_LOST = 3,
    WSG_STATE_HOLDING = 4,
    WSG_STATE_RELEASING = 5,
    WSG_STATE_POSITIONING = 6,
    WSG_STATE_ERROR = 7
};
enum wsg_flag {
    WSG_FLAG_REFERENCED = 0x000001,
    WSG_FLAG_MOVING = 0x000002,
    WSG_FLAG_BLOCKED_MINUS = 0x000004,
    WSG_FLAG_BLOCKED_PLUS = 0x000008,
    WSG_FLAG_SOFT_LIMIT_MINUS = 0x000010,
    WSG_FLAG_SOFT_LIMIT_PLUS = 0x000020,
    WSG_FLAG_AXIS_STOPPED = 0x000040,
    WSG_FLAG_TARGET_POS_REACHED = 0x000080,
    WSG_FLAG_OVERDRIVE_MODE = 0x000100,
    WSG_FLAG_FORCECNTL_MODE = 0x000200,
    WSG_FLAG_FAST_STOP = 0x001000,
    WSG_FLAG_TEMP_WARNING = 0x002000,
    WSG_FLAG_TEMP_FAULT = 0x004000,
    WSG_FLAG_POWER_FAULT = 0x008000,
    WSG_FLAG_CURR_FAULT = 0x010000,
    WSG_FLAG_FINGER_FAULT = 0x020000,
    WSG_FLAG_CMD_FAILURE = 0x040000,
    WSG_FLAG_SCRIPT_RUNNING = 0x080000,
    WSG_FLAG_SCRIPT_FAILURE = 0x100000
};
enum wsg_finger_flag {
    WSG_FINGER_FLAG_POWER_ON = 0x000001,
    WSG_FINGER_FLAG_CONFIG_AVAIL = 0x000002,
    WSG_FINGER_FLAG_COMM_OPEN = 0x000004,
    WSG_FINGER_FLAG_POWER_FAULT = 0x000100,
    WSG_FINGER_FLAG_COMM_FAULT = 0x000200,
    WSG_FINGER_FLAG_INIT_FAULT = 0x000400
};
#define WSG_UPDATE_WIDTH 1
#define WSG_UPDATE_SPEED 2
#define WSG_UPDATE_FORCE 4
#define WSG_CONFIG_MAX_MS 3600000
#define WSG_MAX_PAYLOAD 66
#define WSG_TRANSMIT_LEN 32
#define WSG_HOMING_DEFAULT 0
#define WSG_HOMING_POSITIVE 1
#define WSG_HOMING_NEGATIVE 2
#define WSG_RELATIVE 1
#define WSG_STOP_ON_BLOCK 2
#define WSG_KNOWN_INFO 1
#define WSG_KNOWN_LIMITS 2
#define WSG_KNOWN_FLAGS 4
#define WSG_KNOWN_STATE 8
#define WSG_KNOWN_WIDTH 16
#define WSG_KNOWN_SPEED 32
#define WSG_KNOWN_FORCE 64
#define WSG_KNOWN_FORCE_LIMIT 128
#define WSG_FRAME_INTACT 1
#define WSG_FRAME_BAD_CHECKSUM 2
#define WSG_FRAME_OVERSIZE 3
#define WSG_CAN_DEFAULT_ID 288
#define WSG_CAN_MAX_FRAMES 10
#define WSG_FIELDBUS_OUTPUT_LEN 8
#define WSG_FIELDBUS_INPUT_LEN 12
#define WSG_SILENCE_HOLD 0
#define WSG_SILENCE_STOP 1
#define WSG_SILENCE_FAST_STOP 2
typedef enum {
    WSG_ERROR_NONE = 0,
    WSG_ERROR_NULL_POINTER = -1,
    WSG_ERROR_NOT_INITIALIZED = -2,
    WSG_ERROR_CONFIG = -3,
    WSG_ERROR_IN_CALLBACK = -4,
    WSG_ERROR_BUFFER_TOO_SMALL = -5,
    WSG_ERROR_ARGUMENT = -6,
    WSG_ERROR_TOO_LONG = -7,
    WSG_ERROR_NOT_FINITE = -8,
    WSG_ERROR_CHARACTER = -9,
    WSG_ERROR_NOT_CONNECTED = -10,
    WSG_ERROR_MOTION_RUNNING = -11,
    WSG_ERROR_FAST_STOP_RUNNING = -12,
    WSG_ERROR_QUEUE_FULL = -13,
    WSG_ERROR_MALFORMED = -14,
    WSG_ERROR_OUT_OF_LIMITS = -15,
    WSG_ERROR_OTHER = -100
} wsg_error;
typedef enum {
    WSG_EVENT_CONNECTED = 1,
    WSG_EVENT_DISCONNECTED = 2,
    WSG_EVENT_PENDING = 3,
    WSG_EVENT_ANSWERED = 4,
    WSG_EVENT_UNANSWERED = 5,
    WSG_EVENT_LATE = 6,
    WSG_EVENT_WITHDRAWN = 7,
    WSG_EVENT_REPORTED = 8
} wsg_event;
typedef enum {
    WSG_VALUE_NONE = 0,
    WSG_VALUE_NUMBER = 1,
    WSG_VALUE_FLAGS = 2,
    WSG_VALUE_STATE = 3,
    WSG_VALUE_SOFT_LIMITS = 4,
    WSG_VALUE_STATISTICS = 5,
    WSG_VALUE_TEMPERATURE = 6,
    WSG_VALUE_INFO = 7,
    WSG_VALUE_LIMITS = 8,
    WSG_VALUE_FINGER = 9,
    WSG_VALUE_BYTES = 10
} wsg_value;
typedef struct {
    uint32_t reply_timeout_ms;
    uint32_t refresh_ms;
    uint32_t reconnect_ms;
    uint32_t motion_timeout_ms;
    uint32_t result_grace_ms;
    uint32_t fast_stop_answer_ms;
    uint32_t fast_stop_pause_ms;
    uint16_t frame_timeout_ms;
    uint16_t fast_stop_burst_frames;
    uint16_t update_period_ms;
    uint8_t attempts;
    uint8_t updates;
    uint8_t verify_settings;
    uint8_t reserved[3];
} wsg_config_t;
typedef struct {
    uint64_t opaque[WSG_WORDS];
} wsg_t;
typedef struct {
    float minus;
    float plus;
} wsg_soft_limits_t;
typedef struct {
    uint32_t total;
    uint16_t no_part;
    uint16_t part_lost;
} wsg_statistics_t;
typedef struct {
    uint8_t device;
    uint8_t hardware_revision;
    uint16_t firmware;
    uint32_t serial_number;
} wsg_system_info_t;
typedef struct {
    float stroke;
    float min_speed;
    float max_speed;
    float min_acceleration;
    float max_acceleration;
    float min_force;
    float nominal_force;
    float overdrive_force;
} wsg_system_limits_t;
typedef struct {
    uint8_t reserved;
    uint8_t finger;
    uint16_t data_len;
} wsg_finger_info_t;
typedef struct {
    const uint8_t *data;
    uint16_t length;
} wsg_bytes_t;
typedef union {
    float number;
    uint32_t flags;
    uint8_t state;
    int16_t temperature;
    wsg_soft_limits_t soft_limits;
    wsg_statistics_t statistics;
    wsg_system_info_t info;
    wsg_system_limits_t limits;
    wsg_finger_info_t finger;
    wsg_bytes_t bytes;
    uint8_t payload[32];
} wsg_value_t;
typedef struct {
    uint8_t kind;
    uint8_t command;
    uint16_t status;
    uint8_t value_kind;
    wsg_value_t value;
} wsg_event_t;
typedef void (*wsg_callback_t)(void *context, const wsg_event_t *event);
typedef struct {
    uint32_t flags;
    float width;
    float speed;
    float force;
    float force_limit;
    wsg_system_info_t info;
    wsg_system_limits_t limits;
    uint8_t valid;
    uint8_t state;
    uint8_t connected;
    uint8_t motion;
    uint8_t busy;
    uint8_t fast_stop_pending;
} wsg_known_t;
typedef struct {
    uint16_t dropped;
    uint16_t bad_checksum;
    uint16_t oversize;
    uint16_t unsolicited;
    uint16_t refused;
    uint16_t repeated;
    uint16_t disconnects;
} wsg_counters_t;
typedef struct {
    wsg_event_t *events;
    uint8_t *bytes;
    size_t bytes_size;
    uint16_t capacity;
    uint16_t count;
    uint16_t lost;
    uint8_t bytes_state;
} wsg_queue_t;
typedef struct {
    uint64_t opaque[WSG_PARSER_WORDS];
} wsg_parser_t;
typedef struct {
    const uint8_t *payload;
    uint16_t length;
    uint8_t id;
    uint8_t kind;
} wsg_frame_t;
typedef struct {
    uint64_t opaque[WSG_CAN_WORDS];
} wsg_can_t;
typedef struct {
    uint16_t id;
    uint8_t length;
    uint8_t data[8];
} wsg_can_frame_t;
typedef struct {
    uint16_t foreign;
    uint16_t dropped;
    uint16_t miscut;
    uint16_t bad_checksum;
    uint16_t oversize;
    uint16_t expired;
} wsg_can_counters_t;
typedef struct {
    uint64_t opaque[WSG_FIELDBUS_WORDS];
} wsg_fieldbus_t;
#ifdef __cplusplus
extern "C" {
#endif
int32_t wsg_config_default(wsg_config_t *config);
int32_t wsg_init(wsg_t *wsg, const wsg_config_t *config, wsg_callback_t callback, void *context);
int32_t wsg_receive(wsg_t *wsg, uint32_t now_ms, const uint8_t *bytes, size_t length);
int32_t wsg_tick(wsg_t *wsg, uint32_t now_ms);
int32_t wsg_expire(wsg_t *wsg, uint32_t now_ms);
int32_t wsg_transmit(wsg_t *wsg, uint32_t now_ms, uint8_t *buffer, size_t size);
int32_t wsg_next_deadline(const wsg_t *wsg, uint32_t now_ms, uint32_t *delay_ms);
int32_t wsg_disconnect(wsg_t *wsg);
int32_t wsg_withdraw(wsg_t *wsg);
int32_t wsg_loop(wsg_t *wsg, const uint8_t *data, size_t length);
int32_t wsg_disconnect_announcement(wsg_t *wsg);
int32_t wsg_homing(wsg_t *wsg, uint8_t direction);
int32_t wsg_pre_position(wsg_t *wsg, uint8_t flags, float width, float speed);
int32_t wsg_stop(wsg_t *wsg);
int32_t wsg_fast_stop(wsg_t *wsg);
int32_t wsg_acknowledge(wsg_t *wsg);
int32_t wsg_grip_part(wsg_t *wsg, float width, float speed);
int32_t wsg_release_part(wsg_t *wsg, float width, float speed);
int32_t wsg_set_acceleration(wsg_t *wsg, float acceleration);
int32_t wsg_get_acceleration(wsg_t *wsg);
int32_t wsg_set_force_limit(wsg_t *wsg, float force);
int32_t wsg_get_force_limit(wsg_t *wsg);
int32_t wsg_set_soft_limits(wsg_t *wsg, float minus, float plus);
int32_t wsg_get_soft_limits(wsg_t *wsg);
int32_t wsg_clear_soft_limits(wsg_t *wsg);
int32_t wsg_overdrive_mode(wsg_t *wsg, uint8_t enabled);
int32_t wsg_tare_force_sensor(wsg_t *wsg);
int32_t wsg_get_system_state(wsg_t *wsg);
int32_t wsg_get_gripper_state(wsg_t *wsg);
int32_t wsg_get_gripping_statistics(wsg_t *wsg, uint8_t reset);
int32_t wsg_get_opening_width(wsg_t *wsg);
int32_t wsg_get_speed(wsg_t *wsg);
int32_t wsg_get_force(wsg_t *wsg);
int32_t wsg_get_temperature(wsg_t *wsg);
int32_t wsg_get_system_info(wsg_t *wsg);
int32_t wsg_set_device_tag(wsg_t *wsg, const char *tag);
int32_t wsg_get_device_tag(wsg_t *wsg);
int32_t wsg_get_system_limits(wsg_t *wsg);
int32_t wsg_get_finger_info(wsg_t *wsg, uint8_t finger);
int32_t wsg_get_finger_flags(wsg_t *wsg, uint8_t finger);
int32_t wsg_finger_power(wsg_t *wsg, uint8_t finger, uint8_t enabled);
int32_t wsg_get_finger_data(wsg_t *wsg, uint8_t finger);
int32_t wsg_custom(wsg_t *wsg, uint8_t id, const uint8_t *data, size_t length);
int32_t wsg_subscribe(wsg_t *wsg, uint8_t command, uint16_t period_ms, uint8_t on_change);
int32_t wsg_known(const wsg_t *wsg, wsg_known_t *known);
int32_t wsg_counters(const wsg_t *wsg, wsg_counters_t *counters);
int32_t wsg_queue_init(wsg_queue_t *queue, wsg_event_t *events, uint16_t capacity, uint8_t *bytes, size_t bytes_size);
void wsg_queue_push(void *queue, const wsg_event_t *event);
int32_t wsg_queue_pop(wsg_queue_t *queue, wsg_event_t *event);
int32_t wsg_queue_lost(const wsg_queue_t *queue);
int32_t wsg_parser_init(wsg_parser_t *parser);
int32_t wsg_parser_push(wsg_parser_t *parser, const uint8_t *bytes, size_t length, size_t *taken, wsg_frame_t *frame);
int32_t wsg_parser_expire(wsg_parser_t *parser, wsg_frame_t *frame);
int32_t wsg_frame_encode(uint8_t id, const uint8_t *payload, size_t payload_length, uint8_t *buffer, size_t size);
int32_t wsg_reply_decode(const wsg_frame_t *frame, wsg_event_t *event);
int32_t wsg_can_init(wsg_can_t *can, uint16_t id);
int32_t wsg_can_split(uint16_t id, const uint8_t *message, size_t message_length, wsg_can_frame_t *frames, size_t capacity);
int32_t wsg_can_receive(wsg_can_t *can, wsg_t *wsg, uint32_t now_ms, const wsg_can_frame_t *frame);
int32_t wsg_can_tick(wsg_can_t *can, wsg_t *wsg, uint32_t now_ms);
int32_t wsg_can_counters(wsg_can_t *can, wsg_can_counters_t *counters);
int32_t wsg_fieldbus_attach(wsg_fieldbus_t *fieldbus, wsg_t *wsg);
int32_t wsg_fieldbus_write(wsg_fieldbus_t *fieldbus, const wsg_t *wsg, const uint8_t *image, size_t image_length);
int32_t wsg_fieldbus_read(wsg_fieldbus_t *fieldbus, const wsg_t *wsg, uint8_t *image, size_t size);
int32_t wsg_fieldbus_silence(wsg_fieldbus_t *fieldbus, const wsg_t *wsg, uint8_t reaction);
const char *wsg_status_name(uint16_t status);
const char *wsg_status_text(uint16_t status);
const char *wsg_command_name(uint8_t command);
const char *wsg_error_text(int32_t error);
const char *wsg_version(void);
#ifdef __cplusplus
}
#endif
#endif
