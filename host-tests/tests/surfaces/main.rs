//! The promises that hold on every way in to a gripper (DESIGN.md, 5a): one adapter for each surface, one test for each
//! promise. The bridge's own promises, in virtual time, are in `host_tests::explore`.
//!
//! What a promise requires is judged beside the gripper: by its fingers and its force limit, and by the frames on its line.

#[cfg(target_os = "linux")]
mod chaos;
mod control;
#[cfg(target_os = "linux")]
mod ethernetip;
mod fieldbus;
mod page;
mod process;
#[cfg(target_os = "linux")]
mod profinet;
mod promises;
mod rust;
mod station;
mod surface;

use std::net::SocketAddr;

use station::{Line, Station};
use surface::Surface;

/// A way in to a gripper, and how it differs from the others.
struct Entry {
    station: fn() -> Station,
    open: fn(SocketAddr) -> Box<dyn Surface>,
    line: fn(&Station) -> &Line,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// A client of the command interface with one connection. Its unannounced end is a FAST STOP (command set, 1.4.2).
    Client,
    /// A client that connects for each request.
    ClientEachTime,
    /// A client of another interface of the virtual gripper.
    Server,
    /// The page, which refuses numbers itself and names the state that its user sees.
    Page,
    /// The register interface, in which a number outside the limits is a FAST STOP (fieldbus, 6.1).
    Fieldbus,
    /// Wires, which have no numbers.
    Wires,
}

const fn client(open: fn(SocketAddr) -> Box<dyn Surface>, kind: Kind) -> Entry {
    Entry { station: Station::new, open, line: |station| &station.tcp, kind }
}

/// Tests every promise on every surface.
macro_rules! surfaces {
    ($($(#[$ignored:meta])* $name:ident: $entry:expr;)*) => {
        $(mod $name {
            use super::*;

            const ENTRY: Entry = $entry;

            #[test]
            $(#[$ignored])*
            fn fast_stop_acts_within_250_ms_beside_blocked_requests() {
                promises::judge(&ENTRY, promises::fast_stop_acts);
            }

            #[test]
            $(#[$ignored])*
            fn nothing_moves_without_a_request() {
                promises::judge(&ENTRY, promises::nothing_moves_unrequested);
            }

            #[test]
            $(#[$ignored])*
            fn nothing_older_than_a_second_runs() {
                promises::judge(&ENTRY, promises::nothing_old_runs);
            }

            #[test]
            $(#[$ignored])*
            fn refused_request_sends_and_changes_nothing() {
                promises::judge(&ENTRY, promises::refusal_changes_nothing);
            }

            #[test]
            $(#[$ignored])*
            fn lost_connection_shows_in_every_read() {
                promises::judge(&ENTRY, promises::lost_connection_shows);
            }
        })*
    };
}

surfaces! {
    rust_blocking: client(rust::blocking, Kind::Client);
    rust_async: client(rust::asynchronous, Kind::Client);
    rust_stream: client(rust::streaming, Kind::Client);
    c_host: client(rust::c, Kind::Client);
    wsg: client(process::wsg, Kind::ClientEachTime);
    wsg_script: client(process::wsg_script, Kind::ClientEachTime);
    control_interface: Entry { line: |station| &station.control, ..client(control::control, Kind::Server) };
    #[ignore = "needs Chromium: `cargo xtask test` installs it"]
    page_in_chromium: Entry { line: |station| &station.control, ..client(page::page, Kind::Page) };
    modbus_tcp: Entry { line: |station| &station.modbus, ..client(fieldbus::modbus, Kind::Fieldbus) };
    wires: client(fieldbus::wires, Kind::Wires);
    gateway_over_modbus_tcp: client(process::gateway, Kind::Fieldbus);
    #[ignore = "needs the Python package: `cargo xtask test` installs it"]
    python_blocking: client(|address| process::python(address, "Gripper"), Kind::Client);
    #[ignore = "needs the Python package: `cargo xtask test` installs it"]
    python_async: client(|address| process::python(address, "AsyncGripper"), Kind::Client);
    #[ignore = "needs the Python package: `cargo xtask test` installs it"]
    python_stream: client(|address| process::python(address, "StreamingGripper"), Kind::Client);
    #[ignore = "needs the Python package: `cargo xtask test` installs it"]
    python_umi: client(|address| process::python(address, "WSGController"), Kind::Client);
}

#[cfg(target_os = "linux")]
surfaces! {
    ethernetip_scanner: Entry {
        station: ethernetip::station,
        line: |station| station.ethernet.as_ref().expect("the station has a bus"),
        ..client(ethernetip::ethernetip, Kind::Fieldbus)
    };
    gateway_over_ethernetip: client(ethernetip::gateway, Kind::Fieldbus);
    #[ignore = "needs profinet-py and root: run `cargo xtask test`"]
    profinet_py_in_namespaces: Entry {
        station: profinet::station,
        line: |station| station.ethernet.as_ref().expect("the station has a network"),
        ..client(profinet::profinet, Kind::Fieldbus)
    };
    #[ignore = "needs profinet-py and root: run `cargo xtask test`"]
    gateway_over_profinet_py_in_namespaces: client(profinet::gateway, Kind::Fieldbus);
}
