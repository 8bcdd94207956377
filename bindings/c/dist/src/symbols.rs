//! The symbols of a static library: it cannot panic, and links beside any other library.

use anyhow::{Result, bail};
use object::read::archive::ArchiveFile;
use object::{File, Object, ObjectSymbol, SymbolScope};

/// The undefined function that the library's panic handler calls.
const PANIC: &str = "a_panic_can_be_reached";

/// Checks that no code can reach a panic, and that only functions named `wsg_...` are visible to other libraries. What the compiler
/// adds is hidden. Windows objects have no visibility, so there only panics are detected.
pub(crate) fn check(library: &[u8]) -> Result<()> {
    for member in ArchiveFile::parse(library)?.members() {
        for symbol in File::parse(member?.data(library)?)?.symbols() {
            match symbol.name()? {
                PANIC => bail!("a panic can be reached: {PANIC} is undefined"),
                name if symbol.scope() == SymbolScope::Dynamic && !name.starts_with("wsg_") => {
                    bail!("{name} is visible to other libraries; expected only wsg_...");
                }
                _ => {}
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::process::Command;

    use super::*;

    /// Checks a library with one object in C.
    fn check_c(name: &str, source: &str) -> String {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../target/tmp/symbols").join(name);
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("it.c"), source).unwrap();
        let script = "rm -f it.a && gcc -O1 -c it.c && ar rc it.a it.o";
        assert!(Command::new("sh").current_dir(&folder).args(["-c", script]).status().unwrap().success());
        let outcome = check(&std::fs::read(folder.join("it.a")).unwrap());
        outcome.map_or_else(|error| error.to_string(), |()| "accepted".to_owned())
    }

    #[test]
    fn panics_and_visible_symbols_are_rejected() {
        let hidden = "__attribute__((visibility(\"hidden\"))) void other(void) {}\nvoid wsg_it(void) {}\n";
        assert_eq!(check_c("hidden", hidden), "accepted");
        let visible = check_c("visible", "void other(void) {}\n");
        assert_eq!(visible, "other is visible to other libraries; expected only wsg_...");
        let panics =
            "extern void a_panic_can_be_reached(void);\nvoid wsg_it(void) { a_panic_can_be_reached(); }\n";
        assert!(check_c("panics", panics).starts_with("a panic can be reached"));
    }
}
