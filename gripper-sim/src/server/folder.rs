//! Files that are read and written without following links out of their folder.

use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Read, Write};
use std::path::Path;

/// Reads a regular file of this folder, at most `max_len` bytes. A link is followed only to a file of the same folder.
///
/// # Errors
/// Returns an error if the file does not exist, is in another folder, is not a regular file, or is too long.
pub(super) fn read(folder: &Path, name: &str, max_len: u64) -> io::Result<Vec<u8>> {
    // The folder of a script that is named without one.
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder }.canonicalize()?;
    let path = folder.join(name).canonicalize()?;
    if path.parent() != Some(&folder) {
        return Err(io::Error::new(ErrorKind::PermissionDenied, "the link leads out of the folder"));
    }
    let mut bytes = Vec::new();
    // Bounded even if the file grows meanwhile.
    open(&path)?.take(max_len.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_len {
        return Err(io::Error::new(ErrorKind::FileTooLarge, format!("longer than {max_len} bytes")));
    }
    Ok(bytes)
}

/// Opens a regular file that is no link.
fn open(path: &Path) -> io::Result<File> {
    // A pipe would block, and a device may react to being opened.
    if !fs::symlink_metadata(path)?.is_file() {
        return Err(io::Error::new(ErrorKind::InvalidInput, "not a file"));
    }
    let mut options = OpenOptions::new();
    options.read(true);
    #[cfg(unix)]
    {
        use rustix::fs::OFlags;
        use std::os::unix::fs::OpenOptionsExt;
        // A link that has replaced the file meanwhile is not followed either, and a pipe does not block.
        options.custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32);
    }
    options.open(path)
}

/// Writes a file: as a new file beside it that then replaces it, so that no failure leaves half a file. A link of either
/// name is replaced, not followed.
///
/// # Errors
/// Returns an error if the folder cannot be written to, or the name belongs to a folder.
pub(super) fn write(path: &Path, text: &[u8]) -> io::Result<()> {
    let mut new = path.as_os_str().to_owned();
    new.push(".new");
    // The remainder of an earlier attempt, or a link.
    match fs::remove_file(&new) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    // Fails for a link that has been created meanwhile.
    let mut file = OpenOptions::new().write(true).create_new(true).open(&new)?;
    file.write_all(text)?;
    drop(file);
    fs::rename(&new, path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;

    const MAX_LEN: u64 = 8;

    /// A folder with a file in it and a file beside it, deleted on drop.
    struct Folders(PathBuf);

    impl Folders {
        fn new(name: &str) -> Self {
            let root = std::env::temp_dir().join(format!("wsg-folder-{}-{name}", std::process::id()));
            fs::create_dir_all(root.join("scripts/inner.lua")).unwrap();
            fs::write(root.join("secret"), "secret").unwrap();
            fs::write(root.join("scripts/a.lua"), "a").unwrap();
            fs::write(root.join("scripts/long.lua"), "123456789").unwrap();
            Self(root)
        }

        fn scripts(&self) -> PathBuf {
            self.0.join("scripts")
        }
    }

    impl Drop for Folders {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn only_regular_files_of_the_folder_are_read() {
        let folders = Folders::new("read");
        let scripts = folders.scripts();
        assert_eq!(read(&scripts, "a.lua", MAX_LEN).unwrap(), b"a");
        for name in ["missing.lua", "inner.lua", "long.lua", "../secret"] {
            assert!(read(&scripts, name, MAX_LEN).is_err(), "{name}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_only_inside_the_folder() {
        use std::os::unix::fs::symlink;
        let folders = Folders::new("links");
        let scripts = folders.scripts();
        symlink(folders.0.join("secret"), scripts.join("absolute.lua")).unwrap();
        symlink("../secret", scripts.join("relative.lua")).unwrap();
        symlink("relative.lua", scripts.join("chain.lua")).unwrap();
        symlink("nowhere", scripts.join("broken.lua")).unwrap();
        symlink("a.lua", scripts.join("inside.lua")).unwrap();
        for name in ["absolute.lua", "relative.lua", "chain.lua", "broken.lua"] {
            assert!(read(&scripts, name, MAX_LEN).is_err(), "{name}");
        }
        assert_eq!(read(&scripts, "inside.lua", MAX_LEN).unwrap(), b"a");
        // The folder itself may be named by a link.
        symlink(&scripts, folders.0.join("linked")).unwrap();
        assert_eq!(read(&folders.0.join("linked"), "a.lua", MAX_LEN).unwrap(), b"a");
    }

    #[cfg(unix)]
    #[test]
    fn pipe_is_neither_read_nor_waited_for() {
        let folders = Folders::new("pipe");
        let pipe = folders.scripts().join("pipe.lua");
        let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
        rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, mode).unwrap();
        assert!(read(&folders.scripts(), "pipe.lua", MAX_LEN).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn writing_replaces_links_and_leaves_their_targets_alone() {
        use std::os::unix::fs::symlink;
        let folders = Folders::new("write");
        let scripts = folders.scripts();
        symlink("../secret", scripts.join("b.lua")).unwrap();
        symlink("../secret", scripts.join("b.lua.new")).unwrap();
        symlink("../created", scripts.join("c.lua.new")).unwrap();
        for name in ["a.lua", "b.lua", "c.lua"] {
            write(&scripts.join(name), b"new").unwrap();
            assert_eq!(read(&scripts, name, MAX_LEN).unwrap(), b"new", "{name}");
        }
        assert_eq!(fs::read(folders.0.join("secret")).unwrap(), b"secret");
        assert!(!folders.0.join("created").exists());
    }
}
