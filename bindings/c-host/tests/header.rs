//! `include/wsg_host.h` is the output of cbindgen, and compilers accept it.

#[path = "../../c/tests/shared/mod.rs"]
mod shared;

use shared::Header;

const HEADER: Header = Header { name: "wsg_host", folder: env!("CARGO_MANIFEST_DIR") };

const PREAMBLE: &str = "\
/*
 * Blocking calls for a Weiss Robotics WSG gripper over TCP, UDP or a serial port: libwsg_host, which contains libwsg.
 *
 *     wsg_host_t *gripper;
 *     if (wsg_host_open_tcp(\"192.168.1.20\", WSG_HOST_TCP_PORT, &gripper) == 0) {
 *         wsg_host_home(gripper, WSG_HOMING_DEFAULT);
 *         wsg_host_close(gripper);
 *     }
 *
 * Rules for all functions:
 * - A pointer is null or points to an object of its type, or to an array of the length passed with it.
 * - A gripper is used by one thread at a time. Stop handles are used by any thread, and streams by several.
 * - Functions that return int32_t return 0 on success; see wsg_host_error for other values.
 *
 * Generated from the crate wsg-c-host: do not edit.
 */
#include \"wsg.h\"
";

#[test]
fn header_is_generated_from_the_crate_and_its_abi_is_recorded() {
    HEADER.is_generated(PREAMBLE.to_owned());
    HEADER.is_recorded();
}

#[test]
fn header_and_recorded_abi_compile_with_gcc() {
    HEADER.compiles("gcc", &[]);
}

#[test]
#[ignore = "needs clang: run `cargo xtask test`"]
fn header_and_recorded_abi_compile_with_clang() {
    HEADER.compiles("clang", &[]);
}
