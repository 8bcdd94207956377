/*
 * C++17 for wsg.h: a session that ends with its scope, results without exceptions, and blocking calls over any line.
 *
 * Header only. Uses neither exceptions, RTTI nor the heap, so it also fits firmware.
 */
#ifndef WSG_HPP
#define WSG_HPP

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>
#include <utility>

#include "wsg.h"

namespace wsg {

/// Why a call failed: a WSG_ERROR_... code of the library, a status of the gripper, or one of the reasons below.
class failure {
public:
    enum class cause {
        library,      ///< The library rejected the request; nothing was sent.
        gripper,      ///< The gripper replied with this status.
        no_answer,    ///< The outcome is unknown.
        withdrawn,    ///< A Stop or FAST STOP overtook the request, which was not sent.
        disconnected, ///< The gripper does not reply.
        line,         ///< The line failed.
        timeout,      ///< The time of a blocking call is over.
    };

    constexpr failure(cause why, int32_t code = 0) : why_(why), code_(code) {}

    constexpr cause why() const { return why_; }
    /// The WSG_ERROR_... code or the WSG_E_... status; 0 for other causes.
    constexpr int32_t code() const { return code_; }

    const char *text() const
    {
        switch (why_) {
        case cause::library: return wsg_error_text(code_);
        case cause::gripper: return wsg_status_text(static_cast<uint16_t>(code_));
        case cause::no_answer: return "the outcome is unknown";
        case cause::withdrawn: return "withdrawn";
        case cause::disconnected: return "the gripper does not reply";
        case cause::line: return "the line failed";
        case cause::timeout: return "time-out";
        }
        return "";
    }

private:
    cause why_;
    int32_t code_;
};

/// A value or an error, like std::expected of C++23. T is default constructible.
template <class T> class [[nodiscard]] result {
public:
    constexpr result(T value) : value_(std::move(value)) {}
    constexpr result(failure why) : error_(why) {}

    constexpr bool has_value() const { return !error_.has_value(); }
    constexpr explicit operator bool() const { return has_value(); }
    /// The value; a default one if there is none.
    constexpr const T &value() const { return value_; }
    constexpr const T &operator*() const { return value_; }
    constexpr const T *operator->() const { return &value_; }
    /// The error, if has_value() is false.
    constexpr const wsg::failure &error() const { return *error_; }

private:
    T value_{};
    std::optional<wsg::failure> error_;
};

/// The value of a result that only succeeds or fails.
struct done {};

/// An event of a session. It is valid until the handler returns.
class event {
public:
    explicit event(const wsg_event_t &plain) : plain_(plain) {}

    wsg_event kind() const { return static_cast<wsg_event>(plain_.kind); }
    uint8_t command() const { return plain_.command; }
    uint16_t status() const { return plain_.status; }
    bool answers(uint8_t command) const { return kind() == WSG_EVENT_ANSWERED && plain_.command == command; }
    bool succeeded() const { return plain_.status == WSG_E_SUCCESS; }

    /// The values, if the event has one of that kind.
    std::optional<float> number() const { return get(WSG_VALUE_NUMBER, plain_.value.number); }
    std::optional<uint32_t> flags() const { return get(WSG_VALUE_FLAGS, plain_.value.flags); }
    std::optional<uint8_t> state() const { return get(WSG_VALUE_STATE, plain_.value.state); }
    std::optional<wsg_system_limits_t> limits() const { return get(WSG_VALUE_LIMITS, plain_.value.limits); }
    std::optional<wsg_system_info_t> info() const { return get(WSG_VALUE_INFO, plain_.value.info); }
    std::optional<std::string_view> bytes() const
    {
        if (plain_.value_kind != WSG_VALUE_BYTES) {
            return std::nullopt;
        }
        return std::string_view(reinterpret_cast<const char *>(plain_.value.bytes.data), plain_.value.bytes.length);
    }

    /// The event of the C interface.
    const wsg_event_t &plain() const { return plain_; }

private:
    template <class T> std::optional<T> get(uint8_t kind, const T &value) const
    {
        return plain_.value_kind == kind ? std::optional<T>(value) : std::nullopt;
    }

    const wsg_event_t &plain_;
};

/// The session of wsg.h with a handler for its events: any callable that takes a `const wsg::event &`.
///
///     wsg::session gripper{[&](const wsg::event &event) { ... }};
///     gripper.receive(now, bytes, length);
///     gripper.tick(now);
template <class Handler> class session {
public:
    explicit session(Handler handler, const wsg_config_t &config = defaults()) : handler_(std::move(handler))
    {
        state_ = wsg_init(&wsg_, &config, &session::on_event, this);
    }

    // The library has its address.
    session(const session &) = delete;
    session &operator=(const session &) = delete;

    static wsg_config_t defaults()
    {
        wsg_config_t config;
        wsg_config_default(&config);
        return config;
    }

    /// Whether the configuration was accepted. If not, every call fails.
    result<done> state() const { return checked(state_); }

    result<done> receive(uint32_t now_ms, const uint8_t *bytes, std::size_t length)
    {
        return checked(wsg_receive(&wsg_, now_ms, bytes, length));
    }
    result<done> tick(uint32_t now_ms) { return checked(wsg_tick(&wsg_, now_ms)); }
    /// The length of the next message, or 0.
    result<std::size_t> transmit(uint32_t now_ms, uint8_t *buffer, std::size_t size)
    {
        const int32_t length = wsg_transmit(&wsg_, now_ms, buffer, size);
        if (length < 0) {
            return failure(failure::cause::library, length);
        }
        return static_cast<std::size_t>(length);
    }
    /// Milliseconds until the next tick is due.
    std::optional<uint32_t> next_deadline(uint32_t now_ms) const
    {
        uint32_t delay = 0;
        return wsg_next_deadline(&wsg_, now_ms, &delay) == 1 ? std::optional<uint32_t>(delay) : std::nullopt;
    }
    result<done> disconnect() { return checked(wsg_disconnect(&wsg_)); }

    wsg_known_t known() const
    {
        wsg_known_t known{};
        wsg_known(&wsg_, &known);
        return known;
    }

    result<done> homing(uint8_t direction = WSG_HOMING_DEFAULT) { return checked(wsg_homing(&wsg_, direction)); }
    result<done> pre_position(float width, float speed, uint8_t flags = WSG_STOP_ON_BLOCK)
    {
        return checked(wsg_pre_position(&wsg_, flags, width, speed));
    }
    result<done> grip_part(float width, float speed) { return checked(wsg_grip_part(&wsg_, width, speed)); }
    result<done> release_part(float width, float speed) { return checked(wsg_release_part(&wsg_, width, speed)); }
    result<done> stop() { return checked(wsg_stop(&wsg_)); }
    result<done> fast_stop() { return checked(wsg_fast_stop(&wsg_)); }
    result<done> acknowledge() { return checked(wsg_acknowledge(&wsg_)); }
    result<done> set_force_limit(float force) { return checked(wsg_set_force_limit(&wsg_, force)); }
    result<done> set_acceleration(float acceleration) { return checked(wsg_set_acceleration(&wsg_, acceleration)); }
    /// Announces the end of a TCP connection. Request it before the end, tick and transmit, and wait for the reply: a
    /// session has no line, so its destructor cannot announce anything.
    result<done> disconnect_announcement() { return checked(wsg_disconnect_announcement(&wsg_)); }

    /// For all other requests of wsg.h: `gripper.request(wsg_get_temperature)`, `gripper.request(wsg_get_finger_data, 1)`.
    template <class Function, class... Arguments> result<done> request(Function function, Arguments... arguments)
    {
        return checked(function(&wsg_, arguments...));
    }

    Handler &handler() { return handler_; }

private:
    static void on_event(void *context, const wsg_event_t *plain)
    {
        static_cast<session *>(context)->handler_(event(*plain));
    }

    static result<done> checked(int32_t code)
    {
        if (code < 0) {
            return failure(failure::cause::library, code);
        }
        return done{};
    }

    wsg_t wsg_;
    Handler handler_;
    int32_t state_;
};

/// The outcome of a grip.
enum class grip { held, no_part };

/// Blocking calls over a line, in one thread. The destructor announces the end of the connection; see close(). Line has
///
///     uint32_t now_ms();
///     bool send(const uint8_t *bytes, std::size_t length);        false: the line failed
///     int receive(uint8_t *bytes, std::size_t size, uint32_t timeout_ms);      bytes, 0 after the time-out, -1 after a failure
template <class Line> class gripper {
public:
    /// Takes the line. Call connect() first.
    explicit gripper(Line line, const wsg_config_t &config = session_type::defaults())
        : line_(std::move(line)), session_(collector{}, config)
    {
    }

    gripper(const gripper &) = delete;
    gripper &operator=(const gripper &) = delete;
    ~gripper() { static_cast<void>(close().has_value()); }

    /// Announces the end of the connection and waits for the reply, at most `timeout_ms`. Without it, a gripper on TCP
    /// enters FAST STOP when the connection closes, and refuses motions until acknowledge(). Ends a running motion. Other
    /// lines reply that it is not available, which counts as success here.
    ///
    /// Announces nothing without a connection, and nothing after fast_stop() until acknowledge(). No other request is
    /// possible afterwards.
    result<done> close(uint32_t timeout_ms = 500)
    {
        if (is_closed_ || is_stopped_ || session_.known().connected == 0) {
            return done{};
        }
        is_closed_ = true;
        const auto announced =
            outcome(WSG_COMMAND_DISCONNECT_ANNOUNCEMENT, session_.disconnect_announcement(), timeout_ms);
        if (!announced && announced.error().why() == failure::cause::gripper) {
            return done{};
        }
        return announced;
    }

    /// Waits until the gripper replies and its states are known.
    result<done> connect(uint32_t timeout_ms = 5000)
    {
        return run(timeout_ms, [this] { return session_.known().connected == 1; });
    }
    result<done> homing(uint8_t direction = WSG_HOMING_DEFAULT)
    {
        return outcome(WSG_COMMAND_HOMING, session_.homing(direction));
    }
    /// Moves the fingers to a width in mm at a speed in mm/s.
    result<done> move(float width, float speed)
    {
        return outcome(WSG_COMMAND_PRE_POSITION, session_.pre_position(width, speed));
    }
    /// Grips a part of this width. Finding none is no error.
    result<wsg::grip> grip_part(float width, float speed)
    {
        const auto gripped = outcome(WSG_COMMAND_GRIP_PART, session_.grip_part(width, speed));
        if (gripped) {
            return wsg::grip::held;
        }
        if (gripped.error().why() == failure::cause::gripper && gripped.error().code() == WSG_E_CMD_FAILED) {
            return wsg::grip::no_part;
        }
        return gripped.error();
    }
    result<done> release_part(float width, float speed)
    {
        return outcome(WSG_COMMAND_RELEASE_PART, session_.release_part(width, speed));
    }
    result<done> stop() { return outcome(WSG_COMMAND_STOP, session_.stop()); }
    result<done> fast_stop()
    {
        is_stopped_ = true;
        return outcome(WSG_COMMAND_FAST_STOP, session_.fast_stop());
    }
    result<done> acknowledge()
    {
        const auto acknowledged = outcome(WSG_COMMAND_ACKNOWLEDGE, session_.acknowledge());
        is_stopped_ = is_stopped_ && !acknowledged;
        return acknowledged;
    }
    result<done> set_force_limit(float force)
    {
        return outcome(WSG_COMMAND_SET_FORCE_LIMIT, session_.set_force_limit(force));
    }
    /// The opening width in mm.
    result<float> width()
    {
        const auto asked = outcome(WSG_COMMAND_GET_OPENING_WIDTH, session_.request(wsg_get_opening_width));
        if (!asked) {
            return asked.error();
        }
        return session_.handler().number.value_or(0.0f);
    }

    wsg_known_t known() const { return session_.known(); }
    Line &line() { return line_; }

private:
    /// Keeps the outcome of the one request that a blocking call waits for.
    struct collector {
        uint8_t command = 0;
        bool is_over = false;
        std::optional<failure> failed;
        std::optional<float> number;

        void operator()(const event &event)
        {
            if (event.kind() == WSG_EVENT_DISCONNECTED) {
                finish(failure(failure::cause::disconnected));
            } else if (event.command() != command || is_over) {
                return;
            } else if (event.kind() == WSG_EVENT_ANSWERED) {
                number = event.number();
                finish(event.succeeded() ? std::nullopt
                                         : std::optional<failure>(failure(failure::cause::gripper, event.status())));
            } else if (event.kind() == WSG_EVENT_UNANSWERED) {
                finish(failure(failure::cause::no_answer));
            } else if (event.kind() == WSG_EVENT_WITHDRAWN) {
                finish(failure(failure::cause::withdrawn));
            }
        }

        void finish(std::optional<failure> why)
        {
            failed = why;
            is_over = true;
        }
    };

    using session_type = session<collector>;

    /// The session has a time-out for every request, this is the bound beyond it.
    static constexpr uint32_t longest_ms = 120000;

    result<done> outcome(uint8_t command, const result<done> &requested, uint32_t timeout_ms = longest_ms)
    {
        if (!requested) {
            return requested;
        }
        session_.handler() = collector{};
        session_.handler().command = command;
        const auto waited = run(timeout_ms, [this] { return session_.handler().is_over; });
        if (waited && session_.handler().failed) {
            return *session_.handler().failed;
        }
        return waited;
    }

    template <class Condition> result<done> run(uint32_t timeout_ms, Condition is_over)
    {
        const uint32_t start = line_.now_ms();
        for (;;) {
            uint8_t buffer[256];
            if (const auto ticked = session_.tick(line_.now_ms()); !ticked) {
                return ticked;
            }
            for (;;) {
                const auto length = session_.transmit(line_.now_ms(), buffer, sizeof buffer);
                if (!length) {
                    return length.error();
                }
                if (*length == 0) {
                    break;
                }
                if (!line_.send(buffer, *length)) {
                    return failure(failure::cause::line);
                }
            }
            if (is_over()) {
                return done{};
            }
            const uint32_t now = line_.now_ms();
            if (now - start >= timeout_ms) {
                return failure(failure::cause::timeout);
            }
            const uint32_t left = timeout_ms - (now - start);
            const uint32_t due = session_.next_deadline(now).value_or(left);
            const int received = line_.receive(buffer, sizeof buffer, due < left ? due : left);
            if (received < 0) {
                return failure(failure::cause::line);
            }
            session_.receive(line_.now_ms(), buffer, static_cast<std::size_t>(received)).has_value();
        }
    }

    Line line_;
    session_type session_;
    bool is_stopped_ = false;
    bool is_closed_ = false;
};

} // namespace wsg

#endif
