//! The example in C, linked with the static library, against the virtual gripper over every line.

use std::mem::MaybeUninit;
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::ptr;
use std::sync::OnceLock;

use wsg_host::gripper::{wsg_host_close, wsg_host_open_tcp, wsg_host_raw};
use wsg_host::wsg_host_error;
use wsg_protocol::Status;
use wsg_sim::server::{Lines, SerialLine, ServerThread, UdpLine};
use wsg_sim::{Config, Part};

fn printed(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr].concat()).into_owned()
}

/// Builds library and example once.
fn example() -> &'static Path {
    static EXAMPLE: OnceLock<PathBuf> = OnceLock::new();
    EXAMPLE.get_or_init(|| {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
        let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("libwsg_host");
        let mut cargo = Command::new(env!("CARGO"));
        cargo.current_dir(folder).args([
            "rustc",
            "--locked",
            "--quiet",
            "--lib",
            "--crate-type",
            "staticlib",
        ]);
        assert!(cargo.arg("--target-dir").arg(&target).status().unwrap().success());
        let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join("host");
        let mut gcc = Command::new("gcc");
        gcc.args(["-std=c99", "-g", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsanitize=undefined"]);
        gcc.arg("-I").arg(folder.join("include")).arg("-I").arg(folder.join("../c/include"));
        gcc.arg(folder.join("examples/host.c")).arg(target.join("debug/libwsg_host.a"));
        let output = gcc.args(["-lpthread", "-ldl", "-lm", "-o"]).arg(&program).output().unwrap();
        assert!(output.status.success(), "{}", printed(&output));
        program
    })
}

/// Runs the example on the lines of a virtual gripper: it grips, is stopped by a thread, and follows set-points.
#[track_caller]
fn runs(lines: &Lines, arguments: impl FnOnce(&ServerThread) -> Vec<String>) {
    let config = Config { time_scale: 4.0, part: Part::of_width(20.0), ..Config::default() };
    let server = ServerThread::start(config, lines, None).unwrap();
    let output = Command::new(example()).args(arguments(&server)).output().unwrap();
    let expected = "open: no error\nhome: no error\ngrip: no error\nwidth: no error\nheld, 20 mm\nrelease: no error\n\
                    stop handle: no error\nmove: stopped by a handle\nstream: no error\ntarget: no error\n\
                    width: outside the limits of the gripper\nnow: no error\ntime: argument outside its range\nat 40 mm\n\
                    end: no error\nfast stop: no error\nmove: access denied, in FAST STOP for example\n\
                    acknowledge: no error\n";
    assert_eq!((printed(&output).as_str(), output.status.code()), (expected, Some(0)));
}

#[test]
fn host_example_runs_over_tcp() {
    let lines = Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() };
    runs(&lines, |server| {
        let address = server.tcp_address().unwrap();
        vec![address.ip().to_string(), address.port().to_string()]
    });
}

#[test]
fn host_example_runs_over_udp() {
    // The library binds the port for replies. The system gives ports from 32768 on to any program, so this one is below.
    let first = 30_000 + (std::process::id() % 2_000) as u16;
    let free = (first..32_768).find(|port| UdpSocket::bind(("127.0.0.1", *port)).is_ok()).unwrap();
    let line = UdpLine { address: "127.0.0.1:0".parse().unwrap(), remote_port: free };
    runs(&Lines { udp: Some(line), ..Lines::default() }, |server| {
        let address = server.udp_address().unwrap();
        vec![address.ip().to_string(), address.port().to_string(), free.to_string()]
    });
}

#[test]
fn host_example_runs_over_a_pseudo_terminal() {
    runs(&Lines { serial: Some(SerialLine::Pty), ..Lines::default() }, |server| {
        vec![server.serial_path().unwrap().to_str().unwrap().to_owned()]
    });
}

#[test]
fn only_payloads_up_to_256_bytes_are_sent() {
    let lines = Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() };
    let server = ServerThread::start(Config::default(), &lines, None).unwrap();
    let port = server.tcp_address().unwrap().port();
    let mut gripper = MaybeUninit::uninit();
    assert_eq!(unsafe { wsg_host_open_tcp(c"127.0.0.1".as_ptr(), port, Some(&mut gripper)) }, 0);
    let gripper = unsafe { gripper.assume_init() };
    let raw = |payload: &[u8]| unsafe {
        let (reply, mut reply_length) = (ptr::null_mut(), 0);
        wsg_host_raw(gripper.as_mut(), 0xA0, payload.as_ptr(), payload.len(), reply, Some(&mut reply_length))
    };
    assert_eq!(raw(&[0; 257]), wsg_host_error::TooLong as i32);
    // No script serves the command.
    assert_eq!(raw(&[0; 256]), i32::from(Status::CmdUnknown.code()));
    unsafe { wsg_host_close(gripper) };
}
