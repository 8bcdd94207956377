/* The checks of a recorded ABI. They fail to compile, or to link. Values are for 32 and for 64 bits. */
#include <stddef.h>
#include <stdint.h>

#define ON(on_32, on_64) (UINTPTR_MAX > 0xFFFFFFFFu ? (on_64) : (on_32))
#define JOINED(one, other) one##other
#define JOIN(one, other) JOINED(one, other)
#define CHECK(condition) typedef char JOIN(check_of_line_, __LINE__)[(condition) ? 1 : -1]

#define VALUE(name, on_32, on_64) CHECK((long)(name) == ON(on_32, on_64))
#define SIZE(type, on_32, on_64) CHECK(sizeof(type) == ON(on_32, on_64))
#define FIELD(type, member, size_32, size_64, offset_32, offset_64) \
    CHECK(sizeof(((type *)0)->member) == ON(size_32, size_64) && offsetof(type, member) == ON(offset_32, offset_64))

/* Declares the function again, and keeps a pointer to it in the program. */
#ifdef __cplusplus
#define C extern "C"
#else
#define C extern
#endif
#define FUNCTION(result, name, parameters) \
    C result name parameters; \
    C void (*const recorded_##name)(void); \
    void (*const recorded_##name)(void) = (void (*)(void))name;
