//! The archive alone is enough to build a program and grip: by the commands of its README, CMake and pkg-config, on each system that
//! can run here. `WSG_C_ARCHIVE` names the folder of an archive with all targets. Without it, the tests outside of `whole`
//! build their own.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;

use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, Part};

const NAME: &str = concat!("libwsg-", env!("CARGO_PKG_VERSION"));
const HOST: &str = "x86_64-unknown-linux-gnu";
const WINDOWS: &str = "x86_64-pc-windows-gnu";

/// The last lines of the examples.
const POSIX_END: &str = "Release Part: no error\ndone\n";
const HOST_END: &str = "acknowledge: no error\n";

fn scratch(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

#[track_caller]
fn passes(command: &mut Command) -> String {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let printed = String::from_utf8_lossy(&[&output.stdout[..], &output.stderr].concat()).into_owned();
    assert!(output.status.success(), "{command:?}\n{printed}");
    printed
}

#[track_caller]
fn shell(folder: &Path, script: &str) -> String {
    passes(Command::new("sh").current_dir(folder).args(["-ec", script]))
}

/// Unpacks the archive in a folder of this name, after building it for this target unless the environment names one.
fn unpacked(name: &str, target: &'static str) -> PathBuf {
    static BUILT: Mutex<BTreeMap<&str, PathBuf>> = Mutex::new(BTreeMap::new());
    let build = || {
        let built = Path::new(env!("CARGO_TARGET_TMPDIR")).join("archive").join(target);
        passes(Command::new(env!("CARGO_BIN_EXE_dist-c")).args(["--targets", target, "--to"]).arg(&built));
        built
    };
    let built = std::env::var_os("WSG_C_ARCHIVE").map(PathBuf::from);
    let built = built.unwrap_or_else(|| BUILT.lock().unwrap().entry(target).or_insert_with(build).clone());
    let folder = scratch(name);
    passes(Command::new("tar").arg("-xzf").arg(built.join(format!("{NAME}.tar.gz"))).arg("-C").arg(&folder));
    folder.join(NAME)
}

fn gripper() -> (ServerThread, String) {
    let config = Config { time_scale: 10.0, part: Part::of_width(20.0), ..Config::default() };
    let lines = Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() };
    let server = ServerThread::start(config, &lines, None).unwrap();
    let port = server.tcp_address().unwrap().port().to_string();
    (server, port)
}

/// Runs a program twice. The second run fails if the first one has left the gripper in FAST STOP.
#[track_caller]
fn grips(program: &mut Command, end: &str) {
    let (_server, port) = gripper();
    program.args(["127.0.0.1", &port]);
    for _ in 0..2 {
        let printed = passes(program);
        assert!(printed.ends_with(end), "{printed}");
    }
}

/// Returns the code blocks of a language in the archive's README.
fn blocks(root: &Path, language: &str) -> Vec<String> {
    let readme = fs::read_to_string(root.join("README.md")).unwrap();
    let begin = format!("```{language}\n");
    let blocks = readme.split(&begin).skip(1);
    blocks.map(|block| block.split_once("```").unwrap().0.to_owned()).collect()
}

/// Returns the commands in the README that contain this text.
fn commands(root: &Path, with: &str) -> String {
    blocks(root, "sh").into_iter().find(|block| block.contains(with)).unwrap()
}

#[test]
fn commands_of_the_readme_grip() {
    let root = unpacked("archive-readme", HOST);
    fs::write(root.join("grip.c"), &blocks(&root, "c")[0]).unwrap();
    let (_server, port) = gripper();
    let commands = commands(&root, "-o grip\n./grip").replace("11000", &port);
    for _ in 0..2 {
        let printed = shell(&root, &commands);
        assert_eq!(printed, "Homing: no error\nGrip Part: no error\nDisconnect Announcement: no error\n");
    }
}

/// Compiles an example as its comment states, and returns the program.
fn compiled(root: &Path, source: &str) -> PathBuf {
    let text = fs::read_to_string(root.join("examples").join(source)).unwrap();
    let mut lines = text.lines().map(|line| line.trim_start_matches([' ', '*', '/']));
    let line = lines.find(|line| line.starts_with("cc ") || line.starts_with("c++ ")).unwrap();
    shell(root, line);
    root.join(line.rsplit(' ').next().unwrap())
}

#[test]
fn examples_grip_twice_when_compiled_as_their_comments_state() {
    let root = unpacked("archive-examples", HOST);
    for (source, end) in
        [("posix.c", POSIX_END), ("cpp_host.cpp", "acknowledge: done\nmove: done\n"), ("host.c", HOST_END)]
    {
        grips(&mut Command::new(compiled(&root, source)), end);
    }
}

#[test]
fn parser_alone_finds_a_frame_after_noise() {
    let root = unpacked("archive-parser", HOST);
    let output = Command::new(compiled(&root, "parser.c")).output().unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stdout), "25h: an intact frame with 2 bytes of payload\n");
}

#[test]
fn pages_of_the_archive_point_only_at_its_files() {
    let root = unpacked("archive-pages", HOST);
    for page in ["README.md", "docs/c.md"] {
        let text = fs::read_to_string(root.join(page)).unwrap();
        let targets: Vec<&str> = text.split("](").skip(1).filter_map(|rest| rest.split(')').next()).collect();
        assert!(!targets.is_empty(), "{page}");
        for target in targets {
            assert!(root.join(page).parent().unwrap().join(target).exists(), "{page} points at {target}");
        }
    }
    let pages = ["library.json", "zephyr/module.yml", "README.md", "LICENSE-MIT", "LICENSE-APACHE"];
    for file in pages.iter().chain(&["lib/pkgconfig/wsg.pc", "lib/cmake/wsg/wsg-config-version.cmake"]) {
        assert!(!fs::read_to_string(root.join(file)).unwrap().contains("@VERSION@"), "{file}");
    }
}

#[test]
fn archive_names_no_folder_of_the_computer_that_built_it() {
    let root = unpacked("archive-paths", HOST);
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(3).unwrap();
    let script = format!("! grep -rlF -e '{}/' -e '/.cargo/registry' .", repository.display());
    shell(&root, &script);
}

#[test]
#[ignore = "needs CMake: run `cargo xtask test`"]
fn archive_is_used_with_cmake() {
    let root = unpacked("archive-cmake", HOST);
    let folder = root.parent().unwrap();
    let mut project =
        "cmake_minimum_required(VERSION 3.16)\nproject(grip C)\nfind_package(wsg 0.1 REQUIRED)\n\
                       set(examples ${wsg_DIR}/../../../examples)\n"
            .to_owned();
    // The blocking calls also contain the session.
    let programs = [
        ("grip", "posix.c", "wsg::wsg", POSIX_END),
        ("both", "posix.c", "wsg::host", POSIX_END),
        ("host", "host.c", "wsg::host", HOST_END),
        ("shared", "host.c", "wsg::host_shared pthread m", HOST_END),
    ];
    for (program, source, libraries, _) in programs {
        project += &format!("add_executable({program} ${{examples}}/{source})\n");
        project += &format!("target_link_libraries({program} {libraries})\n");
    }
    fs::write(folder.join("CMakeLists.txt"), &project).unwrap();
    let prefix = format!("-DCMAKE_PREFIX_PATH={}", root.display());
    shell(folder, &format!("cmake -S . -B build {prefix} && cmake --build build"));
    for (program, _, _, end) in programs {
        grips(&mut Command::new(folder.join("build").join(program)), end);
    }
    // A version that the library does not have, and a board without a library.
    for (wanted, wrong) in [("0.1", "-DWSG_TARGET=z80-unknown-none"), ("9", "-DWSG_TARGET=")] {
        let find = project.replace("wsg 0.1", &format!("wsg {wanted}"));
        fs::write(folder.join("CMakeLists.txt"), find).unwrap();
        let mut cmake = Command::new("cmake");
        cmake.current_dir(folder).args(["-S", ".", "-B", "wrong", &prefix, wrong]);
        let output = cmake.output().unwrap();
        let printed = String::from_utf8_lossy(&output.stderr);
        assert!(
            !output.status.success() && printed.contains("wsg-config.cmake"),
            "{wanted} {wrong}\n{printed}"
        );
    }
}

#[test]
#[ignore = "needs pkg-config: run `cargo xtask test`"]
fn archive_is_used_with_pkg_config() {
    let root = unpacked("archive-pkg-config", HOST);
    for (source, library, end) in [("posix.c", "wsg", POSIX_END), ("host.c", "wsg_host", HOST_END)] {
        let line = commands(&root, "pkg-config").replace("grip.c", &format!("examples/{source}"));
        let line = line.replace("--libs wsg)", &format!("--libs {library})"));
        shell(&root, &format!("export PKG_CONFIG_PATH=lib/pkgconfig\n{line}"));
        grips(&mut Command::new(root.join("grip")), end);
    }
}

#[test]
fn program_of_the_recorded_abi_grips_with_the_shared_library() {
    let root = unpacked("archive-shared", HOST);
    // Compiled with the recorded headers, whose include guards replace the present ones.
    let version = env!("CARGO_PKG_VERSION").rsplit_once('.').unwrap().0;
    let link = format!(
        "C={}/..; H=$C/../c-host
         cc -D_POSIX_C_SOURCE=200809L -include $C/abi/wsg-{version}.h -include $H/abi/wsg_host-{version}.h -I include \\
             -I $C/tests/shared examples/host.c $C/abi/wsg-{version}.c $H/abi/wsg_host-{version}.c \\
             -L lib/{HOST}/shared -lwsg_host -lpthread -lm -o host
         readelf -d host",
        env!("CARGO_MANIFEST_DIR")
    );
    let needed = shell(&root, &link);
    assert!(needed.contains("Shared library: [libwsg_host.so.0]"), "{needed}");
    let shared = root.join("lib").join(HOST).join("shared");
    grips(Command::new(root.join("host")).env("LD_LIBRARY_PATH", &shared), HOST_END);

    let exported = shell(&shared, "nm --dynamic --defined-only libwsg_host.so");
    let exported: Vec<&str> = exported.lines().filter_map(|line| line.split(' ').nth(2)).collect();
    let headers =
        ["wsg.h", "wsg_host.h"].map(|name| fs::read_to_string(root.join("include").join(name)).unwrap());
    for name in &exported {
        assert!(headers.iter().any(|header| header.contains(&format!("{name}("))), "{name}");
    }
    assert!(exported.len() > 100, "{exported:?}");
}

mod wine {
    use super::*;

    /// `cargo xtask platforms` starts Wine, and puts a library that Wine needs into the folder of this program.
    #[test]
    #[ignore = "needs Wine and MinGW: run `cargo xtask platforms`"]
    fn host_example_grips_on_windows() {
        let root = unpacked("archive-windows", WINDOWS);
        let source = fs::read_to_string(root.join("examples/host.c")).unwrap();
        let (_, line) = source.split_once(" *     gcc ").unwrap();
        let line = line.lines().next().unwrap();
        shell(&root, &format!("x86_64-w64-mingw32-gcc {line}"));
        let folder = Path::new(&std::env::var_os("WSG_SIM_EXE").unwrap()).parent().unwrap().to_owned();
        fs::copy(root.join("host.exe"), folder.join("host.exe")).unwrap();
        let (_server, port) = gripper();
        // Into a file, because services of Wine would keep a pipe open.
        shell(&folder, &format!("wine host.exe 127.0.0.1 {port} > host.txt 2> host.err < /dev/null"));
        let printed = fs::read_to_string(folder.join("host.txt")).unwrap().replace('\r', "");
        assert!(printed.ends_with(HOST_END), "{printed}");
    }
}

/// Tests that need the archive with all targets.
mod whole {
    use super::*;

    struct Running(Child);

    impl Drop for Running {
        fn drop(&mut self) {
            let _ = self.0.kill();
            let _ = self.0.wait();
        }
    }

    fn start(root: &Path, line: &str) -> Running {
        let mut shell = Command::new("sh");
        shell.current_dir(root).args(["-ec", &format!("exec {line}")]).stdin(Stdio::null());
        Running(shell.stdout(Stdio::piped()).spawn().unwrap())
    }

    #[test]
    #[ignore = "needs arm_none_eabi_gcc, QEMU and all targets: run `cargo xtask dist-c`"]
    fn readme_commands_with_arm_none_eabi_gcc_grip_in_the_emulator() {
        let root = unpacked("archive-board", "");
        let simulator = commands(&root, "--log -").replace("11000", "0").replace("8080", "0");
        let mut simulator = start(&root, &simulator);
        let mut log = BufReader::new(simulator.0.stdout.take().unwrap()).lines().map(Result::unwrap);
        let mut line_with = |text: &str| log.by_ref().find(|line| line.contains(text)).unwrap();
        let port = |line: String| line.rsplit(':').next().unwrap().to_owned();
        let tcp = port(line_with("tcp 127.0.0.1:"));
        let control = port(line_with("control 127.0.0.1:"));

        let script = commands(&root, "qemu-system-arm").replace("11000", &tcp);
        let (compile, emulate) = script.split_at(script.find("qemu-system-arm").unwrap());
        shell(&root, compile);
        let _board = start(&root, emulate);
        line_with("Grip Part E_SUCCESS");
        shell(&root, &commands(&root, "curl").replace("8080", &control));

        line_with("PART LOST");
        line_with("Release Part E_SUCCESS");
        line_with("Issue FAST STOP E_SUCCESS");
    }

    #[test]
    #[ignore = "needs all targets: run `cargo xtask dist-c`"]
    fn simulator_of_the_archive_needs_no_shared_library() {
        let root = unpacked("archive-static", "");
        let headers = passes(Command::new("readelf").arg("-lW").arg(root.join("bin/wsg-sim")));
        assert!(headers.contains("LOAD") && !headers.contains("INTERP"), "{headers}");
    }

    #[test]
    #[ignore = "needs programs for aarch64 and all targets: run `cargo xtask dist-c`"]
    fn host_example_grips_on_aarch64() {
        let root = unpacked("archive-aarch64", "");
        let cc = "aarch64-linux-gnu-gcc -I include examples/host.c -L lib/aarch64-unknown-linux-gnu";
        shell(&root, &format!("{cc} -lwsg_host -lpthread -ldl -lm -o host"));
        shell(&root, &format!("{cc}/shared -lwsg_host -lpthread -lm -o shared"));
        let libraries = root.join("lib/aarch64-unknown-linux-gnu/shared");
        for program in ["host", "shared"] {
            let mut qemu = Command::new("qemu-aarch64-static");
            qemu.current_dir(&root).args(["-L", "/usr/aarch64-linux-gnu", "-E"]);
            grips(qemu.arg(format!("LD_LIBRARY_PATH={}", libraries.display())).arg(program), HOST_END);
        }
    }

    /// The second library is the first one with other names. So it has the same objects of the Rust compiler.
    #[test]
    #[ignore = "needs arm_none_eabi_gcc and all targets: run `cargo xtask dist-c`"]
    fn arm_none_eabi_gcc_links_libwsg_beside_another_rust_library() {
        let root = unpacked("archive-two", "");
        let program = "#include \"wsg.h\"\nint32_t other_wsg_tick(wsg_t *, uint32_t);\nstatic wsg_t wsg;\n\
                       int start(void) { return (int)(wsg_tick(&wsg, 0) + other_wsg_tick(&wsg, 0)); }\n";
        fs::write(root.join("two.c"), program).unwrap();
        for (target, options) in [
            ("thumbv6m-none-eabi", "-mcpu=cortex-m0plus"),
            ("thumbv7em-none-eabi", "-mcpu=cortex-m4"),
            ("thumbv7em-none-eabihf", "-mcpu=cortex-m4 -mfpu=fpv4-sp-d16 -mfloat-abi=hard"),
            ("thumbv8m.main-none-eabi", "-mcpu=cortex-m33+nofp"),
        ] {
            let script = format!(
                "arm-none-eabi-nm --defined-only lib/{target}/libwsg.a |
                     sed -n 's/.* \\(wsg_[a-z0-9_]*\\)$/\\1 other_\\1/p' > names
                 arm-none-eabi-objcopy --redefine-syms=names lib/{target}/libwsg.a other.a
                 arm-none-eabi-gcc -mthumb {options} -ffreestanding -nostdlib -I include two.c lib/{target}/libwsg.a other.a \
                     -Wl,-e,start -o two.elf
                 arm-none-eabi-nm two.elf"
            );
            let symbols = shell(&root, &script);
            assert!(symbols.contains(" wsg_tick") && symbols.contains(" other_wsg_tick"), "{symbols}");
        }
    }
}
