//! A Lua script on the gripper: its thread, its limits, and its access to the gripper.
//!
//! Lua runs in a separate thread because its calls block. They use the gripper directly, under its lock, so a call
//! needs no thread switch. A busy or waiting script does not delay any line.

mod calls;

use super::folder;
use super::hub::{Hub, Run};
use crate::text::{self, one_line};
use anyhow::{Context, Result};
use mlua::chunk::ChunkMode;
use mlua::{HookTriggers, Lua, LuaOptions, StdLib, VmState};
use std::cell::Cell;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

/// Memory limit of a script in bytes. Assumed.
const MAX_MEMORY: usize = 16 << 20;

/// Stack size of a script's thread in bytes. Lua nests C calls up to 200 deep, and a match recurses once for each item
/// of its pattern, whose length `sandbox.lua` limits. Only touched pages use memory.
const STACK_SIZE: usize = 64 << 20;

/// The longest text of a script in one log line, in characters. Assumed.
const MAX_LINE_LEN: usize = 1_024;

/// Interval between two checks of a running script, in instructions.
const LOOK_EVERY: u32 = 1_000;

/// Number of checks without a wait after which a script must rest: about 10 ms on a PC.
const LOOKS_WITHOUT_REST: u32 = 1_000;

/// Duration of the rest.
const REST: Duration = Duration::from_millis(10);

/// A script that has been read and not started.
#[derive(Debug)]
pub(super) struct Script {
    path: PathBuf,
    source: Vec<u8>,
}

impl Script {
    /// Reads the script from a file.
    ///
    /// # Errors
    /// Returns an error that names the file.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let source = std::fs::read(path).and_then(loadable);
        let source = source.with_context(|| format!("the script {} cannot be read", path.display()))?;
        Ok(Self { path: path.to_owned(), source })
    }

    /// Reads the script from a file of this folder, at most `max_len` bytes; see [`folder::read`].
    ///
    /// # Errors
    /// Returns an error that names the file.
    pub(super) fn read_in(folder: &Path, name: &str, max_len: u64) -> Result<Self> {
        let source = folder::read(folder, name, max_len).and_then(loadable);
        let source = source.with_context(|| format!("the script {name} cannot be read"))?;
        Ok(Self { path: folder.join(name), source })
    }

    /// Runs the script in its own thread until it ends or the server ends. The end of the script affects nothing else.
    ///
    /// # Errors
    /// Returns an error if the system cannot create a thread.
    pub(super) fn start(self, hub: Arc<Hub>) -> Result<()> {
        let run = hub.begin_script(&self.name());
        let thread = thread::Builder::new().name("wsg-sim script".to_owned()).stack_size(STACK_SIZE);
        thread.spawn(move || self.run(&hub, run))?;
        Ok(())
    }

    fn name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    fn run(&self, hub: &Arc<Hub>, run: Run) {
        let executed = catch_unwind(AssertUnwindSafe(|| self.execute(hub, run)));
        if hub.script_is_over(run) {
            return;
        }
        let error = match executed {
            Ok(result) => result.err().map(|error| clipped(&first_line(&error))),
            Err(_) => Some("its thread panicked".to_owned()),
        };
        if let Some(error) = &error {
            // Without a log, this message is the only explanation for missing answers.
            eprintln!("wsg-sim: the script failed: {error}");
        }
        hub.end_script(run, error.as_deref());
    }

    fn execute(&self, hub: &Arc<Hub>, run: Run) -> mlua::Result<()> {
        let libraries = StdLib::TABLE | StdLib::STRING | StdLib::MATH;
        let lua = Lua::new_with(libraries, LuaOptions::default())?;
        lua.set_memory_limit(MAX_MEMORY)?;
        let looks = Rc::new(Cell::new(0));
        calls::install(&lua, hub, run, &looks, self.path.parent().unwrap_or(Path::new("")))?;
        let hub = Arc::clone(hub);
        let every = HookTriggers::new().every_nth_instruction(LOOK_EVERY);
        lua.set_global_hook(every, move |lua, _| {
            if hub.script_is_over(run) {
                // Interrupts every instruction from here on: a script that catches the error is interrupted again at
                // the next one.
                let always = HookTriggers::new().every_nth_instruction(1);
                lua.set_global_hook(always, |_, _| Err(switched_off()))?;
                // A running coroutine keeps its own hook. If it catches the error, it continues, but almost idle.
                thread::sleep(REST);
                return Err(switched_off());
            }
            looks.set(looks.get() + 1);
            if looks.get() >= LOOKS_WITHOUT_REST {
                looks.set(0);
                thread::sleep(REST);
            }
            Ok(VmState::Continue)
        })?;
        lua.load(&self.source).set_name(format!("@{}", self.name())).set_mode(ChunkMode::Text).exec()
    }
}

/// Returns the message of a Lua error without its traceback.
fn first_line(error: &mlua::Error) -> String {
    let text = match error {
        mlua::Error::RuntimeError(text) | mlua::Error::SyntaxError { message: text, .. } => text.clone(),
        other => other.to_string(),
    };
    clipped(text.lines().next().unwrap_or_default())
}

/// Formats a text of a script as one log line of limited length.
fn clipped(text: &str) -> String {
    let end = text.char_indices().nth(MAX_LINE_LEN).map_or(text.len(), |(at, _)| at);
    let (line, rest) = text.split_at(end);
    one_line(line).into_owned() + if rest.is_empty() { "" } else { "…" }
}

/// Prepares the text of a script or a module for Lua. A first line such as `#!/usr/bin/env lua` becomes a comment, as in Lua's
/// own loader, and a byte order mark is removed. Lua accepts any other bytes, in strings for example.
fn loadable(source: Vec<u8>) -> io::Result<Vec<u8>> {
    let mut source = text::unmarked(source)?;
    if source.starts_with(b"#") {
        source.splice(..0, *b"--");
    }
    Ok(source)
}

/// Returns the error that ends a stopped script.
fn switched_off() -> mlua::Error {
    mlua::Error::runtime("the script was stopped")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;
    use std::time::Instant;

    /// Maximum time that a script may continue after its gripper is powered off.
    const BOUND: Duration = Duration::from_secs(60);

    #[test]
    fn no_call_of_a_script_takes_effect_after_its_stop() {
        let hub = Hub::of_test();
        let outputs = || hub.look(|gripper| gripper.fieldbus_images().1.user);
        for _ in 0..100 {
            let source = "while true do fieldbus.outputs(255) end".into();
            Script { path: PathBuf::from("writes.lua"), source }.start(Arc::clone(&hub)).unwrap();
            let start = Instant::now();
            while outputs() != 255 {
                assert!(start.elapsed() < BOUND);
                thread::yield_now();
            }
            hub.stop_script();
            // The end of a script clears its outputs.
            for _ in 0..20 {
                assert_eq!(outputs(), 0);
                thread::yield_now();
            }
        }
    }

    #[test]
    fn script_that_catches_every_error_ends_with_its_gripper() {
        for source in [
            "while true do end",
            "while true do pcall(function() while true do end end) end",
            "while true do pcall(function() while true do pcall(cmd.read) end end) end",
            "while true do pcall(function() while true do pcall(mc.position) end end) end",
            "while true do pcall(sleep, 1e9) end",
        ] {
            let script = Script { path: PathBuf::from("endless.lua"), source: source.into() };
            let hub = Hub::of_test();
            let (ended, ends) = channel();
            let run = hub.begin_script("endless.lua");
            let seen = Arc::clone(&hub);
            thread::spawn(move || {
                script.run(&seen, run);
                let _ = ended.send(());
            });
            hub.switch_off();
            assert!(ends.recv_timeout(BOUND).is_ok(), "{source}");
        }
    }
}
