//! The files for updates in the field: boot loader and signed image for the drive of a board, and the signed image alone.

use std::{env, fs, path::PathBuf};

use anyhow::{Context, Result, ensure};
use boards::Board;
use footprint::{bytes_of_flash, range_of_flash, uf2_of};
use wsg_update::{
    BOOT_LEN, Check, Keys, Manifest, Rules, Target, Version,
    sign::{self, SigningKey},
};

use crate::{
    firmware::{self, Image},
    setup::ThumbToolchain,
};

/// Environment variable that names the file of the private key.
const KEY: &str = "WSG_UPDATE_KEY";

/// Rollback counter of the images. Raise it only with a security fix, because boards then refuse all images with a lower one. It
/// never falls: a board also refuses an older image from its drive.
const COUNTER: u32 = 0;

/// Second private key of [`Keys::TEST`].
const TEST_KEY: [u8; 32] = [2; 32];

/// The files of a board.
pub(crate) struct Files {
    /// For the drive of the board: boot loader and signed image.
    install: Image,
    /// Signed image, for `wsg bridge PORT update`.
    update: Image,
    /// Program of the image, for `wsg bridge sign`.
    program: Image,
}

/// Builds the files of a board.
pub(crate) fn build(toolchain: &ThumbToolchain<'_>, board: &'static Board) -> Result<Files> {
    // Before the build, which takes longer.
    let key = signing_key(env::var_os(KEY).map(PathBuf::from), Keys::BUILT_IN)?;
    let version = Version::parse(env!("CARGO_PKG_VERSION")).context("the version is no manifest's")?;
    let read = |image: Image| fs::read(&image.path).with_context(|| image.path.display().to_string());
    let boot = range_of_flash(&read(firmware::boot_loader(toolchain, board)?)?)?;
    let slot = read(firmware::build_for_slot(toolchain, board)?)?;
    let program = bytes_of_flash(&slot)?;
    let target = Target::of(board.name);
    let manifest = Manifest { target, version, length: 0, counter: COUNTER, successor: None };
    let update = sign::file(&program, manifest, &key)?;
    // As the boot loader does.
    Check::whole(&mut &update[..], Rules { target, keys: Keys::BUILT_IN, counter: COUNTER })?;
    let install = combined(boot, range_of_flash(&slot)?.0, &update)?;
    let keep = |bytes: &[u8], name: &str| {
        let folder = toolchain.workspace.target_dir.join("firmware");
        firmware::keep(board, bytes, &folder.join(format!("{}{name}", board.name)))
    };
    let (at, bytes) = &install;
    Ok(Files {
        install: if board.takes_uf2 {
            keep(&uf2_of(&[(*at, bytes)])?, "-install.uf2")?
        } else {
            keep(bytes, "-install.bin")?
        },
        update: keep(&update, ".update")?,
        program: keep(&program, "-slot.bin")?,
    })
}

impl Files {
    /// Prints the paths, and whether anybody can sign for the board.
    pub(crate) fn print(&self) {
        println!("for the drive of the board: {}", self.install.path.display());
        println!("sha256 {}", self.install.sha256);
        println!("for `wsg bridge PORT update`: {}", self.update.path.display());
        println!("for `wsg bridge sign`: {}", self.program.path.display());
        if Keys::BUILT_IN.contain_test_key() {
            println!(
                "warning: the boot loader trusts a test key, so anybody can sign images for the board; set {KEY}, WSG_FIRST_KEY and \
                 WSG_SECOND_KEY (docs/updates.md)"
            );
        }
    }
}

/// Reads the private key, or returns the test key. Fails if boot loaders with these keys do not trust it.
fn signing_key(file: Option<PathBuf>, keys: Keys) -> Result<SigningKey> {
    let (key, name) = match &file {
        Some(file) => {
            let name = file.display().to_string();
            let pem = fs::read(file).with_context(|| format!("cannot read {name}"))?;
            let key = sign::private_key(&pem);
            (key.with_context(|| format!("{name}: expected a private key of Ed25519 as PEM"))?, name)
        }
        None => (SigningKey::from_bytes(&TEST_KEY), format!("the test key, which signs without {KEY}")),
    };
    ensure!(
        keys.contain(&key.verifying_key().to_bytes()),
        "the boot loader does not trust {name}: its public key is neither WSG_FIRST_KEY nor WSG_SECOND_KEY"
    );
    Ok(key)
}

/// Returns the address and the contents of the flash from the boot loader up to the signed image.
fn combined((at, mut bytes): (u32, Vec<u8>), slot_at: u32, update: &[u8]) -> Result<(u32, Vec<u8>)> {
    ensure!(
        bytes.len() <= BOOT_LEN as usize && slot_at.checked_sub(at) == Some(BOOT_LEN),
        "the boot loader at {at:08X}h has {} bytes, and slot A is at {slot_at:08X}h; expected {BOOT_LEN} bytes between",
        bytes.len()
    );
    bytes.resize(BOOT_LEN as usize, 0xFF);
    bytes.extend_from_slice(update);
    Ok((at, bytes))
}

#[cfg(test)]
mod tests {
    use std::ops::RangeInclusive;

    use boards::BOARDS;

    use super::*;

    /// Returns a region of a board in the document.
    fn region(board: &Board, name: &str) -> RangeInclusive<u32> {
        let layout = document::part("docs/decisions.md", "flash-layout");
        let (_, rows) = layout.split_once(&format!("\n{}\n", board.name)).unwrap();
        let row = rows.lines().find(|line| line.ends_with(&format!("KiB  {name}"))).unwrap();
        let addresses: Vec<_> =
            row.split_whitespace().filter_map(|word| u32::from_str_radix(word, 16).ok()).collect();
        addresses[0]..=addresses[1]
    }

    #[test]
    fn file_for_the_drive_has_boot_loader_and_slot_a_at_their_addresses_and_nothing_else() {
        for board in &BOARDS {
            let (boot, slot) = (region(board, "boot loader"), region(board, "slot A"));
            let update = vec![2; slot.clone().count()];
            let (at, bytes) = combined((*boot.start(), vec![1; 1_000]), *slot.start(), &update).unwrap();

            let from_boot = |address: u32| (address - boot.start()) as usize;
            assert_eq!((at, bytes.len()), (*boot.start(), from_boot(*slot.end()) + 1), "{}", board.name);
            let (before, after) = bytes.split_at(from_boot(*slot.start()));
            assert!(before[..1_000].iter().all(|byte| *byte == 1), "{}", board.name);
            assert!(before[1_000..].iter().all(|byte| *byte == 0xFF), "{}", board.name);
            assert_eq!(after, update);

            if board.takes_uf2 {
                let blocks = uf2_of(&[(at, &bytes)]).unwrap();
                let address = |block: &[u8]| u32::from_le_bytes(*block[12..].first_chunk().unwrap());
                let addresses = blocks.chunks(512).map(address);
                assert!(addresses.eq((*boot.start()..=*slot.end()).step_by(256)));
            }
        }
    }

    #[test]
    fn boot_loader_that_does_not_end_before_slot_a_is_refused() {
        let boot = 0x0800_0000;
        for (len, slot_at) in
            [(32 * 1024 + 1, boot + 0x8000), (1_000, boot + 0x4000), (1_000, boot), (1_000, 0)]
        {
            let error = combined((boot, vec![0; len]), slot_at, &[]).unwrap_err().to_string();
            assert!(error.starts_with(&format!("the boot loader at 08000000h has {len} bytes")), "{error}");
        }
    }

    #[test]
    fn key_is_refused_unless_the_boot_loader_trusts_it() {
        let file = env::temp_dir().join(format!("wsg-xtask-key-{}", std::process::id()));
        let key = SigningKey::from_bytes(&[3; 32]);
        fs::write(&file, sign::private_pem(&key)).unwrap();
        let public = key.verifying_key().to_bytes();
        let read = |keys| signing_key(Some(file.clone()), keys).map(|key| key.to_bytes());
        let own = Keys { second: public, ..Keys::TEST };
        let both = Keys { first: public, second: [9; 32] };
        let [trusted, foreign] = [read(own), read(Keys::TEST)];
        fs::write(&file, sign::public_pem(&public)).unwrap();
        let wrong = read(own).unwrap_err().to_string();
        fs::remove_file(&file).unwrap();

        assert_eq!(trusted.unwrap(), [3; 32]);
        let foreign = foreign.unwrap_err().to_string();
        assert!(foreign.contains(&format!("does not trust {}", file.display())), "{foreign}");
        assert!(wrong.ends_with("expected a private key of Ed25519 as PEM"), "{wrong}");
        assert!(read(own).unwrap_err().to_string().starts_with("cannot read "));
        assert!(signing_key(None, Keys::TEST).is_ok());
        assert!(
            signing_key(None, both)
                .unwrap_err()
                .to_string()
                .contains("the test key, which signs without WSG_UPDATE_KEY: ")
        );
        assert_eq!([own, both, Keys::TEST].map(|keys| keys.contain_test_key()), [true, false, true]);
    }
}
