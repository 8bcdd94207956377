/* The layouts that are part of the ABI: a program compiled against an older header relies on them. */
#include "wsg.h"

#ifdef __cplusplus
#define CHECK(name, condition) static_assert(condition, #name)
#elif __STDC_VERSION__ >= 201112L
#define CHECK(name, condition) _Static_assert(condition, #name)
#else
#define CHECK(name, condition) typedef char name[(condition) ? 1 : -1]
#endif

CHECK(event_size, sizeof(wsg_event_t) == 40);
CHECK(event_status, offsetof(wsg_event_t, status) == 2);
CHECK(event_value_kind, offsetof(wsg_event_t, value_kind) == 4);
CHECK(event_value, offsetof(wsg_event_t, value) == 8 || sizeof(void *) == 4);
CHECK(limits_size, sizeof(wsg_system_limits_t) == 32);
CHECK(info_serial, offsetof(wsg_system_info_t, serial_number) == 4);
CHECK(known_limits, offsetof(wsg_known_t, limits) == 28);
CHECK(known_valid, offsetof(wsg_known_t, valid) == 60);
CHECK(known_size, sizeof(wsg_known_t) == 68);
CHECK(finger_data_len, offsetof(wsg_finger_info_t, data_len) == 2);
CHECK(config_attempts, offsetof(wsg_config_t, attempts) == 34);
CHECK(config_size, sizeof(wsg_config_t) == 40);
CHECK(counters_size, sizeof(wsg_counters_t) == 14);
CHECK(storage_on_32_bits, sizeof(void *) != 4 || sizeof(wsg_t) == 640);
CHECK(parser_size, sizeof(wsg_parser_t) == 88);
CHECK(no_error, WSG_ERROR_NONE == 0);
CHECK(grip_part, WSG_COMMAND_GRIP_PART == 0x25);
CHECK(pending, WSG_E_CMD_PENDING == 26);
CHECK(holding, WSG_STATE_HOLDING == 4);
CHECK(fast_stop, WSG_FLAG_FAST_STOP == 0x1000);
CHECK(can_frame_size, sizeof(wsg_can_frame_t) == 12);
CHECK(fieldbus_on_32_bits, sizeof(void *) != 4 || sizeof(wsg_fieldbus_t) == 256);
