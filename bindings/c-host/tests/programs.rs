//! The example in C, linked with the static library, against the virtual gripper.

use std::path::Path;
use std::process::{Command, Output};

use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, Part};

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr].concat()).into_owned()
}

#[test]
fn host_example_grips_is_stopped_by_a_thread_and_follows_set_points() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("libwsg_host");
    let mut cargo = Command::new(env!("CARGO"));
    cargo.current_dir(folder).args(["rustc", "--locked", "--quiet", "--lib", "--crate-type", "staticlib"]);
    assert!(cargo.arg("--target-dir").arg(&target).status().unwrap().success());
    let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join("host");
    let mut gcc = Command::new("gcc");
    gcc.args(["-std=c99", "-g", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsanitize=undefined"]);
    gcc.arg("-I").arg(folder.join("include")).arg("-I").arg(folder.join("../c/include"));
    gcc.arg(folder.join("examples/host.c")).arg(target.join("debug/libwsg_host.a"));
    let output = gcc.args(["-lpthread", "-ldl", "-lm", "-o"]).arg(&program).output().unwrap();
    assert!(output.status.success(), "{}", said(&output));

    let config = Config { time_scale: 4.0, part: Part::of_width(20.0), ..Config::default() };
    let lines = Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() };
    let server = ServerThread::start(config, &lines, None).unwrap();
    let port = server.tcp_address().unwrap().port().to_string();
    let output = Command::new(program).args(["127.0.0.1", &port]).output().unwrap();
    let expected = "open: no error\nhome: no error\ngrip: no error\nwidth: no error\nheld, 20 mm\nrelease: no error\n\
                    stop handle: no error\nmove: stopped by a handle\nstream: no error\ntarget: no error\nat 40 mm\n\
                    end: no error\nfast stop: no error\nmove: access denied, in FAST STOP for example\n\
                    acknowledge: no error\n";
    assert_eq!((said(&output).as_str(), output.status.code()), (expected, Some(0)));
}
