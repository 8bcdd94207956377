/* The recorded ABI: sizes, offsets and values on 32 and on 64 bits, and functions. Generated: do not edit. */
#include "wsg.h"
#include "abi.h"
#if WSG_ABI_VERSION == 0
VALUE(WSG_ABI_VERSION, 0, 0);
VALUE(WSG_WORDS, 80, 104);
VALUE(WSG_PARSER_WORDS, 11, 11);
VALUE(WSG_CAN_WORDS, 16, 16);
VALUE(WSG_FIELDBUS_WORDS, 32, 40);
VALUE(WSG_E_SUCCESS, 0, 0);
VALUE(WSG_E_NOT_AVAILABLE, 1, 1);
VALUE(WSG_E_NO_SENSOR, 2, 2);
VALUE(WSG_E_NOT_INITIALIZED, 3, 3);
VALUE(WSG_E_ALREADY_RUNNING, 4, 4);
VALUE(WSG_E_FEATURE_NOT_SUPPORTED, 5, 5);
VALUE(WSG_E_INCONSISTENT_DATA, 6, 6);
VALUE(WSG_E_TIMEOUT, 7, 7);
VALUE(WSG_E_READ_ERROR, 8, 8);
VALUE(WSG_E_WRITE_ERROR, 9, 9);
VALUE(WSG_E_INSUFFICIENT_RESOURCES, 10, 10);
VALUE(WSG_E_CHECKSUM_ERROR, 11, 11);
VALUE(WSG_E_NO_PARAM_EXPECTED, 12, 12);
VALUE(WSG_E_NOT_ENOUGH_PARAMS, 13, 13);
VALUE(WSG_E_CMD_UNKNOWN, 14, 14);
VALUE(WSG_E_CMD_FORMAT_ERROR, 15, 15);
VALUE(WSG_E_ACCESS_DENIED, 16, 16);
VALUE(WSG_E_ALREADY_OPEN, 17, 17);
VALUE(WSG_E_CMD_FAILED, 18, 18);
VALUE(WSG_E_CMD_ABORTED, 19, 19);
VALUE(WSG_E_INVALID_HANDLE, 20, 20);
VALUE(WSG_E_NOT_FOUND, 21, 21);
VALUE(WSG_E_NOT_OPEN, 22, 22);
VALUE(WSG_E_IO_ERROR, 23, 23);
VALUE(WSG_E_INVALID_PARAMETER, 24, 24);
VALUE(WSG_E_INDEX_OUT_OF_BOUNDS, 25, 25);
VALUE(WSG_E_CMD_PENDING, 26, 26);
VALUE(WSG_E_OVERRUN, 27, 27);
VALUE(WSG_E_RANGE_ERROR, 28, 28);
VALUE(WSG_E_AXIS_BLOCKED, 29, 29);
VALUE(WSG_E_FILE_EXISTS, 30, 30);
VALUE(WSG_COMMAND_LOOP, 6, 6);
VALUE(WSG_COMMAND_DISCONNECT_ANNOUNCEMENT, 7, 7);
VALUE(WSG_COMMAND_HOMING, 32, 32);
VALUE(WSG_COMMAND_PRE_POSITION, 33, 33);
VALUE(WSG_COMMAND_STOP, 34, 34);
VALUE(WSG_COMMAND_FAST_STOP, 35, 35);
VALUE(WSG_COMMAND_ACKNOWLEDGE, 36, 36);
VALUE(WSG_COMMAND_GRIP_PART, 37, 37);
VALUE(WSG_COMMAND_RELEASE_PART, 38, 38);
VALUE(WSG_COMMAND_SET_ACCELERATION, 48, 48);
VALUE(WSG_COMMAND_GET_ACCELERATION, 49, 49);
VALUE(WSG_COMMAND_SET_FORCE_LIMIT, 50, 50);
VALUE(WSG_COMMAND_GET_FORCE_LIMIT, 51, 51);
VALUE(WSG_COMMAND_SET_SOFT_LIMITS, 52, 52);
VALUE(WSG_COMMAND_GET_SOFT_LIMITS, 53, 53);
VALUE(WSG_COMMAND_CLEAR_SOFT_LIMITS, 54, 54);
VALUE(WSG_COMMAND_OVERDRIVE_MODE, 55, 55);
VALUE(WSG_COMMAND_TARE_FORCE_SENSOR, 56, 56);
VALUE(WSG_COMMAND_GET_SYSTEM_STATE, 64, 64);
VALUE(WSG_COMMAND_GET_GRIPPER_STATE, 65, 65);
VALUE(WSG_COMMAND_GET_GRIPPING_STATISTICS, 66, 66);
VALUE(WSG_COMMAND_GET_OPENING_WIDTH, 67, 67);
VALUE(WSG_COMMAND_GET_SPEED, 68, 68);
VALUE(WSG_COMMAND_GET_FORCE, 69, 69);
VALUE(WSG_COMMAND_GET_TEMPERATURE, 70, 70);
VALUE(WSG_COMMAND_GET_SYSTEM_INFO, 80, 80);
VALUE(WSG_COMMAND_SET_DEVICE_TAG, 81, 81);
VALUE(WSG_COMMAND_GET_DEVICE_TAG, 82, 82);
VALUE(WSG_COMMAND_GET_SYSTEM_LIMITS, 83, 83);
VALUE(WSG_COMMAND_GET_FINGER1_INFO, 96, 96);
VALUE(WSG_COMMAND_GET_FINGER1_FLAGS, 97, 97);
VALUE(WSG_COMMAND_FINGER1_POWER, 98, 98);
VALUE(WSG_COMMAND_GET_FINGER1_DATA, 99, 99);
VALUE(WSG_COMMAND_GET_FINGER2_INFO, 112, 112);
VALUE(WSG_COMMAND_GET_FINGER2_FLAGS, 113, 113);
VALUE(WSG_COMMAND_FINGER2_POWER, 114, 114);
VALUE(WSG_COMMAND_GET_FINGER2_DATA, 115, 115);
VALUE(WSG_STATE_IDLE, 0, 0);
VALUE(WSG_STATE_GRIPPING, 1, 1);
VALUE(WSG_STATE_NO_PART, 2, 2);
VALUE(WSG_STATE_PART_LOST, 3, 3);
VALUE(WSG_STATE_HOLDING, 4, 4);
VALUE(WSG_STATE_RELEASING, 5, 5);
VALUE(WSG_STATE_POSITIONING, 6, 6);
VALUE(WSG_STATE_ERROR, 7, 7);
VALUE(WSG_FLAG_REFERENCED, 1, 1);
VALUE(WSG_FLAG_MOVING, 2, 2);
VALUE(WSG_FLAG_BLOCKED_MINUS, 4, 4);
VALUE(WSG_FLAG_BLOCKED_PLUS, 8, 8);
VALUE(WSG_FLAG_SOFT_LIMIT_MINUS, 16, 16);
VALUE(WSG_FLAG_SOFT_LIMIT_PLUS, 32, 32);
VALUE(WSG_FLAG_AXIS_STOPPED, 64, 64);
VALUE(WSG_FLAG_TARGET_POS_REACHED, 128, 128);
VALUE(WSG_FLAG_OVERDRIVE_MODE, 256, 256);
VALUE(WSG_FLAG_FORCECNTL_MODE, 512, 512);
VALUE(WSG_FLAG_FAST_STOP, 4096, 4096);
VALUE(WSG_FLAG_TEMP_WARNING, 8192, 8192);
VALUE(WSG_FLAG_TEMP_FAULT, 16384, 16384);
VALUE(WSG_FLAG_POWER_FAULT, 32768, 32768);
VALUE(WSG_FLAG_CURR_FAULT, 65536, 65536);
VALUE(WSG_FLAG_FINGER_FAULT, 131072, 131072);
VALUE(WSG_FLAG_CMD_FAILURE, 262144, 262144);
VALUE(WSG_FLAG_SCRIPT_RUNNING, 524288, 524288);
VALUE(WSG_FLAG_SCRIPT_FAILURE, 1048576, 1048576);
VALUE(WSG_FINGER_FLAG_POWER_ON, 1, 1);
VALUE(WSG_FINGER_FLAG_CONFIG_AVAIL, 2, 2);
VALUE(WSG_FINGER_FLAG_COMM_OPEN, 4, 4);
VALUE(WSG_FINGER_FLAG_POWER_FAULT, 256, 256);
VALUE(WSG_FINGER_FLAG_COMM_FAULT, 512, 512);
VALUE(WSG_FINGER_FLAG_INIT_FAULT, 1024, 1024);
VALUE(WSG_UPDATE_WIDTH, 1, 1);
VALUE(WSG_UPDATE_SPEED, 2, 2);
VALUE(WSG_UPDATE_FORCE, 4, 4);
VALUE(WSG_CONFIG_MAX_MS, 3600000, 3600000);
VALUE(WSG_MAX_PAYLOAD, 66, 66);
VALUE(WSG_TRANSMIT_LEN, 32, 32);
VALUE(WSG_HOMING_DEFAULT, 0, 0);
VALUE(WSG_HOMING_POSITIVE, 1, 1);
VALUE(WSG_HOMING_NEGATIVE, 2, 2);
VALUE(WSG_RELATIVE, 1, 1);
VALUE(WSG_STOP_ON_BLOCK, 2, 2);
VALUE(WSG_KNOWN_INFO, 1, 1);
VALUE(WSG_KNOWN_LIMITS, 2, 2);
VALUE(WSG_KNOWN_FLAGS, 4, 4);
VALUE(WSG_KNOWN_STATE, 8, 8);
VALUE(WSG_KNOWN_WIDTH, 16, 16);
VALUE(WSG_KNOWN_SPEED, 32, 32);
VALUE(WSG_KNOWN_FORCE, 64, 64);
VALUE(WSG_KNOWN_FORCE_LIMIT, 128, 128);
VALUE(WSG_FRAME_INTACT, 1, 1);
VALUE(WSG_FRAME_BAD_CHECKSUM, 2, 2);
VALUE(WSG_FRAME_OVERSIZE, 3, 3);
VALUE(WSG_CAN_DEFAULT_ID, 288, 288);
VALUE(WSG_CAN_MAX_FRAMES, 10, 10);
VALUE(WSG_FIELDBUS_OUTPUT_LEN, 8, 8);
VALUE(WSG_FIELDBUS_INPUT_LEN, 12, 12);
VALUE(WSG_SILENCE_HOLD, 0, 0);
VALUE(WSG_SILENCE_STOP, 1, 1);
VALUE(WSG_SILENCE_FAST_STOP, 2, 2);
VALUE(WSG_ERROR_NONE, 0, 0);
VALUE(WSG_ERROR_NULL_POINTER, -1, -1);
VALUE(WSG_ERROR_NOT_INITIALIZED, -2, -2);
VALUE(WSG_ERROR_CONFIG, -3, -3);
VALUE(WSG_ERROR_IN_CALLBACK, -4, -4);
VALUE(WSG_ERROR_BUFFER_TOO_SMALL, -5, -5);
VALUE(WSG_ERROR_ARGUMENT, -6, -6);
VALUE(WSG_ERROR_TOO_LONG, -7, -7);
VALUE(WSG_ERROR_NOT_FINITE, -8, -8);
VALUE(WSG_ERROR_CHARACTER, -9, -9);
VALUE(WSG_ERROR_NOT_CONNECTED, -10, -10);
VALUE(WSG_ERROR_MOTION_RUNNING, -11, -11);
VALUE(WSG_ERROR_FAST_STOP_RUNNING, -12, -12);
VALUE(WSG_ERROR_QUEUE_FULL, -13, -13);
VALUE(WSG_ERROR_MALFORMED, -14, -14);
VALUE(WSG_ERROR_OUT_OF_LIMITS, -15, -15);
VALUE(WSG_ERROR_OTHER, -100, -100);
VALUE(WSG_EVENT_CONNECTED, 1, 1);
VALUE(WSG_EVENT_DISCONNECTED, 2, 2);
VALUE(WSG_EVENT_PENDING, 3, 3);
VALUE(WSG_EVENT_ANSWERED, 4, 4);
VALUE(WSG_EVENT_UNANSWERED, 5, 5);
VALUE(WSG_EVENT_LATE, 6, 6);
VALUE(WSG_EVENT_WITHDRAWN, 7, 7);
VALUE(WSG_EVENT_REPORTED, 8, 8);
VALUE(WSG_VALUE_NONE, 0, 0);
VALUE(WSG_VALUE_NUMBER, 1, 1);
VALUE(WSG_VALUE_FLAGS, 2, 2);
VALUE(WSG_VALUE_STATE, 3, 3);
VALUE(WSG_VALUE_SOFT_LIMITS, 4, 4);
VALUE(WSG_VALUE_STATISTICS, 5, 5);
VALUE(WSG_VALUE_TEMPERATURE, 6, 6);
VALUE(WSG_VALUE_INFO, 7, 7);
VALUE(WSG_VALUE_LIMITS, 8, 8);
VALUE(WSG_VALUE_FINGER, 9, 9);
VALUE(WSG_VALUE_BYTES, 10, 10);
SIZE(wsg_config_t, 40, 40);
FIELD(wsg_config_t, reply_timeout_ms, 4, 4, 0, 0);
FIELD(wsg_config_t, refresh_ms, 4, 4, 4, 4);
FIELD(wsg_config_t, reconnect_ms, 4, 4, 8, 8);
FIELD(wsg_config_t, motion_timeout_ms, 4, 4, 12, 12);
FIELD(wsg_config_t, result_grace_ms, 4, 4, 16, 16);
FIELD(wsg_config_t, fast_stop_answer_ms, 4, 4, 20, 20);
FIELD(wsg_config_t, fast_stop_pause_ms, 4, 4, 24, 24);
FIELD(wsg_config_t, frame_timeout_ms, 2, 2, 28, 28);
FIELD(wsg_config_t, fast_stop_burst_frames, 2, 2, 30, 30);
FIELD(wsg_config_t, update_period_ms, 2, 2, 32, 32);
FIELD(wsg_config_t, attempts, 1, 1, 34, 34);
FIELD(wsg_config_t, updates, 1, 1, 35, 35);
FIELD(wsg_config_t, verify_settings, 1, 1, 36, 36);
FIELD(wsg_config_t, reserved, 3, 3, 37, 37);
SIZE(wsg_t, 640, 832);
FIELD(wsg_t, opaque, 640, 832, 0, 0);
SIZE(wsg_soft_limits_t, 8, 8);
FIELD(wsg_soft_limits_t, minus, 4, 4, 0, 0);
FIELD(wsg_soft_limits_t, plus, 4, 4, 4, 4);
SIZE(wsg_statistics_t, 8, 8);
FIELD(wsg_statistics_t, total, 4, 4, 0, 0);
FIELD(wsg_statistics_t, no_part, 2, 2, 4, 4);
FIELD(wsg_statistics_t, part_lost, 2, 2, 6, 6);
SIZE(wsg_system_info_t, 8, 8);
FIELD(wsg_system_info_t, device, 1, 1, 0, 0);
FIELD(wsg_system_info_t, hardware_revision, 1, 1, 1, 1);
FIELD(wsg_system_info_t, firmware, 2, 2, 2, 2);
FIELD(wsg_system_info_t, serial_number, 4, 4, 4, 4);
SIZE(wsg_system_limits_t, 32, 32);
FIELD(wsg_system_limits_t, stroke, 4, 4, 0, 0);
FIELD(wsg_system_limits_t, min_speed, 4, 4, 4, 4);
FIELD(wsg_system_limits_t, max_speed, 4, 4, 8, 8);
FIELD(wsg_system_limits_t, min_acceleration, 4, 4, 12, 12);
FIELD(wsg_system_limits_t, max_acceleration, 4, 4, 16, 16);
FIELD(wsg_system_limits_t, min_force, 4, 4, 20, 20);
FIELD(wsg_system_limits_t, nominal_force, 4, 4, 24, 24);
FIELD(wsg_system_limits_t, overdrive_force, 4, 4, 28, 28);
SIZE(wsg_finger_info_t, 4, 4);
FIELD(wsg_finger_info_t, reserved, 1, 1, 0, 0);
FIELD(wsg_finger_info_t, finger, 1, 1, 1, 1);
FIELD(wsg_finger_info_t, data_len, 2, 2, 2, 2);
SIZE(wsg_bytes_t, 8, 16);
FIELD(wsg_bytes_t, data, 4, 8, 0, 0);
FIELD(wsg_bytes_t, length, 2, 2, 4, 8);
SIZE(wsg_value_t, 32, 32);
FIELD(wsg_value_t, number, 4, 4, 0, 0);
FIELD(wsg_value_t, flags, 4, 4, 0, 0);
FIELD(wsg_value_t, state, 1, 1, 0, 0);
FIELD(wsg_value_t, temperature, 2, 2, 0, 0);
FIELD(wsg_value_t, soft_limits, 8, 8, 0, 0);
FIELD(wsg_value_t, statistics, 8, 8, 0, 0);
FIELD(wsg_value_t, info, 8, 8, 0, 0);
FIELD(wsg_value_t, limits, 32, 32, 0, 0);
FIELD(wsg_value_t, finger, 4, 4, 0, 0);
FIELD(wsg_value_t, bytes, 8, 16, 0, 0);
FIELD(wsg_value_t, payload, 32, 32, 0, 0);
SIZE(wsg_event_t, 40, 40);
FIELD(wsg_event_t, kind, 1, 1, 0, 0);
FIELD(wsg_event_t, command, 1, 1, 1, 1);
FIELD(wsg_event_t, status, 2, 2, 2, 2);
FIELD(wsg_event_t, value_kind, 1, 1, 4, 4);
FIELD(wsg_event_t, value, 32, 32, 8, 8);
SIZE(wsg_known_t, 68, 68);
FIELD(wsg_known_t, flags, 4, 4, 0, 0);
FIELD(wsg_known_t, width, 4, 4, 4, 4);
FIELD(wsg_known_t, speed, 4, 4, 8, 8);
FIELD(wsg_known_t, force, 4, 4, 12, 12);
FIELD(wsg_known_t, force_limit, 4, 4, 16, 16);
FIELD(wsg_known_t, info, 8, 8, 20, 20);
FIELD(wsg_known_t, limits, 32, 32, 28, 28);
FIELD(wsg_known_t, valid, 1, 1, 60, 60);
FIELD(wsg_known_t, state, 1, 1, 61, 61);
FIELD(wsg_known_t, connected, 1, 1, 62, 62);
FIELD(wsg_known_t, motion, 1, 1, 63, 63);
FIELD(wsg_known_t, busy, 1, 1, 64, 64);
FIELD(wsg_known_t, fast_stop_pending, 1, 1, 65, 65);
SIZE(wsg_counters_t, 14, 14);
FIELD(wsg_counters_t, dropped, 2, 2, 0, 0);
FIELD(wsg_counters_t, bad_checksum, 2, 2, 2, 2);
FIELD(wsg_counters_t, oversize, 2, 2, 4, 4);
FIELD(wsg_counters_t, unsolicited, 2, 2, 6, 6);
FIELD(wsg_counters_t, refused, 2, 2, 8, 8);
FIELD(wsg_counters_t, repeated, 2, 2, 10, 10);
FIELD(wsg_counters_t, disconnects, 2, 2, 12, 12);
SIZE(wsg_queue_t, 20, 32);
FIELD(wsg_queue_t, events, 4, 8, 0, 0);
FIELD(wsg_queue_t, bytes, 4, 8, 4, 8);
FIELD(wsg_queue_t, bytes_size, 4, 8, 8, 16);
FIELD(wsg_queue_t, capacity, 2, 2, 12, 24);
FIELD(wsg_queue_t, count, 2, 2, 14, 26);
FIELD(wsg_queue_t, lost, 2, 2, 16, 28);
FIELD(wsg_queue_t, bytes_state, 1, 1, 18, 30);
SIZE(wsg_parser_t, 88, 88);
FIELD(wsg_parser_t, opaque, 88, 88, 0, 0);
SIZE(wsg_frame_t, 8, 16);
FIELD(wsg_frame_t, payload, 4, 8, 0, 0);
FIELD(wsg_frame_t, length, 2, 2, 4, 8);
FIELD(wsg_frame_t, id, 1, 1, 6, 10);
FIELD(wsg_frame_t, kind, 1, 1, 7, 11);
SIZE(wsg_can_t, 128, 128);
FIELD(wsg_can_t, opaque, 128, 128, 0, 0);
SIZE(wsg_can_frame_t, 12, 12);
FIELD(wsg_can_frame_t, id, 2, 2, 0, 0);
FIELD(wsg_can_frame_t, length, 1, 1, 2, 2);
FIELD(wsg_can_frame_t, data, 8, 8, 3, 3);
SIZE(wsg_can_counters_t, 12, 12);
FIELD(wsg_can_counters_t, foreign, 2, 2, 0, 0);
FIELD(wsg_can_counters_t, dropped, 2, 2, 2, 2);
FIELD(wsg_can_counters_t, miscut, 2, 2, 4, 4);
FIELD(wsg_can_counters_t, bad_checksum, 2, 2, 6, 6);
FIELD(wsg_can_counters_t, oversize, 2, 2, 8, 8);
FIELD(wsg_can_counters_t, expired, 2, 2, 10, 10);
SIZE(wsg_fieldbus_t, 256, 320);
FIELD(wsg_fieldbus_t, opaque, 256, 320, 0, 0);
FUNCTION(int32_t, wsg_config_default, (wsg_config_t *config))
FUNCTION(int32_t, wsg_init, (wsg_t *wsg, const wsg_config_t *config, wsg_callback_t callback, void *context))
FUNCTION(int32_t, wsg_receive, (wsg_t *wsg, uint32_t now_ms, const uint8_t *bytes, size_t length))
FUNCTION(int32_t, wsg_tick, (wsg_t *wsg, uint32_t now_ms))
FUNCTION(int32_t, wsg_expire, (wsg_t *wsg, uint32_t now_ms))
FUNCTION(int32_t, wsg_transmit, (wsg_t *wsg, uint32_t now_ms, uint8_t *buffer, size_t size))
FUNCTION(int32_t, wsg_next_deadline, (const wsg_t *wsg, uint32_t now_ms, uint32_t *delay_ms))
FUNCTION(int32_t, wsg_disconnect, (wsg_t *wsg))
FUNCTION(int32_t, wsg_withdraw, (wsg_t *wsg))
FUNCTION(int32_t, wsg_loop, (wsg_t *wsg, const uint8_t *data, size_t length))
FUNCTION(int32_t, wsg_disconnect_announcement, (wsg_t *wsg))
FUNCTION(int32_t, wsg_homing, (wsg_t *wsg, uint8_t direction))
FUNCTION(int32_t, wsg_pre_position, (wsg_t *wsg, uint8_t flags, float width, float speed))
FUNCTION(int32_t, wsg_stop, (wsg_t *wsg))
FUNCTION(int32_t, wsg_fast_stop, (wsg_t *wsg))
FUNCTION(int32_t, wsg_acknowledge, (wsg_t *wsg))
FUNCTION(int32_t, wsg_grip_part, (wsg_t *wsg, float width, float speed))
FUNCTION(int32_t, wsg_release_part, (wsg_t *wsg, float width, float speed))
FUNCTION(int32_t, wsg_set_acceleration, (wsg_t *wsg, float acceleration))
FUNCTION(int32_t, wsg_get_acceleration, (wsg_t *wsg))
FUNCTION(int32_t, wsg_set_force_limit, (wsg_t *wsg, float force))
FUNCTION(int32_t, wsg_get_force_limit, (wsg_t *wsg))
FUNCTION(int32_t, wsg_set_soft_limits, (wsg_t *wsg, float minus, float plus))
FUNCTION(int32_t, wsg_get_soft_limits, (wsg_t *wsg))
FUNCTION(int32_t, wsg_clear_soft_limits, (wsg_t *wsg))
FUNCTION(int32_t, wsg_overdrive_mode, (wsg_t *wsg, uint8_t enabled))
FUNCTION(int32_t, wsg_tare_force_sensor, (wsg_t *wsg))
FUNCTION(int32_t, wsg_get_system_state, (wsg_t *wsg))
FUNCTION(int32_t, wsg_get_gripper_state, (wsg_t *wsg))
FUNCTION(int32_t, wsg_get_gripping_statistics, (wsg_t *wsg, uint8_t reset))
FUNCTION(int32_t, wsg_get_opening_width, (wsg_t *wsg))
FUNCTION(int32_t, wsg_get_speed, (wsg_t *wsg))
FUNCTION(int32_t, wsg_get_force, (wsg_t *wsg))
FUNCTION(int32_t, wsg_get_temperature, (wsg_t *wsg))
FUNCTION(int32_t, wsg_get_system_info, (wsg_t *wsg))
FUNCTION(int32_t, wsg_set_device_tag, (wsg_t *wsg, const char *tag))
FUNCTION(int32_t, wsg_get_device_tag, (wsg_t *wsg))
FUNCTION(int32_t, wsg_get_system_limits, (wsg_t *wsg))
FUNCTION(int32_t, wsg_get_finger_info, (wsg_t *wsg, uint8_t finger))
FUNCTION(int32_t, wsg_get_finger_flags, (wsg_t *wsg, uint8_t finger))
FUNCTION(int32_t, wsg_finger_power, (wsg_t *wsg, uint8_t finger, uint8_t enabled))
FUNCTION(int32_t, wsg_get_finger_data, (wsg_t *wsg, uint8_t finger))
FUNCTION(int32_t, wsg_custom, (wsg_t *wsg, uint8_t id, const uint8_t *data, size_t length))
FUNCTION(int32_t, wsg_subscribe, (wsg_t *wsg, uint8_t command, uint16_t period_ms, uint8_t on_change))
FUNCTION(int32_t, wsg_known, (const wsg_t *wsg, wsg_known_t *known))
FUNCTION(int32_t, wsg_counters, (const wsg_t *wsg, wsg_counters_t *counters))
FUNCTION(int32_t, wsg_queue_init, (wsg_queue_t *queue, wsg_event_t *events, uint16_t capacity, uint8_t *bytes, size_t bytes_size))
FUNCTION(void, wsg_queue_push, (void *queue, const wsg_event_t *event))
FUNCTION(int32_t, wsg_queue_pop, (wsg_queue_t *queue, wsg_event_t *event))
FUNCTION(int32_t, wsg_queue_lost, (const wsg_queue_t *queue))
FUNCTION(int32_t, wsg_parser_init, (wsg_parser_t *parser))
FUNCTION(int32_t, wsg_parser_push, (wsg_parser_t *parser, const uint8_t *bytes, size_t length, size_t *taken, wsg_frame_t *frame))
FUNCTION(int32_t, wsg_parser_expire, (wsg_parser_t *parser, wsg_frame_t *frame))
FUNCTION(int32_t, wsg_frame_encode, (uint8_t id, const uint8_t *payload, size_t payload_length, uint8_t *buffer, size_t size))
FUNCTION(int32_t, wsg_reply_decode, (const wsg_frame_t *frame, wsg_event_t *event))
FUNCTION(int32_t, wsg_can_init, (wsg_can_t *can, uint16_t id))
FUNCTION(int32_t, wsg_can_split, (uint16_t id, const uint8_t *message, size_t message_length, wsg_can_frame_t *frames, size_t capacity))
FUNCTION(int32_t, wsg_can_receive, (wsg_can_t *can, wsg_t *wsg, uint32_t now_ms, const wsg_can_frame_t *frame))
FUNCTION(int32_t, wsg_can_tick, (wsg_can_t *can, wsg_t *wsg, uint32_t now_ms))
FUNCTION(int32_t, wsg_can_counters, (wsg_can_t *can, wsg_can_counters_t *counters))
FUNCTION(int32_t, wsg_fieldbus_attach, (wsg_fieldbus_t *fieldbus, wsg_t *wsg))
FUNCTION(int32_t, wsg_fieldbus_write, (wsg_fieldbus_t *fieldbus, const wsg_t *wsg, const uint8_t *image, size_t image_length))
FUNCTION(int32_t, wsg_fieldbus_read, (wsg_fieldbus_t *fieldbus, const wsg_t *wsg, uint8_t *image, size_t size))
FUNCTION(int32_t, wsg_fieldbus_silence, (wsg_fieldbus_t *fieldbus, const wsg_t *wsg, uint8_t reaction))
FUNCTION(const char *, wsg_status_name, (uint16_t status))
FUNCTION(const char *, wsg_status_text, (uint16_t status))
FUNCTION(const char *, wsg_command_name, (uint8_t command))
FUNCTION(const char *, wsg_error_text, (int32_t error))
FUNCTION(const char *, wsg_version, (void))
#endif
