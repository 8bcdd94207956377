//! Programs in C, compiled and linked with the static library, against the virtual gripper.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use wsg_sim::server::{Lines, SerialLine, ServerThread};
use wsg_sim::{Config, Part};

fn crate_dir() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Builds the static library for this computer once.
fn library() -> &'static Path {
    static LIBRARY: OnceLock<PathBuf> = OnceLock::new();
    LIBRARY.get_or_init(|| {
        // A folder of its own, because the calling cargo may have locked its own one.
        let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("libwsg");
        let mut cargo = Command::new(env!("CARGO"));
        cargo.current_dir(crate_dir()).args([
            "rustc",
            "--locked",
            "--quiet",
            "--lib",
            "--profile",
            "c-library",
        ]);
        cargo
            .args(["--crate-type", "staticlib", "--features", "static-library", "--target-dir"])
            .arg(&target);
        assert!(cargo.status().unwrap().success());
        target.join("c-library/libwsg.a")
    })
}

/// Compiles a program with the library, with all warnings as errors.
fn program(source: &str, name: &str, arguments: &[&str]) -> PathBuf {
    let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let (compiler, standard) =
        if source.ends_with(".cpp") { ("g++", "-std=c++17") } else { ("gcc", "-std=c99") };
    let mut gcc = Command::new(compiler);
    gcc.args([standard, "-g", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"]);
    gcc.arg(crate_dir().join("include")).args(arguments).arg(crate_dir().join(source)).arg(library());
    let output = gcc.arg("-o").arg(&program).output().unwrap();
    assert!(output.status.success(), "{source}:\n{}", said(&output));
    program
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr].concat()).into_owned()
}

fn passes(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}: {}\n{}", output.status, said(&output));
    said(&output)
}

fn gripper(lines: &Lines) -> ServerThread {
    let config = Config { time_scale: 10.0, part: Part::of_width(20.0), ..Config::default() };
    ServerThread::start(config, lines, None).unwrap()
}

const CYCLE: &str = "connected\nHoming: no error\nGrip Part: no error\nRelease Part: no error\ndone\n";

#[test]
fn posix_example_grips_over_tcp() {
    let server = gripper(&Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() });
    let port = server.tcp_address().unwrap().port().to_string();
    let posix = program("examples/posix.c", "posix-tcp", &["-fsanitize=address,undefined"]);
    assert_eq!(passes(Command::new(posix).args(["127.0.0.1", &port])), CYCLE);
}

#[test]
fn program_compiled_with_a_recorded_header_links_and_grips() {
    let abi_version = |header: &Path| {
        let header = std::fs::read_to_string(header).unwrap();
        header.lines().find(|line| line.contains("WSG_ABI_VERSION")).unwrap().to_owned()
    };
    let current = abi_version(&crate_dir().join("include/wsg.h"));
    let files = std::fs::read_dir(crate_dir().join("abi")).unwrap().map(|entry| entry.unwrap().path());
    let of_this_abi = |path: &PathBuf| path.extension().unwrap() == "h" && abi_version(path) == current;
    let headers: Vec<PathBuf> = files.filter(of_this_abi).collect();
    assert!(!headers.is_empty(), "no recorded header with {current}");
    for header in headers {
        let include = format!("-I{}", crate_dir().join("tests/shared").display());
        let [header, record] =
            [header.clone(), header.with_extension("c")].map(|it| it.display().to_string());
        // The include guard replaces the present header with the recorded one.
        let options = ["-D_POSIX_C_SOURCE=200809L", "-include", &header, &include, &record];
        let posix = program("examples/posix.c", "posix-recorded", &options);
        let server = gripper(&Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() });
        let port = server.tcp_address().unwrap().port().to_string();
        assert_eq!(passes(Command::new(posix).args(["127.0.0.1", &port])), CYCLE);
    }
}

#[test]
fn posix_example_grips_over_a_pseudo_terminal() {
    let server = gripper(&Lines { serial: Some(SerialLine::Pty), ..Lines::default() });
    let posix = program("examples/posix.c", "posix-serial", &[]);
    assert_eq!(passes(Command::new(posix).arg(server.serial_path().unwrap())), CYCLE);
}

#[test]
fn cpp_example_grips_and_needs_no_exceptions() {
    let server = gripper(&Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() });
    let port = server.tcp_address().unwrap().port().to_string();
    let options = ["-fno-exceptions", "-fno-rtti", "-fsanitize=address,undefined"];
    let cpp = program("examples/cpp_host.cpp", "cpp-host", &options);
    let expected = "connect: done\nhome: done\nforce: done\nopen: done\ngrip: done\na part is held\nwidth: 20 mm\n\
                    release: done\nfast stop: done\nmove: access denied, in FAST STOP for example\nacknowledge: done\n\
                    move: done\n";
    assert_eq!(passes(Command::new(cpp).args(["127.0.0.1", &port])), expected);
}

#[test]
fn example_in_the_readme_grips() {
    let readme = std::fs::read_to_string(crate_dir().join("README.md")).unwrap();
    let (_, code) = readme.split_once("```c\n").unwrap();
    let (code, _) = code.split_once("```").unwrap();
    let source = Path::new(env!("CARGO_TARGET_TMPDIR")).join("grip.c");
    std::fs::write(&source, code).unwrap();
    let server = gripper(&Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() });
    let port = server.tcp_address().unwrap().port().to_string();
    let grip = program(source.to_str().unwrap(), "grip", &["-std=gnu99"]);
    assert_eq!(passes(Command::new(grip).arg(&port)), "Homing: no error\nGrip Part: no error\n");
}

#[test]
fn no_function_of_the_library_can_panic() {
    // A reachable panic would call an undefined function; see the panic handler.
    let undefined = passes(Command::new("nm").arg("--undefined-only").arg(library()));
    assert!(undefined.contains(" U memcpy"), "{undefined}");
    assert!(!undefined.contains("a_panic_can_be_reached"));
}

/// Steps of the program that misuses every function; `WSG_WHOLE=1` runs more.
fn misuse_steps(few: u32, many: u32) -> String {
    let steps = if std::env::var_os("WSG_WHOLE").is_some() { many } else { few };
    steps.to_string()
}

#[test]
fn misuse_returns_errors_under_the_sanitizers() {
    let options = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"];
    let misuse = program("tests/misuse.c", "misuse-sanitized", &options);
    for seed in 1..=2 {
        let steps = misuse_steps(100_000, 20_000_000);
        let said = passes(Command::new(&misuse).args([&steps, &seed.to_string()]));
        assert!(said.contains(" rejected"), "{said}");
    }
}

#[test]
#[ignore = "needs Valgrind: run `cargo xtask test`"]
fn misuse_touches_no_foreign_memory_under_valgrind() {
    let misuse = program("tests/misuse.c", "misuse", &[]);
    let mut valgrind = Command::new("valgrind");
    valgrind.args(["--quiet", "--error-exitcode=9", "--leak-check=full"]).arg(misuse);
    passes(valgrind.args([&misuse_steps(50_000, 2_000_000), "5"]));
}
