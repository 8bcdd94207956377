//! `include/wsg_host.h` is the output of cbindgen, and compilers accept it.

use std::fs;
use std::path::Path;
use std::process::Command;

const HEADER: &str = "include/wsg_host.h";

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

fn crate_dir() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn header() -> String {
    let mut config = cbindgen::Config::from_file(crate_dir().join("cbindgen.toml")).unwrap();
    config.after_includes = Some(PREAMBLE.to_owned());
    let bindings = cbindgen::Builder::new().with_crate(crate_dir()).with_config(config).generate().unwrap();
    let mut text = Vec::new();
    bindings.write(&mut text);
    String::from_utf8(text).unwrap()
}

#[test]
fn the_header_is_generated_from_the_crate() {
    let (path, header) = (crate_dir().join(HEADER), header());
    if std::env::var_os("WSG_UPDATE_DOCS").is_some() {
        fs::write(&path, &header).unwrap();
    }
    assert!(
        fs::read_to_string(&path).unwrap_or_default() == header,
        "{HEADER} is outdated; run `WSG_UPDATE_DOCS=1 cargo test -p wsg-c-host --test header`"
    );
}

fn compile(compiler: &str) {
    for (language, standard) in [("c", "c99"), ("c", "c11"), ("c++", "c++17")] {
        let mut command = Command::new(compiler);
        command.args([
            "-x",
            language,
            &format!("-std={standard}"),
            "-Wall",
            "-Wextra",
            "-Wpedantic",
            "-Werror",
        ]);
        command.args(["-fsyntax-only", "-I"]).arg(crate_dir().join("../c/include"));
        let output = command.arg(crate_dir().join(HEADER)).output().unwrap();
        assert!(
            output.status.success(),
            "{compiler} as {standard}:\n{}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
}

#[test]
fn header_compiles_with_gcc() {
    compile("gcc");
}

#[test]
#[ignore = "needs clang: run `cargo xtask test`"]
fn header_compiles_with_clang() {
    compile("clang");
}
