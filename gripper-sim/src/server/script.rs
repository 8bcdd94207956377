//! A Lua script on the gripper: its thread, its bounds, and how it gets at the gripper.
//!
//! Lua runs in a thread of its own, because its calls wait. What it asks for is done by a task beside those of the lines, and so
//! a script that is busy, or waits, keeps nobody waiting but itself.

mod calls;

use super::hub::Hub;
use crate::script::{ScriptRequest, ScriptState};
use anyhow::{Context, Result};
use mlua::chunk::ChunkMode;
use mlua::{HookTriggers, Lua, LuaOptions, StdLib, VmState};
use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

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

/// What a script asks of the gripper. One at a time: it waits for the answer.
pub(super) enum Call {
    /// To be done at once.
    Now(Box<dyn FnOnce(&Hub) + Send>),
    /// The next command for the script, once there is one.
    Read(SyncSender<ScriptRequest>),
    /// An answer after so long.
    Sleep(Duration, SyncSender<()>),
    /// It is over: by an error, if there is one.
    Ended(Option<String>),
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

    /// Runs the script and does what it asks for, as long as the server runs. Its end ends nothing else.
    pub(super) async fn serve(self, hub: Rc<Hub>) -> Result<()> {
        let (asks, mut asked) = unbounded_channel();
        let is_over = Over::default();
        let seen = Arc::clone(&is_over.0);
        set_state(&hub, ScriptState::Running);
        let thread = thread::Builder::new().name("wsg-sim script".to_owned()).stack_size(STACK_SIZE);
        thread.spawn(move || self.run(&asks, &seen))?;
        answer(&hub, &mut asked).await;
        // The gripper goes on without it.
        std::future::pending().await
    }

    fn run(self, asks: &UnboundedSender<Call>, is_over: &Arc<AtomicBool>) {
        let error = self.execute(asks, is_over).err().map(|error| first_line(&error));
        // A server that has ended needs no word of it.
        let _ = asks.send(Call::Ended(error));
    }

    fn execute(&self, asks: &UnboundedSender<Call>, is_over: &Arc<AtomicBool>) -> mlua::Result<()> {
        let libraries = StdLib::TABLE | StdLib::STRING | StdLib::MATH;
        let lua = Lua::new_with(libraries, LuaOptions::default())?;
        lua.set_memory_limit(MAX_MEMORY)?;
        let looks = Rc::new(Cell::new(0));
        calls::install(&lua, asks, &looks, self.path.parent().unwrap_or(Path::new("")))?;
        let is_over = Arc::clone(is_over);
        let every = HookTriggers::new().every_nth_instruction(LOOK_EVERY);
        lua.set_global_hook(every, move |lua, _| {
            if is_over.load(Ordering::Relaxed) {
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

/// Tells the script's thread when nobody answers it any more.
#[derive(Default)]
struct Over(Arc<AtomicBool>);

impl Drop for Over {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Does what a script asks for, until its end.
async fn answer(hub: &Hub, asked: &mut UnboundedReceiver<Call>) {
    while let Some(call) = asked.recv().await {
        // A script that does not wait for its answer has ended.
        match call {
            Call::Now(act) => act(hub),
            Call::Read(answer) => {
                let _ = answer.send(hub.script_request().await);
            }
            Call::Sleep(duration, answer) => {
                tokio::time::sleep(duration).await;
                let _ = answer.send(());
            }
            Call::Ended(error) => return end(hub, error),
        }
    }
    end(hub, Some("its thread ended without a word".to_owned()));
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

/// Has `act` done beside the gripper.
///
/// # Errors
/// When the gripper was switched off.
fn ask<T: Send + 'static>(
    asks: &UnboundedSender<Call>,
    act: impl FnOnce(&Hub) -> T + Send + 'static,
) -> mlua::Result<T> {
    ask_for(asks, |answer| {
        Call::Now(Box::new(move |hub| {
            let _ = answer.send(act(hub));
        }))
    })
}

/// Waits for the answer to a call.
fn ask_for<T>(asks: &UnboundedSender<Call>, call: impl FnOnce(SyncSender<T>) -> Call) -> mlua::Result<T> {
    let (answer, answered) = sync_channel(1);
    asks.send(call(answer)).map_err(|_| switched_off())?;
    answered.recv().map_err(|_| switched_off())
}

/// What ends a script whose gripper is gone.
fn switched_off() -> mlua::Error {
    mlua::Error::runtime("the gripper was switched off")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    /// The longest that a script may go on when its gripper is gone.
    const BOUND: Duration = Duration::from_secs(60);

    #[test]
    fn script_that_catches_every_error_ends_with_its_gripper() {
        for source in [
            "while true do end",
            "while true do pcall(function() while true do end end) end",
            "while true do pcall(function() while true do pcall(cmd.read) end end) end",
        ] {
            let script = Script { path: PathBuf::from("endless.lua"), source: source.into() };
            let (asks, asked) = unbounded_channel();
            let is_over = Arc::new(AtomicBool::new(false));
            let seen = Arc::clone(&is_over);
            let (ended, ends) = channel();
            thread::spawn(move || {
                script.run(&asks, &seen);
                let _ = ended.send(());
            });
            is_over.store(true, Ordering::Relaxed);
            drop(asked);
            assert!(ends.recv_timeout(BOUND).is_ok(), "{source}");
        }
    }
}
