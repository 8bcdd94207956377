//! The pages without a server: static files with the gripper and the bridge as WebAssembly.

use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
    process::Command,
    thread,
};

use anyhow::{Context, Result, ensure};
use flate2::{Compression, write::GzEncoder};

use crate::{
    gate::{self, Gate},
    process, setup,
    workspace::Workspace,
};

pub(crate) const TRIPLE: &str = "wasm32-unknown-unknown";
/// Folder of the files, in the build folder.
pub(crate) const FOLDER: &str = "web";
/// No names, and numbers of functions and addresses in as few bytes as possible.
const FLAGS: [&str; 4] = ["-C", "strip=symbols", "-C", "link-arg=--compress-relocations"];
/// Part of the names of the tests that need the files.
pub(crate) const TESTS: &str = "static_page";
/// The page of `wsg-sim`, and the files of the pages without a server.
const FOLDERS: [&str; 2] = ["gripper-sim/src/server/control/page", "web/page"];
/// Limit for all files together, each compressed by gzip -9, in bytes.
const MAX_COMPRESSED: u64 = 150_000;
/// What the page of the gripper may load: its own files.
const POLICY: &str = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; connect-src 'self'; \
                      worker-src 'self'; img-src data:; base-uri 'none'; form-action 'none'";
/// The line of the page that offers device files, of which a gripper without a bus has no use.
const DEVICE_FILES: &str = "<p class=\"files\">";
/// Where the page `try` of the book has the station. The PDF has a picture alone.
const PLACE: &str = "<!-- the page -->";
const EMBEDDED: &str = "<p><a href=\"web/index.html\">Open it in a window of its own</a></p>\n\
    <iframe src=\"web/station.html\" title=\"the station\" style=\"width:100%;height:60em;border:0\"></iframe>";
const HEAD: &str = "<meta charset=\"utf-8\">";

/// Builds the files, and checks their size. Returns the folder.
pub(crate) fn build(workspace: &Workspace) -> Result<PathBuf> {
    ensure!(
        setup::provide_target(workspace, TRIPLE),
        "the target {TRIPLE} is missing; run `rustup target add {TRIPLE}`, or install Debian's libstd-rust-dev-wasm32"
    );
    // Cargo optimizes a library as a whole only if no other crate can link it.
    let mut cargo =
        workspace.cargo("rustc --package wsg-web --lib --crate-type cdylib --profile c-library --target");
    provenance::remove_paths(cargo.arg(TRIPLE), &workspace.target_dir, &FLAGS);
    process::run(&mut cargo)?;

    let folder = workspace.target_dir.join(FOLDER);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder)?;
    for source in FOLDERS {
        for entry in fs::read_dir(workspace.root.join(source))? {
            let path = entry?.path();
            let (text, name) = (fs::read_to_string(&path)?, path.file_name().context("a file has a name")?);
            if source == FOLDERS[1] || !path.ends_with("index.html") {
                fs::write(folder.join(name), shortened(&text)?)?;
            } else {
                fs::write(folder.join("gripper.html"), shortened(&without_server(&text)?)?)?;
            }
        }
    }
    fs::remove_file(folder.join("over_http.js"))?;
    join_scripts(&folder)?;
    let wasm = workspace.target_dir.join(TRIPLE).join("c-library/wsg_web.wasm");
    fs::copy(&wasm, folder.join("wsg.wasm")).with_context(|| format!("cannot copy {}", wasm.display()))?;

    gate::check(&[size(&folder)?])?;
    Ok(folder)
}

/// Prints the sizes of the files, and returns the limit for all.
pub(crate) fn size(folder: &Path) -> Result<Gate> {
    let mut sizes = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let bytes = fs::read(&path)?;
        let mut gzip = GzEncoder::new(Vec::new(), Compression::best());
        gzip.write_all(&bytes)?;
        sizes.push((gzip.finish()?.len(), bytes.len(), path));
    }
    sizes.sort();
    for (compressed, size, path) in &sizes {
        println!("{compressed:7} of {size:7} bytes  {}", path.display());
    }
    let all: usize = sizes.iter().map(|(compressed, ..)| compressed).sum();
    Ok(Gate::bytes("pages for browsers, compressed by gzip -9", all as u64, MAX_COMPRESSED))
}

/// Adds the files to the book, whose page `try` embeds the station.
pub(crate) fn add_to_book(workspace: &Workspace) -> Result<()> {
    let book = workspace.target_dir.join("book");
    let folder = book.join(FOLDER);
    fs::create_dir_all(&folder)?;
    for entry in fs::read_dir(build(workspace)?)? {
        copy(&entry?.path(), &folder)?;
    }
    let page = book.join("try.html");
    let text = fs::read_to_string(&page).with_context(|| format!("cannot read {}", page.display()))?;
    ensure!(text.contains(PLACE), "{} lacks {PLACE}", page.display());
    Ok(fs::write(page, text.replace(PLACE, EMBEDDED))?)
}

/// Serves the folder, opens it in the browser, and waits until it is stopped.
pub(crate) fn open(folder: &Path) -> Result<()> {
    let page = browser::serve(folder)?;
    let opener = if cfg!(target_os = "macos") {
        "open"
    } else if cfg!(windows) {
        "explorer"
    } else {
        "xdg-open"
    };
    println!("open {page} in a browser; Ctrl+C stops the server");
    // A machine without a desktop has none; the address is printed.
    let _ = Command::new(opener).arg(&page).status();
    loop {
        thread::park();
    }
}

fn copy(file: &Path, folder: &Path) -> Result<()> {
    let name = file.file_name().context("a file has a name")?;
    fs::copy(file, folder.join(name)).with_context(|| format!("cannot copy {}", file.display()))?;
    Ok(())
}

/// Returns the page of `wsg-sim` with the worker in place of the server.
fn without_server(page: &str) -> Result<String> {
    for part in [HEAD, "over_http.js", DEVICE_FILES] {
        ensure!(page.contains(part), "the page lacks {part}");
    }
    let policy = format!("{HEAD}\n<meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">");
    let lines = page.lines().filter(|line| !line.contains(DEVICE_FILES)).map(|line| line.to_owned() + "\n");
    Ok(lines.collect::<String>().replace(HEAD, &policy).replace("over_http.js", "over_worker.js"))
}

/// Joins the scripts of the gripper's page, because one file compresses better than nine.
fn join_scripts(folder: &Path) -> Result<()> {
    let page = folder.join("gripper.html");
    let (mut html, mut joined) = (String::new(), String::new());
    for line in fs::read_to_string(&page)?.lines() {
        let script = line.strip_prefix("<script src=\"").and_then(|rest| rest.strip_suffix("\"></script>"));
        if let Some(script) = script {
            let script = folder.join(script);
            joined += &fs::read_to_string(&script)?;
            fs::remove_file(script)?;
        } else {
            html += line;
            html += "\n";
        }
    }
    ensure!(!joined.is_empty(), "the page lacks scripts");
    fs::write(folder.join("gripper.js"), joined)?;
    Ok(fs::write(page, html.replace("</body>", "<script src=\"gripper.js\"></script>\n</body>"))?)
}

/// Returns a file without indentation, empty lines, and comments of a line.
///
/// # Errors
/// Returns an error if a text of JavaScript has several lines, which would lose their indentation.
fn shortened(text: &str) -> Result<String> {
    let open = text.lines().find(|line| !line.matches('`').count().is_multiple_of(2));
    ensure!(open.is_none(), "a text of several lines begins here: {}", open.unwrap_or_default());
    let is_comment = |line: &str| line.starts_with("//") || line.starts_with("/*") && line.ends_with("*/");
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !is_comment(line));
    Ok(lines.flat_map(|line| [line, "\n"]).collect())
}
