//! A Lua script on the gripper: its thread, its bounds, and how it gets at the gripper.
//!
//! Lua runs in a thread of its own, because its calls wait. They use the gripper directly, under its lock, so a call takes
//! no switch of threads, and a script that is busy, or waits, delays no line.

mod calls;

use super::hub::Hub;
use crate::script::ScriptState;
use anyhow::{Context, Result};
use mlua::chunk::ChunkMode;
use mlua::{HookTriggers, Lua, LuaOptions, StdLib, VmState};
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

/// What a script may hold, in bytes. Assumed.
const MAX_MEMORY: usize = 16 << 20;

/// The stack of a script's thread, in bytes. Lua nests C calls 200 deep, and a match recurses once for each item of its pattern,
/// which is bounded in `sandbox.lua`. Only touched pages take memory.
const STACK_SIZE: usize = 64 << 20;

/// The longest text of a script in one line of the log, in characters. Assumed.
const MAX_LINE_LEN: usize = 1_024;

/// How often a script is looked at that waits for nothing, in instructions.
const LOOK_EVERY: u32 = 1_000;

/// After so many looks without a wait a script has to rest: some 10 ms of a PC.
const LOOKS_WITHOUT_REST: u32 = 1_000;

/// How long it rests then.
const REST: Duration = Duration::from_millis(10);

/// A script that has been read and waits for its start.
#[derive(Debug)]
pub(super) struct Script {
    path: PathBuf,
    source: Vec<u8>,
}

impl Script {
    /// Reads the file.
    ///
    /// # Errors
    /// One that names it.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let source =
            std::fs::read(path).with_context(|| format!("the script {} cannot be read", path.display()))?;
        Ok(Self { path: path.to_owned(), source })
    }

    /// Runs the script in a thread of its own, until its end or that of the server. Its end ends nothing else.
    ///
    /// # Errors
    /// The system has no thread left.
    pub(super) fn start(self, hub: Arc<Hub>) -> Result<()> {
        set_state(&hub, ScriptState::Running);
        let thread = thread::Builder::new().name("wsg-sim script".to_owned()).stack_size(STACK_SIZE);
        thread.spawn(move || self.run(&hub))?;
        Ok(())
    }

    fn run(&self, hub: &Arc<Hub>) {
        let executed = catch_unwind(AssertUnwindSafe(|| self.execute(hub)));
        if hub.is_off() {
            return;
        }
        match executed {
            Ok(result) => end(hub, result.err().map(|error| first_line(&error))),
            Err(_) => end(hub, Some("its thread panicked".to_owned())),
        }
    }

    fn execute(&self, hub: &Arc<Hub>) -> mlua::Result<()> {
        let libraries = StdLib::TABLE | StdLib::STRING | StdLib::MATH;
        let lua = Lua::new_with(libraries, LuaOptions::default())?;
        lua.set_memory_limit(MAX_MEMORY)?;
        let looks = Rc::new(Cell::new(0));
        calls::install(&lua, hub, &looks, self.path.parent().unwrap_or(Path::new("")))?;
        let hub = Arc::clone(hub);
        let every = HookTriggers::new().every_nth_instruction(LOOK_EVERY);
        lua.set_global_hook(every, move |lua, _| {
            if hub.is_off() {
                // At each instruction from here on: a script that catches this one gets no further than to the next.
                let always = HookTriggers::new().every_nth_instruction(1);
                lua.set_global_hook(always, |_, _| Err(switched_off()))?;
                // A coroutine that is running keeps its hook: what catches there goes on, but next to idle.
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
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        lua.load(&self.source).set_name(format!("@{name}")).set_mode(ChunkMode::Text).exec()
    }
}

fn end(hub: &Hub, error: Option<String>) {
    match error {
        None => {
            hub.note_of("script", format_args!("ended"));
            set_state(hub, ScriptState::None);
        }
        Some(error) => {
            let error = clipped(&error);
            // Whoever keeps no log would not know why nothing is answered any more.
            eprintln!("wsg-sim: the script failed: {error}");
            hub.note_of("script", format_args!("failed: {error}"));
            set_state(hub, ScriptState::Failed);
        }
    }
}

fn set_state(hub: &Hub, state: ScriptState) {
    hub.act(|gripper, now| gripper.set_script_state(state, now));
}

/// What Lua says, without the trace behind it.
fn first_line(error: &mlua::Error) -> String {
    let text = match error {
        mlua::Error::RuntimeError(text) | mlua::Error::SyntaxError { message: text, .. } => text.clone(),
        other => other.to_string(),
    };
    clipped(text.lines().next().unwrap_or_default())
}

/// A text of a script as one line of the log: bounded, and without control characters.
fn clipped(text: &str) -> String {
    let printable = |char: char| if char.is_control() && char != '\t' { '\u{FFFD}' } else { char };
    let mut line: String = text.chars().take(MAX_LINE_LEN).map(printable).collect();
    if line.len() < text.len() {
        line.push('…');
    }
    line
}

/// What ends a script whose gripper is gone.
fn switched_off() -> mlua::Error {
    mlua::Error::runtime("the gripper was switched off")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::server::lines::Profile;
    use std::sync::mpsc::channel;

    /// The longest that a script may go on after its gripper is switched off.
    const BOUND: Duration = Duration::from_secs(60);

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
            let hub = Arc::new(Hub::new(Config::default(), Profile::Instant, 0, None));
            let (ended, ends) = channel();
            let seen = Arc::clone(&hub);
            thread::spawn(move || {
                script.run(&seen);
                let _ = ended.send(());
            });
            hub.switch_off();
            assert!(ends.recv_timeout(BOUND).is_ok(), "{source}");
        }
    }
}
