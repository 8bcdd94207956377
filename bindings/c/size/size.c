/*
 * What the library takes: every function of a session and every request, without the texts. Only linked, never run. With
 * WSG_EMPTY it is the program without the library.
 */
#include "wsg.h"

typedef void (*function)(void);

/* A program in C has these anyway. */
void *memcpy(void *to, const void *from, size_t length);
void *memset(void *to, int value, size_t length);
void *memmove(void *to, const void *from, size_t length);
int memcmp(const void *one, const void *other, size_t length);
void __aeabi_memcpy(void *to, const void *from, size_t length);
void __aeabi_memcpy4(void *to, const void *from, size_t length);
void __aeabi_memclr4(void *to, size_t length);
void __aeabi_memclr8(void *to, size_t length);

const function memory[] = {
    (function)memcpy,         (function)memset,          (function)memmove,         (function)memcmp,
    (function)__aeabi_memcpy, (function)__aeabi_memcpy4, (function)__aeabi_memclr4, (function)__aeabi_memclr8,
};

#ifdef WSG_EMPTY
/* As long as the table below. */
const function functions[46] = {NULL};
#else
static wsg_t gripper;

/* Their addresses keep them. */
const function functions[46] = {
    (function)wsg_config_default,
    (function)wsg_init,
    (function)wsg_receive,
    (function)wsg_tick,
    (function)wsg_expire,
    (function)wsg_transmit,
    (function)wsg_next_deadline,
    (function)wsg_disconnect,
    (function)wsg_withdraw,
    (function)wsg_known,
    (function)wsg_counters,
    (function)wsg_subscribe,
    (function)wsg_loop,
    (function)wsg_disconnect_announcement,
    (function)wsg_homing,
    (function)wsg_pre_position,
    (function)wsg_stop,
    (function)wsg_fast_stop,
    (function)wsg_acknowledge,
    (function)wsg_grip_part,
    (function)wsg_release_part,
    (function)wsg_set_acceleration,
    (function)wsg_get_acceleration,
    (function)wsg_set_force_limit,
    (function)wsg_get_force_limit,
    (function)wsg_set_soft_limits,
    (function)wsg_get_soft_limits,
    (function)wsg_clear_soft_limits,
    (function)wsg_overdrive_mode,
    (function)wsg_tare_force_sensor,
    (function)wsg_get_system_state,
    (function)wsg_get_gripper_state,
    (function)wsg_get_gripping_statistics,
    (function)wsg_get_opening_width,
    (function)wsg_get_speed,
    (function)wsg_get_force,
    (function)wsg_get_temperature,
    (function)wsg_get_system_info,
    (function)wsg_set_device_tag,
    (function)wsg_get_device_tag,
    (function)wsg_get_system_limits,
    (function)wsg_get_finger_info,
    (function)wsg_get_finger_flags,
    (function)wsg_finger_power,
    (function)wsg_get_finger_data,
    (function)wsg_custom,
};

/* What the functions above are called with. */
wsg_t *const argument = &gripper;
#endif

void reset(void);
void reset(void)
{
    __asm volatile("" : : "r"(functions), "r"(memory));
#ifndef WSG_EMPTY
    __asm volatile("" : : "r"(argument));
#endif
    for (;;) {
    }
}
