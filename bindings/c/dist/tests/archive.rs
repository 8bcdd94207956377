//! The archive alone is enough to build a program and grip: by CMake, and by pkg-config.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, Part};

const HOST: &str = "x86_64-unknown-linux-gnu";

fn scratch(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

fn passes(command: &mut Command) -> String {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let said = String::from_utf8_lossy(&[&output.stdout[..], &output.stderr].concat()).into_owned();
    assert!(output.status.success(), "{command:?}\n{said}");
    said
}

/// Builds the archive for this computer once, and unpacks it in this folder.
fn unpacked(folder: &Path) -> PathBuf {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    let name = concat!("libwsg-", env!("CARGO_PKG_VERSION"));
    let archive = BUILT.get_or_init(|| {
        let built = Path::new(env!("CARGO_TARGET_TMPDIR")).join("archive");
        passes(Command::new(env!("CARGO_BIN_EXE_dist-c")).args(["--targets", HOST, "--to"]).arg(&built));
        built.join(format!("{name}.tar.gz"))
    });
    passes(Command::new("tar").arg("-xzf").arg(archive).arg("-C").arg(folder));
    folder.join(name)
}

fn grips(program: &Path, end: &str) {
    let config = Config { time_scale: 10.0, part: Part::of_width(20.0), ..Config::default() };
    let lines = Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() };
    let server = ServerThread::start(config, &lines, None).unwrap();
    let port = server.tcp_address().unwrap().port().to_string();
    let said = passes(Command::new(program).args(["127.0.0.1", &port]));
    assert!(said.ends_with(end), "{said}");
}

#[test]
#[ignore = "needs CMake: run `cargo xtask test`"]
fn archive_is_used_with_cmake() {
    let folder = scratch("archive-cmake");
    let root = unpacked(&folder);
    let project = "cmake_minimum_required(VERSION 3.16)\nproject(grip C)\nfind_package(wsg 0.1 REQUIRED)\n\
                   add_executable(grip ${wsg_DIR}/../../../examples/posix.c)\n\
                   target_link_libraries(grip wsg::wsg)\n\
                   add_executable(host ${wsg_DIR}/../../../examples/host.c)\n\
                   target_link_libraries(host wsg::host)\n\
                   add_executable(both ${wsg_DIR}/../../../examples/posix.c)\n\
                   target_link_libraries(both wsg::host)\n";
    fs::write(folder.join("CMakeLists.txt"), project).unwrap();
    let prefix = format!("-DCMAKE_PREFIX_PATH={}", root.display());
    passes(Command::new("cmake").current_dir(&folder).args(["-S", ".", "-B", "build", &prefix]));
    passes(Command::new("cmake").current_dir(&folder).args(["--build", "build"]));
    grips(&folder.join("build/grip"), "Release Part: no error\ndone\n");
    // The blocking calls, and the session that their library contains.
    grips(&folder.join("build/host"), "acknowledge: no error\n");
    grips(&folder.join("build/both"), "Release Part: no error\ndone\n");
    // A version that the library does not have, and a board without a library.
    for (wanted, wrong) in [("0.1", "-DWSG_TARGET=z80-unknown-none"), ("9", "-DWSG_TARGET=")] {
        let find = project.replace("wsg 0.1", &format!("wsg {wanted}"));
        fs::write(folder.join("CMakeLists.txt"), find).unwrap();
        let mut cmake = Command::new("cmake");
        cmake.current_dir(&folder).args(["-S", ".", "-B", "wrong", &prefix, wrong]);
        let output = cmake.output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.contains("wsg-config.cmake"), "{wanted} {wrong}\n{said}");
    }
}

#[test]
#[ignore = "needs pkg-config: run `cargo xtask test`"]
fn archive_is_used_with_pkg_config() {
    let folder = scratch("archive-pkg-config");
    let root = unpacked(&folder);
    let mut pkg_config = Command::new("pkg-config");
    pkg_config.args(["--cflags", "--libs", "wsg"]).env("PKG_CONFIG_PATH", root.join("lib/pkgconfig"));
    let flags = passes(&mut pkg_config);
    let program = folder.join("grip");
    let mut cc = Command::new("gcc");
    cc.arg(root.join("examples/posix.c")).args(flags.split_whitespace()).arg("-o").arg(&program);
    passes(&mut cc);
    grips(&program, "Release Part: no error\ndone\n");
    for file in ["library.json", "zephyr/module.yml", "README.md", "LICENSE-MIT", "LICENSE-APACHE"] {
        assert!(!fs::read_to_string(root.join(file)).unwrap().contains("@VERSION@"), "{file}");
    }
}

#[test]
fn library_defines_no_other_global_symbols_than_its_functions() {
    let root = unpacked(&scratch("archive-symbols"));
    let library = root.join("lib").join(HOST).join("libwsg.a");
    let symbols = passes(Command::new("readelf").arg("-sW").arg(library));
    // Number, value, size, type, binding, visibility, section, name. What the compiler adds is hidden or weak.
    let columns = symbols.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
    let exported: Vec<String> = columns
        .filter(|it| matches!(it[..], [_, _, _, _, "GLOBAL", "DEFAULT", section, _] if section != "UND"))
        .map(|it| it[7].to_owned())
        .collect();
    let header = fs::read_to_string(root.join("include/wsg.h")).unwrap();
    for name in &exported {
        assert!(name.starts_with("wsg_") && header.contains(&format!("{name}(")), "{name}");
    }
    assert!(exported.len() > 60, "{exported:?}");
}
