//! Tests of the whole release folder, built from the tested image.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use document::root;

const IMAGE: &str = "WSG_FIRMWARE_ELF";

/// Runs the program. Returns the named files.
fn folder(elf: &Path, to: &Path) -> Vec<(String, Vec<u8>)> {
    let mut dist = Command::new(env!("CARGO_BIN_EXE_dist"));
    assert!(dist.args(["folder", "--elf"]).arg(elf).arg("--to").arg(to).status().unwrap().success());
    files(to)
}

fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    let mut files: Vec<_> = entries
        .map(|entry| (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap()))
        .collect();
    files.sort();
    files
}

fn image() -> PathBuf {
    env::var_os(IMAGE).expect("`cargo xtask test` sets WSG_FIRMWARE_ELF to the image's path").into()
}

fn scratch(name: &str) -> PathBuf {
    env::temp_dir().join(format!("wsg-dist-{name}-{}", std::process::id()))
}

#[test]
#[ignore = "needs the image: cargo xtask test"]
fn folder_contains_no_machine_paths_and_is_reproducible() {
    let to = scratch("folder");
    let first = folder(&image(), &to);
    let again = folder(&image(), &to);

    fs::remove_dir_all(&to).unwrap();
    assert!(first == again, "the second run differs");
    let cargo = env::home_dir().unwrap().join(".cargo");
    for place in [root(), cargo] {
        let place = place.to_str().unwrap().as_bytes();
        for (name, bytes) in &first {
            assert!(
                !bytes.windows(place.len()).any(|part| part == place),
                "{name} contains a path of this machine"
            );
        }
    }
    let of = |name: &str| &first.iter().find(|(other, _)| other == name).unwrap().1;
    // The vector table: initial stack pointer in RAM, reset vector in flash.
    let bin = of("wsg-bridge.bin");
    assert_eq!((bin[3], bin[7]), (0x20, 0x08));
    assert_eq!(of("wsg-bridge.elf"), &fs::read(image()).unwrap());
    assert_eq!(String::from_utf8_lossy(of("SHA256SUMS")).lines().count(), first.len() - 1);
}

#[test]
#[ignore = "needs the image: cargo xtask test"]
fn sources_in_another_folder_give_the_same_bytes() {
    if env::var_os("WSG_WHOLE").is_none() {
        println!("skipped: runs only in cargo xtask ci, because it rebuilds the image");
        return;
    }
    let (here, there) = (scratch("here"), scratch("there-and-with-a-longer-name"));
    let mut list = Command::new("git");
    list.current_dir(root()).args(["ls-files", "-z", "--cached", "--others", "--exclude-standard"]);
    let listed = String::from_utf8(list.output().unwrap().stdout).unwrap();
    for file in listed.split_terminator('\0').filter(|file| root().join(file).is_file()) {
        let copy = there.join(file);
        fs::create_dir_all(copy.parent().unwrap()).unwrap();
        fs::copy(root().join(file), copy).unwrap();
    }

    let first = folder(&image(), &here);
    let is_made = |line: &str| {
        let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        cargo.current_dir(&there).args(line.split(' ')).env("CARGO_TARGET_DIR", there.join("target"));
        cargo.status().unwrap().success()
    };
    let elf = image();
    let elf = Path::new("target/firmware").join(elf.file_name().unwrap());
    let is_made = is_made("xtask build")
        && is_made(&format!("run --locked -p dist -- folder --elf {} --to target/dist", elf.display()));
    let second = if is_made { files(&there.join("target/dist")) } else { Vec::new() };

    fs::remove_dir_all(&here).unwrap();
    fs::remove_dir_all(&there).unwrap();
    assert!(is_made);
    let differing: Vec<_> =
        first.iter().filter(|file| !second.contains(file)).map(|(name, _)| name).collect();
    assert!(differing.is_empty() && first.len() == second.len(), "differing files: {differing:?}");
}
