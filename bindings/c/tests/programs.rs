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
    assert!(output.status.success(), "{source}:\n{}", printed(&output));
    program
}

fn printed(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr].concat()).into_owned()
}

fn passes(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}: {}\n{}", output.status, printed(&output));
    printed(&output)
}

/// Runs a program twice. The second run fails if the first one has left the gripper in FAST STOP.
#[track_caller]
fn passes_twice(command: &mut Command) -> String {
    let first = passes(command);
    assert_eq!(passes(command), first, "the second run differs");
    first
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
    assert_eq!(passes_twice(Command::new(posix).args(["127.0.0.1", &port])), CYCLE);
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
        assert_eq!(passes_twice(Command::new(posix).args(["127.0.0.1", &port])), CYCLE);
    }
}

#[test]
fn posix_example_grips_over_a_pseudo_terminal() {
    let server = gripper(&Lines { serial: Some(SerialLine::Pty), ..Lines::default() });
    let posix = program("examples/posix.c", "posix-serial", &[]);
    assert_eq!(passes_twice(Command::new(posix).arg(server.serial_path().unwrap())), CYCLE);
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
    assert_eq!(passes_twice(Command::new(cpp).args(["127.0.0.1", &port])), expected);
}

/// Prints whether the gripper is in FAST STOP after a connection, and leaves it in FAST STOP if an argument requests it.
const ENDS: &str = r#"
#include <cstdio>
#include <cstdlib>
#define main example
#include "cpp_host.cpp"
#undef main

int main(int count, char **arguments)
{
    wsg::gripper gripper{tcp_line(arguments[1], arguments[2])};
    if (!gripper.connect()) {
        return 1;
    }
    std::puts(gripper.known().flags & WSG_FLAG_FAST_STOP ? "locked" : "free");
    switch (count > 3 ? *arguments[3] : 0) {
    case 'f': return gripper.fast_stop() ? 0 : 1;
    case 'a': return gripper.acknowledge() ? 0 : 1;
    case 'c': return gripper.close() && gripper.close() && !gripper.stop() ? 0 : 1;
    case 'x': std::fflush(stdout); std::_Exit(0);
    default: return 0;
    }
}
"#;

#[test]
fn cpp_gripper_announces_its_end_unless_it_is_in_fast_stop() {
    let source = Path::new(env!("CARGO_TARGET_TMPDIR")).join("ends.cpp");
    std::fs::write(&source, ENDS).unwrap();
    let examples = format!("-I{}", crate_dir().join("examples").display());
    let options = [&examples[..], "-Wno-unused-function", "-fsanitize=address,undefined"];
    let ends = program(source.to_str().unwrap(), "cpp-ends", &options);
    let server = gripper(&Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() });
    let port = server.tcp_address().unwrap().port().to_string();
    let run = |action: &str| passes(Command::new(&ends).args(["127.0.0.1", &port, action]));
    // Each action, and the state that the program before has left.
    for (action, found) in [
        ("", "free\n"),
        ("close", "free\n"),
        ("f", "free\n"),
        ("", "locked\n"),
        ("acknowledge", "locked\n"),
        ("x", "free\n"),
        ("acknowledge", "locked\n"),
        ("", "free\n"),
    ] {
        assert_eq!(run(action), found, "{action}");
    }
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
    let expected = "Homing: no error\nGrip Part: no error\nDisconnect Announcement: no error\n";
    assert_eq!(passes_twice(Command::new(grip).arg(&port)), expected);
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
        let printed = passes(Command::new(&misuse).args([&steps, &seed.to_string()]));
        assert!(printed.contains(" rejected"), "{printed}");
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

/// Valid arguments for every function, by type: `p_` for a pointer, `v_` for a value.
const VALID_ARGUMENTS: &str = r#"
static wsg_t *p_wsg_t = &(wsg_t){{0}};
static wsg_config_t *p_wsg_config_t = &(wsg_config_t){0};
static wsg_known_t *p_wsg_known_t = &(wsg_known_t){0};
static wsg_counters_t *p_wsg_counters_t = &(wsg_counters_t){0};
static wsg_queue_t *p_wsg_queue_t = &(wsg_queue_t){0};
static wsg_event_t p_wsg_event_t[0x120];
static wsg_parser_t *p_wsg_parser_t = &(wsg_parser_t){{0}};
static wsg_frame_t *p_wsg_frame_t = &(wsg_frame_t){0};
static wsg_can_t *p_wsg_can_t = &(wsg_can_t){{0}};
static wsg_can_frame_t p_wsg_can_frame_t[64];
static wsg_can_counters_t *p_wsg_can_counters_t = &(wsg_can_counters_t){0};
static wsg_fieldbus_t *p_wsg_fieldbus_t = &(wsg_fieldbus_t){{0}};
static uint8_t p_uint8_t[64];
static char *p_char = "tag";
static uint32_t *p_uint32_t = &(uint32_t){0};
static size_t *p_size_t = &(size_t){0};
static void *p_void;
static const uint8_t v_uint8_t = 1;
static const uint16_t v_uint16_t = 0x120;
static const uint32_t v_uint32_t = 0;
static const size_t v_size_t = sizeof p_uint8_t;
static const float v_float = 1.0f;

static void v_wsg_callback_t(void *context, const wsg_event_t *event)
{
    (void)context, (void)event;
}

static int wrong;

#define CHECK(call, expected) check((call), (expected), #call)

static void check(int32_t returned, int32_t expected, const char *call)
{
    if (returned != expected) {
        wrong = 1;
        printf("%s returned %d instead of %d\n", call, (int)returned, (int)expected);
    }
}

int main(void)
{
    static uint8_t success[2];

    wsg_init(p_wsg_t, NULL, NULL, NULL);
    wsg_can_init(p_wsg_can_t, 0x120);
    wsg_fieldbus_attach(p_wsg_fieldbus_t, p_wsg_t);
    p_wsg_frame_t->payload = success;
    p_wsg_frame_t->length = sizeof success;
    p_wsg_frame_t->id = WSG_COMMAND_STOP;
    p_wsg_frame_t->kind = WSG_FRAME_INTACT;
"#;

/// Arguments that may be null, or longer than any memory, because the library does not use them or not beyond its own limit.
const PERMITTED: [(&str, &str); 5] = [
    ("init", "config"),
    ("init", "context"),
    ("queue_init", "bytes"),
    ("queue_init", "bytes_size"),
    ("can_split", "capacity"),
];

/// Returns a program that calls each function with valid arguments but one: a null pointer, or a size that no memory has.
fn calls_with_one_wrong_argument() -> (String, usize) {
    let header = std::fs::read_to_string(crate_dir().join("include/wsg.h")).unwrap();
    let mut program = format!("#include <stdio.h>\n#include \"wsg.h\"\n{VALID_ARGUMENTS}");
    let mut count = 0;
    let one_line = header.replace('\n', " ");
    for prototype in one_line.split(" int32_t wsg_").skip(1).filter_map(|rest| rest.split(");").next()) {
        let (function, parameters) = prototype.split_once('(').unwrap();
        // Type, whether it is a pointer, name.
        let parameters = parameters.split(',').map(|parameter| {
            let (kind, name) = parameter.trim().rsplit_once([' ', '*']).unwrap();
            (kind.replace("const ", "").trim().to_owned(), parameter.contains('*'), name)
        });
        let parameters: Vec<_> = parameters.collect();
        let valid = parameters.iter().map(|(kind, is_pointer, _)| {
            let kind = kind.trim_end_matches([' ', '*']);
            format!("{}_{kind}", if *is_pointer { "p" } else { "v" })
        });
        let valid: Vec<String> = valid.collect();
        for (at, (kind, is_pointer, name)) in parameters.iter().enumerate() {
            let (value, expected) = match (*is_pointer, &kind[..]) {
                _ if PERMITTED.contains(&(function, *name)) => continue,
                (true, _) => ("NULL", "NULL_POINTER"),
                (false, "size_t") => ("SIZE_MAX", "TOO_LONG"),
                _ => continue,
            };
            let mut arguments = valid.clone();
            arguments[at] = value.to_owned();
            program +=
                &format!("    CHECK(wsg_{function}({}), WSG_ERROR_{expected});\n", arguments.join(", "));
            count += 1;
        }
    }
    (program + "    return wrong;\n}\n", count)
}

#[test]
fn null_pointers_and_impossible_sizes_have_their_own_errors() {
    let (calls, count) = calls_with_one_wrong_argument();
    assert!(count > 80, "{count} calls");
    let source = Path::new(env!("CARGO_TARGET_TMPDIR")).join("one-wrong-argument.c");
    std::fs::write(&source, calls).unwrap();
    let program = program(source.to_str().unwrap(), "one-wrong-argument", &["-Wno-unused-variable"]);
    assert_eq!(passes(&mut Command::new(program)), "");
}
