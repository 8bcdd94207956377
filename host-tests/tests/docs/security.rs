//! Checks the limits of network ports in SECURITY.md against the sources that define them.

use document::read;

/// Each limit in the document, and its definition with the source.
const LIMITS: [(&str, &str, &str); 11] = [
    ("body 4096 bytes", "MAX_BODY_LEN: usize = 4_096", "gripper-sim/src/server/control.rs"),
    (
        "the source of a script 65 536 bytes",
        "MAX_SOURCE_LEN: usize = 65_536",
        "gripper-sim/src/server/control/scripts.rs",
    ),
    ("head 16 384 bytes", "MAX_HEAD_LEN: usize = 16_384", "gripper-sim/src/server/control.rs"),
    ("32 connections", "MAX_CONNECTIONS: usize = 32", "gripper-sim/src/server/control.rs"),
    ("of at most 5 s", "TIME_LIMIT: Duration = Duration::from_secs(5)", "gripper-sim/src/server/control.rs"),
    ("64 open pages", "MAX_STREAMS: usize = 64", "gripper-sim/src/server/control/events.rs"),
    ("32 masters", "MAX_MASTERS: usize = 32", "tool/src/gateway/bridge.rs"),
    ("128 clients", "MAX_CLIENTS: usize = 128", "gripper-sim/src/control/bench.rs"),
    (
        "300 s without a request",
        "IDLE_LIMIT: Duration = Duration::from_secs(300)",
        "fieldbus-host/src/client.rs",
    ),
    (
        "listens for TCP on 127.0.0.1",
        "DEFAULT_TCP: SocketAddr = SocketAddr::new(LOOPBACK, 1_000)",
        "gripper-sim/src/server/options.rs",
    ),
    ("means 127.0.0.1", "SocketAddr::new(LOOPBACK, parsed(text)?)", "gripper-sim/src/server/options.rs"),
];

#[test]
fn limits_of_the_network_ports_are_those_of_the_sources() {
    let text = read("SECURITY.md");
    for (limit, definition, source) in LIMITS {
        assert!(text.contains(limit), "SECURITY.md: {limit}");
        assert!(read(source).contains(definition), "{source}: {definition}");
    }
}
