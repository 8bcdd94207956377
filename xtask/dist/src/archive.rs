//! ZIP archives (PKWARE's APPNOTE) without compression, so that their bytes depend only on their files.

use anyhow::{Context, Result};
use crc::{CRC_32_ISO_HDLC, Crc};

const CRC_32: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Signatures of a file, a directory entry, and the end of the directory.
const FILE: &[u8] = b"PK\x03\x04";
const ENTRY: &[u8] = b"PK\x01\x02";
const END: &[u8] = b"PK\x05\x06";

/// Version required to unpack: 1.0.
const VERSION: u16 = 10;
/// 1980-01-01, the earliest date in a ZIP archive.
const DATE: u16 = 0x0021;

/// Returns an archive of these named files, in this order.
///
/// # Errors
/// Fails when a file or the archive exceeds the format's limits.
pub(crate) fn zip(files: &[(impl AsRef<str>, impl AsRef<[u8]>)]) -> Result<Vec<u8>> {
    let (mut archive, mut directory) = (Vec::new(), Vec::new());
    for (name, bytes) in files {
        let (name, bytes) = (name.as_ref(), bytes.as_ref());
        let offset = length(&archive)?;
        let len = length(bytes)?;
        let name_len =
            u16::try_from(name.len()).with_context(|| format!("the file name {name} is too long"))?;
        // Part common to both headers: version, no flags, no compression, no time, checksum, lengths, no extra field.
        let mut common = Vec::new();
        [VERSION, 0, 0, 0, DATE].iter().for_each(|value| common.extend(value.to_le_bytes()));
        [CRC_32.checksum(bytes), len, len].iter().for_each(|value| common.extend(value.to_le_bytes()));
        [name_len, 0].iter().for_each(|value| common.extend(value.to_le_bytes()));
        archive.extend([FILE, &common, name.as_bytes(), bytes].concat());
        // No comment, first disk, no attributes.
        let place = [&[0; 10][..], &offset.to_le_bytes()].concat();
        directory.extend([ENTRY, &VERSION.to_le_bytes(), &common, &place, name.as_bytes()].concat());
    }
    let count = u16::try_from(files.len()).context("too many files for an archive")?;
    let (len, offset) = (length(&directory)?, length(&archive)?);
    archive.extend(directory);
    archive.extend([END, &[0; 4], &count.to_le_bytes(), &count.to_le_bytes()].concat());
    archive.extend([&len.to_le_bytes()[..], &offset.to_le_bytes(), &[0; 2]].concat());
    Ok(archive)
}

fn length(bytes: &[u8]) -> Result<u32> {
    u32::try_from(bytes.len()).context("too long for an archive")
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Reads an archive by its directory, and compares each file's header with its entry.
    pub(crate) fn unzip(archive: &[u8]) -> Vec<(String, Vec<u8>)> {
        let word = |at: usize| u32::from_le_bytes(archive[at..at + 4].try_into().unwrap()) as usize;
        let half = |at: usize| usize::from(u16::from_le_bytes(archive[at..at + 2].try_into().unwrap()));
        let end = archive.len() - 22;
        assert_eq!(&archive[end..end + 4], END);
        let mut at = word(end + 16);
        assert_eq!(at + word(end + 12), end);
        let mut files = vec![];
        for _ in 0..half(end + 10) {
            assert_eq!(&archive[at..at + 4], ENTRY);
            let (name_len, file) = (half(at + 28), word(at + 42));
            let name = &archive[at + 46..at + 46 + name_len];
            assert_eq!(&archive[file..file + 4], FILE);
            assert_eq!(archive[file + 4..file + 30], archive[at + 6..at + 32]);
            let data = file + 30 + name_len;
            assert_eq!(&archive[file + 30..data], name);
            let bytes = archive[data..data + word(at + 24)].to_vec();
            assert_eq!(word(at + 16), CRC_32.checksum(&bytes) as usize);
            files.push((String::from_utf8(name.to_vec()).unwrap(), bytes));
            at += 46 + name_len;
        }
        assert_eq!(at, end);
        files
    }

    #[test]
    fn archive_gives_its_files_back() {
        let files = [("a.txt", &b"123456789"[..]), ("empty", b""), ("b c.bin", &[0xFF; 300])];
        let archive = zip(&files).unwrap();
        let expected: Vec<_> = files.map(|(name, bytes)| (name.to_owned(), bytes.to_vec())).into();
        assert_eq!(unzip(&archive), expected);
        // Check value of CRC-32.
        assert_eq!(archive[14..18], 0xCBF4_3926_u32.to_le_bytes());
        assert_eq!(unzip(&zip(&[("", ""); 0]).unwrap()), []);
    }
}
