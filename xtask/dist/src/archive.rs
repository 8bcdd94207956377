//! ZIP archives whose bytes depend only on their files.

use std::io::{Cursor, Write as _};

use anyhow::{Context, Result};
use zip::{CompressionMethod, DateTime, ZipWriter, write::SimpleFileOptions};

use crate::LINUX;

/// Returns a compressed archive of these named files, in this order, all from the earliest date of the format.
///
/// # Errors
/// Fails when a name occurs twice, or a file exceeds the format's limits.
pub(crate) fn zip(files: &[(impl AsRef<str>, impl AsRef<[u8]>)]) -> Result<Vec<u8>> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .last_modified_time(DateTime::default());
    for (name, bytes) in files {
        let name = name.as_ref();
        // Programs unpack with the right to run.
        let is_program = name.split('/').rev().nth(1) == Some(LINUX);
        let mode = if is_program { 0o755 } else { 0o644 };
        archive.start_file(name, options.unix_permissions(mode)).with_context(|| name.to_owned())?;
        archive.write_all(bytes.as_ref()).with_context(|| name.to_owned())?;
    }
    Ok(archive.finish()?.into_inner())
}

#[cfg(test)]
pub(crate) mod tests {
    use std::io::Read as _;

    use zip::ZipArchive;

    use super::*;

    /// Returns the files of an archive, whose checksums are compared.
    pub(crate) fn unzip(archive: &[u8]) -> Vec<(String, Vec<u8>)> {
        let mut archive = ZipArchive::new(Cursor::new(archive)).unwrap();
        let count = archive.len();
        let read = |at| {
            let mut file = archive.by_index(at).unwrap();
            let mut bytes = Vec::new();
            file.read_to_end(&mut bytes).unwrap();
            (file.name().unwrap().into_owned(), bytes)
        };
        (0..count).map(read).collect()
    }

    #[test]
    fn archive_is_small_and_gives_its_files_back() {
        let files = [("a.txt", &b"123456789"[..]), ("empty", b""), ("b c.bin", &[0xFF; 30_000])];
        let archive = zip(&files).unwrap();
        let expected: Vec<_> = files.map(|(name, bytes)| (name.to_owned(), bytes.to_vec())).into();
        assert_eq!(unzip(&archive), expected);
        assert!(archive.len() < 1_000, "{} bytes", archive.len());
        assert!(archive == zip(&files).unwrap());
        assert_eq!(unzip(&zip(&[("", ""); 0]).unwrap()), []);
    }

    #[test]
    fn programs_for_linux_may_run() {
        let archive = zip(&[("x/linux/wsg", "1"), ("x/README.txt", "2")]).unwrap();
        let mut archive = ZipArchive::new(Cursor::new(archive)).unwrap();
        let mut mode = |at| archive.by_index(at).unwrap().unix_mode().unwrap() & 0o777;
        assert_eq!([mode(0), mode(1)], [0o755, 0o644]);
    }
}
