//! The scripts in the folder of `--scripts`: list, read, save, delete, run, stop, and the script that runs at the start.

use crate::control::HttpError;
use crate::control::json::{IfSome, body, members, names, object};
use crate::server::folder;
use crate::server::hub::{Changes, Hub, Refused};
use crate::server::script::Script;
use crate::text;
use hyper::StatusCode;
use std::path::Path;
use std::sync::Arc;
use std::{fs, io};

pub(super) const SCRIPT_EXPECTED: &str = r#"{"action":"save","name":"x.lua","source":"..."}, or "read", "run", "delete" or "start_up" with a name, or "stop""#;

/// The longest script in bytes.
const MAX_SOURCE_LEN: usize = 65_536;
/// The longest body of a request: JSON may write a byte with six characters.
pub(super) const MAX_SCRIPT_BODY_LEN: usize = 6 * MAX_SOURCE_LEN + 1_024;
/// Maximum number of scripts in the folder.
const MAX_SCRIPTS: usize = 100;
/// The longest name of a script.
const MAX_NAME_LEN: usize = 60;

#[derive(Debug)]
pub(super) struct ScriptBody {
    action: Action,
    name: Option<String>,
    source: Option<String>,
}
body!(ScriptBody: action, name, source);

impl ScriptBody {
    /// Returns whether the request may change something, except that it stops a script.
    pub(super) fn changes(&self) -> bool {
        !matches!(self.action, Action::Read | Action::Stop)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Action {
    Read,
    Save,
    Delete,
    Run,
    Stop,
    /// Runs the script at each start; without a name, none.
    StartUp,
}
names!(
    Action: Read "read", Save "save", Delete "delete", Run "run", Stop "stop", StartUp "start_up"
);

#[derive(Debug)]
struct ScriptFile {
    name: String,
    bytes: u64,
}
members!(ScriptFile: name, bytes);

/// Returns the scripts of the folder, and the source for the action `read`: the answer to requests about scripts.
pub(super) fn scripts(hub: &Hub, source: Option<String>) -> Result<String, HttpError> {
    let folder = hub.script_folder();
    let start_up = hub.start_up_script().filter(|path| path.parent() == folder.as_deref());
    let (latest, output) = hub.script_report(0);
    let name = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let list = folder.as_deref().map_or_else(|| Ok(vec![]), list).map_err(|error| failed("read", &error))?;
    Ok(object! {
        // Null without `--scripts`.
        "folder": folder.map(|folder| folder.display().to_string()),
        "list": list,
        // The script in the folder that runs at the start.
        "start_up": start_up.as_deref().and_then(name),
        "latest": latest,
        "output": output,
        "source": IfSome(source),
    })
}

fn list(folder: &Path) -> io::Result<Vec<ScriptFile>> {
    let mut list = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        // Not by a link, which could lead out of the folder.
        let (name, file) = (entry.file_name().to_string_lossy().into_owned(), entry.file_type()?);
        if file.is_file() && is_name(&name) {
            list.push(ScriptFile { name, bytes: entry.metadata()?.len() });
        }
    }
    list.sort_by(|one, next| one.name.cmp(&next.name));
    Ok(list)
}

/// Executes an action, and returns the scripts.
pub(super) fn execute(hub: &Arc<Hub>, body: ScriptBody) -> Result<String, HttpError> {
    let ScriptBody { action, name, source } = body;
    if action == Action::Stop {
        hub.stop_script();
        return scripts(hub, None);
    }
    let folder = hub.script_folder().ok_or_else(|| {
        let error = "there is no folder for scripts; expected wsg-sim with --scripts FOLDER";
        HttpError::new(StatusCode::CONFLICT, error.to_owned())
    })?;
    if action == Action::StartUp && name.is_none() {
        set_start_up(hub, None)?;
        return scripts(hub, None);
    }
    let name = name.filter(|name| is_name(name)).ok_or_else(|| {
        HttpError::wrong(format!(
            "the name of the script is invalid; expected at most {MAX_NAME_LEN} letters, digits, _ and -, then .lua"
        ))
    })?;
    let path = folder.join(&name);
    if action != Action::Save && !fs::symlink_metadata(&path).is_ok_and(|file| file.is_file()) {
        return Err(HttpError::new(StatusCode::NOT_FOUND, format!("there is no script {name}")));
    }
    let mut read = None;
    match action {
        Action::Read => read = Some(source_of(&folder, &name)?),
        Action::Save => {
            let source = source.filter(|source| source.len() <= MAX_SOURCE_LEN).ok_or_else(|| {
                HttpError::wrong(format!("expected a source of at most {MAX_SOURCE_LEN} bytes"))
            })?;
            save(&folder, &name, &source)?;
        }
        Action::Delete => fs::remove_file(&path).map_err(|error| failed("deleted", &error))?,
        Action::Run => {
            let script = Script::read_in(&folder, &name, u64::MAX)
                .map_err(|error| HttpError::new(StatusCode::INTERNAL_SERVER_ERROR, format!("{error:#}")))?;
            script.start(Arc::clone(hub)).map_err(|error| {
                HttpError::new(StatusCode::INTERNAL_SERVER_ERROR, format!("the script cannot start: {error}"))
            })?;
        }
        Action::StartUp => set_start_up(hub, Some(&path))?,
        Action::Stop => {}
    }
    scripts(hub, read)
}

fn source_of(folder: &Path, name: &str) -> Result<String, HttpError> {
    let source = folder::read(folder, name, MAX_SOURCE_LEN as u64).and_then(text::decoded);
    source.map_err(|error| match error.kind() {
        io::ErrorKind::FileTooLarge => {
            let error =
                format!("the script is too long for the page; expected at most {MAX_SOURCE_LEN} bytes");
            HttpError::new(StatusCode::CONFLICT, error)
        }
        _ => failed("read", &error),
    })
}

fn save(folder: &Path, name: &str, source: &str) -> Result<(), HttpError> {
    let known = list(folder).map_err(|error| failed("read", &error))?;
    if known.len() >= MAX_SCRIPTS && !folder.join(name).exists() {
        let error = format!("the folder has {MAX_SCRIPTS} scripts already; delete one first");
        return Err(HttpError::new(StatusCode::CONFLICT, error));
    }
    folder::write(&folder.join(name), source.as_bytes()).map_err(|error| failed("written", &error))
}

fn set_start_up(hub: &Hub, path: Option<&Path>) -> Result<(), HttpError> {
    let words = path.map(|path| vec![path.display().to_string()]);
    let changes = Changes::from([("script".to_owned(), words)]);
    hub.change_settings(&changes).map_err(|refused| {
        let error = match refused {
            Refused::Invalid(error) | Refused::NotSaved(error) => error,
            Refused::NoOptions | Refused::Moving => "the setting cannot change now".to_owned(),
        };
        HttpError::new(StatusCode::INTERNAL_SERVER_ERROR, error)
    })
}

fn failed(what: &str, error: &io::Error) -> HttpError {
    HttpError::new(StatusCode::INTERNAL_SERVER_ERROR, format!("the script cannot be {what}: {error}"))
}

/// Returns whether this is the name of a script: no path, no hidden file, nothing that a file system treats specially.
fn is_name(name: &str) -> bool {
    let stem = name.strip_suffix(".lua").unwrap_or("");
    let is_letter = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-');
    !stem.is_empty() && name.len() <= MAX_NAME_LEN && stem.bytes().all(is_letter)
}

#[cfg(test)]
mod tests {
    use super::is_name;

    #[test]
    fn names_of_scripts_lead_out_of_no_folder() {
        for name in ["a.lua", "remote_2.lua", "B-1.lua"] {
            assert!(is_name(name), "{name}");
        }
        for name in
            ["", ".lua", "a", "a.LUA", "../a.lua", "a/b.lua", "a\\b.lua", "a..lua", "a\0.lua", "\u{e4}.lua"]
        {
            assert!(!is_name(name), "{name}");
        }
        assert!(!is_name(&format!("{}.lua", "a".repeat(60))));
    }
}
