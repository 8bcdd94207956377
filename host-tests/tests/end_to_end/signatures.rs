//! Signed images of `wsg bridge sign`, checked and made by Python's `cryptography`.

use std::fs;
use std::process::{Command, Output};

use host_tests::example::program;
use host_tests::masters::{printed, python};

/// Verifies a signed image as the format describes it, and makes the same file with the same key.
const VERIFY: &str = r#"
import hashlib, struct, sys
from cryptography.hazmat.primitives.asymmetric import ed25519
from cryptography.hazmat.primitives import serialization
program, signed, private, public = (open(name, "rb").read() for name in sys.argv[1:5])
private = serialization.load_pem_private_key(private, None)
public = serialization.load_pem_public_key(public)
image, signature = signed[:-64], signed[-64:]
public.verify(signature, hashlib.sha512(image).digest())
target = 0x811C9DC5
for byte in b"pico":
    target = (target ^ byte) * 0x01000193 % 2**32
program += b"\xFF" * (-len(program) % 8)
length = len(program) + 64
made = bytearray(program)
made[28:32] = struct.pack("<I", length)
made += struct.pack("<4sI4BIII", b"WSG1", target, 1, 2, 3, 0, length, 7, 0) + bytes(8 + 32)
made += private.sign(hashlib.sha512(made).digest())
assert bytes(made) == signed, "another file"
"#;

/// Writes a new key pair.
const GENERATE: &str = r#"
import sys
from cryptography.hazmat.primitives.asymmetric import ed25519
from cryptography.hazmat.primitives.serialization import *
key = ed25519.Ed25519PrivateKey.generate()
open(sys.argv[1], "wb").write(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
open(sys.argv[1] + ".pub", "wb").write(
    key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
"#;

fn wsg(arguments: &[&str]) -> Output {
    Command::new(program("wsg")).arg("bridge").args(arguments).output().expect("wsg must be built")
}

fn assert_success(output: &Output) {
    assert!(output.status.success(), "{}", printed(output));
}

#[test]
#[ignore = "needs cryptography: run `cargo xtask test`"]
fn cryptography_verifies_signed_images_and_makes_the_same() {
    let folder = std::env::temp_dir().join(format!("wsg-signatures-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let (image, signed) = (path("image.bin"), path("image.update"));
    fs::write(&image, (0..5_003).map(|at| (at * 11 % 253) as u8).collect::<Vec<_>>()).unwrap();
    let [ours, theirs] = ["ours.key", "theirs.key"].map(path);
    assert_success(&wsg(&["keygen", &ours]));
    assert_success(&python(GENERATE, &[&theirs]));
    for key in [ours, theirs] {
        let sign = ["sign", &image, "--key", &key, "--board", "pico", "--release", "1.2.3", "--counter", "7"];
        assert_success(&wsg(&sign));
        assert_success(&python(VERIFY, &[&image, &signed, &key, &format!("{key}.pub")]));
    }
    fs::remove_dir_all(&folder).unwrap();
}
