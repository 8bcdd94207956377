// Homes a gripper, grips a part and releases it, over TCP, with the blocking calls of wsg.hpp.
//
// The destructor of wsg::gripper announces the end of the connection. Without it, the gripper enters FAST STOP when the program
// ends, and refuses the next program's motions.
//
//     c++ -std=c++17 -I include examples/cpp_host.cpp -L lib/x86_64-unknown-linux-gnu -lwsg -o cpp_host
//     ./cpp_host 127.0.0.1 1000

#include <chrono>
#include <cstdio>

#include <netdb.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include "wsg.hpp"

// A TCP connection that closes with its scope.
class tcp_line {
public:
    tcp_line(const char *host, const char *port)
    {
        addrinfo hints{}, *found = nullptr;
        hints.ai_socktype = SOCK_STREAM;
        if (getaddrinfo(host, port, &hints, &found) != 0) {
            return;
        }
        socket_ = socket(found->ai_family, found->ai_socktype, found->ai_protocol);
        if (socket_ >= 0 && connect(socket_, found->ai_addr, found->ai_addrlen) != 0) {
            close(std::exchange(socket_, -1));
        }
        freeaddrinfo(found);
    }
    tcp_line(tcp_line &&other) noexcept : socket_(std::exchange(other.socket_, -1)) {}
    ~tcp_line()
    {
        if (socket_ >= 0) {
            close(socket_);
        }
    }

    uint32_t now_ms() const
    {
        using namespace std::chrono;
        return static_cast<uint32_t>(duration_cast<milliseconds>(steady_clock::now().time_since_epoch()).count());
    }
    bool send(const uint8_t *bytes, std::size_t length)
    {
        return ::send(socket_, bytes, length, MSG_NOSIGNAL) == static_cast<ssize_t>(length);
    }
    int receive(uint8_t *bytes, std::size_t size, uint32_t timeout_ms)
    {
        pollfd waiting{socket_, POLLIN, 0};
        if (poll(&waiting, 1, static_cast<int>(timeout_ms)) <= 0) {
            return 0;
        }
        const ssize_t length = recv(socket_, bytes, size, 0);
        return length > 0 ? static_cast<int>(length) : -1;
    }

private:
    int socket_ = -1;
};

template <class T> static bool check(const char *what, const wsg::result<T> &result)
{
    std::printf("%s: %s\n", what, result ? "done" : result.error().text());
    return result.has_value();
}

int main(int count, char **arguments)
{
    if (count != 3) {
        std::fprintf(stderr, "usage: cpp_host HOST PORT\n");
        return 2;
    }
    wsg::gripper gripper{tcp_line(arguments[1], arguments[2])};
    if (!check("connect", gripper.connect()) || !check("home", gripper.homing()) ||
        !check("force", gripper.set_force_limit(40.0f)) || !check("open", gripper.move(50.0f, 200.0f))) {
        return 1;
    }
    const auto grip = gripper.grip_part(20.0f, 100.0f);
    if (!check("grip", grip)) {
        return 1;
    }
    std::printf("%s\n", *grip == wsg::grip::held ? "a part is held" : "no part");
    const auto width = gripper.width();
    std::printf("width: %.0f mm\n", static_cast<double>(*width));
    if (!check("release", gripper.release_part(50.0f, 200.0f)) || !check("fast stop", gripper.fast_stop())) {
        return 1;
    }
    check("move", gripper.move(40.0f, 100.0f)); // locked
    check("acknowledge", gripper.acknowledge());
    return check("move", gripper.move(40.0f, 100.0f)) ? 0 : 1;
}
