//! Runs `wsg bridge keygen` and `wsg bridge sign`.

#[path = "common/program.rs"]
mod program;

use std::fs;
use std::path::PathBuf;

use program::{printed, wsg};
use wsg_update::{Check, Keys, Manifest, Rules, Target, Version};

/// A folder of a test, removed at its end.
struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("wsg-sign-{test}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }

    fn path(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }

    /// Generates a key. Returns the paths of both files, and the public key.
    fn key(&self, name: &str) -> ([String; 2], [u8; 32]) {
        let files = [self.path(name), self.path(&format!("{name}.pub"))];
        let output = wsg(&["bridge", "keygen", &files[0]], b"");
        assert!(output.status.success(), "{}", printed(&output));
        let public = wsg_update::sign::public_key(&fs::read(&files[1]).unwrap()).unwrap();
        let digits: String = public.iter().map(|byte| format!("{byte:02x}")).collect();
        assert!(printed(&output).contains(&format!("public key {digits}")), "{}", printed(&output));
        (files, public)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[test]
fn keys_are_private_differ_and_are_never_overwritten() {
    let folder = Folder::new("keys");
    let (files, public) = folder.key("a");
    assert_ne!(folder.key("b").1, public);
    let texts = files.each_ref().map(|file| fs::read(file).unwrap());
    for removed in [None, Some(&files[0])] {
        // Either file alone is kept.
        removed.into_iter().for_each(|file| fs::remove_file(file).unwrap());
        let output = wsg(&["bridge", "keygen", &files[0]], b"");
        assert!(
            !output.status.success() && printed(&output).contains("exists; choose another name"),
            "{}",
            printed(&output)
        );
        assert_eq!(fs::read(&files[1]).unwrap(), texts[1]);
        assert_eq!(fs::read(&files[0]).ok(), removed.is_none().then(|| texts[0].clone()));
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        assert_eq!(fs::metadata(folder.path("b")).unwrap().permissions().mode() & 0o777, 0o600);
    }
}

#[test]
fn signed_image_is_that_of_its_board_and_wrong_requests_are_refused_by_name() {
    let folder = Folder::new("images");
    let ([key, public_file], first) = folder.key("first");
    let (_, second) = folder.key("second");
    let (image, signed) = (folder.path("image.bin"), folder.path("image.update"));
    fs::write(&image, vec![7; 1_001]).unwrap();
    let common = ["bridge", "sign", &image, "--key", &key, "--board"];
    let options =
        ["pico", "--release", "1.20.3", "--counter", "4", "--successor", &folder.path("second.pub")];
    let output = wsg(&[&common[..], &options].concat(), b"");
    assert!(output.status.success(), "{}", printed(&output));
    let expected =
        "1136 bytes for pico, version 1.20.3, rollback counter 4, names a successor of the second key";
    assert!(printed(&output).contains(expected), "{}", printed(&output));

    let file = fs::read(&signed).unwrap();
    let rules = Rules { target: Target::of("pico"), keys: Keys { first, second: [0; 32] }, counter: 4 };
    let manifest = Check::whole(&mut &file[..], rules).unwrap();
    let successor = Some(second);
    assert_eq!(
        manifest,
        Manifest {
            target: Target::of("pico"),
            version: Version([1, 20, 3]),
            length: 1_072,
            counter: 4,
            successor
        }
    );

    let elf = folder.path("image.elf");
    fs::write(&elf, b"\x7FELF").unwrap();
    let long = folder.path("long.bin");
    fs::write(&long, vec![7; 192 * 1024 - 127]).unwrap();
    let with_key = |image, key| vec!["bridge", "sign", image, "--key", key, "--board", "pico"];
    let mut in_place = with_key(&image, &key);
    in_place.extend(["--output", &image]);
    let mut numbers = with_key(&image, &key);
    numbers.extend(["--release", "1.256.0"]);
    let cases = [
        (with_key(&elf, &key), "is an ELF file; expected the program as .bin"),
        (with_key(&long, &key), "the image exceeds a slot of 192 KiB"),
        (with_key(&image, &public_file), "expected a private key of Ed25519 as PEM"),
        (with_key(&image, &image), "expected a private key of Ed25519 as PEM"),
        (with_key("missing.bin", &key), "cannot read missing.bin"),
        (in_place, "needs another name than"),
        (numbers, "expected three numbers up to 255"),
        (vec!["bridge", "/dev/null", "keygen", "c"], "keygen and sign have no PORT; remove /dev/null"),
        (vec!["bridge", "show"], "missing PORT"),
    ];
    for (arguments, message) in cases {
        let output = wsg(&arguments, b"");
        assert!(
            !output.status.success() && printed(&output).contains(message),
            "{arguments:?}: {}",
            printed(&output)
        );
    }
    assert_eq!(fs::read(&image).unwrap(), [7; 1_001]);
}
