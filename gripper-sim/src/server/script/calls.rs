//! The functions that a script can call (`docs/simulator.md`).

use super::{MAX_LINE_LEN, clipped, first_line, loadable, switched_off};
use crate::finger::{Finger, Jaw};
use crate::gripper::State;
use crate::port::{MAX_FRAME_LEN, PortId};
use crate::script::SCRIPT_IDS;
use crate::server::folder;
use crate::server::hub::{Hub, Run};
use mlua::chunk::ChunkMode;
use mlua::{Function, IntoLuaMulti, Lua, LuaString, MultiValue, Result, Table, Value};
use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::io::ErrorKind;
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{
    Command, GripperState, HomingDirection, PrePositionFlags, SoftLimits, Status, SystemFlags,
};

/// The longest answer, in bytes.
const MAX_ANSWER_LEN: usize = MAX_FRAME_LEN - OVERHEAD;

/// How many distinct messages to a script are logged once.
const MAX_NOTED: usize = 100;

/// Maximum nesting depth of tables in an answer.
const MAX_NESTING: usize = 5;

/// Burst limit of log lines of a script, followed by the sustained limit per second. Assumed.
const LINES_AT_ONCE: f64 = 1_000.0;
const LINES_PER_SECOND: f64 = 100.0;

/// The longest pattern of `string.find` and related functions, in bytes. Assumed.
const MAX_PATTERN_LEN: usize = 1_024;

/// The longest module, in bytes. Assumed.
const MAX_MODULE_LEN: u64 = 1 << 20;

/// Time-out of a motion that a script waits for.
const MAX_MOTION: Duration = Duration::from_secs(60);
/// Polling interval for the end of a motion.
const LOOK_AT_MOTION: Duration = Duration::from_millis(5);

/// Removes unsafe functions from Lua and adds `require`.
const SANDBOX: &str = include_str!("sandbox.lua");

/// The access of a script to the gripper.
struct Caller {
    hub: Arc<Hub>,
    run: Run,
    /// Number of checks since the script last waited.
    looks: Rc<Cell<u32>>,
    /// The ids that the script has claimed.
    claimed: RefCell<BTreeSet<u8>>,
    /// The client of the latest command by id, and whether the script has sent its answer.
    clients: RefCell<BTreeMap<u8, (PortId, bool)>>,
    /// The latest client of any command.
    client: Cell<Option<PortId>>,
    noted: RefCell<BTreeSet<String>>,
    printed: Cell<Printed>,
    /// The line that is printed so far, without its line end.
    unfinished: RefCell<String>,
    /// The gains of the speed controller, which have no effect here.
    gains: Cell<[f64; 3]>,
}

/// The rate limit of a script's log output.
#[derive(Clone, Copy)]
struct Printed {
    /// Lines that may still be written, as of `at`.
    allowed: f64,
    at: Instant,
    /// Lines dropped since the last one written.
    lost: u64,
}

impl Printed {
    fn new() -> Self {
        Self { allowed: LINES_AT_ONCE, at: Instant::now(), lost: 0 }
    }

    /// Takes one line from the limit and returns whether it may be written.
    fn takes_line(&mut self) -> bool {
        let earned = self.at.elapsed().as_secs_f64() * LINES_PER_SECOND;
        *self = Self { allowed: (self.allowed + earned).min(LINES_AT_ONCE), at: Instant::now(), ..*self };
        if self.allowed < 1.0 {
            self.lost += 1;
            return false;
        }
        self.allowed -= 1.0;
        true
    }
}

/// Installs all functions that a script can call, and removes those that could harm the host.
///
/// `directory` contains the files that the script may `require`.
pub(super) fn install(
    lua: &Lua,
    hub: &Arc<Hub>,
    run: Run,
    looks: &Rc<Cell<u32>>,
    directory: &Path,
) -> Result<()> {
    let caller = Rc::new(Caller {
        hub: Arc::clone(hub),
        run,
        looks: Rc::clone(looks),
        claimed: RefCell::default(),
        clients: RefCell::default(),
        client: Cell::default(),
        noted: RefCell::default(),
        printed: Cell::new(Printed::new()),
        unfinished: RefCell::default(),
        gains: Cell::new([1.0, 0.0, 0.0]),
    });
    let globals = lua.globals();
    for status in Status::ALL {
        globals.raw_set(status.symbol(), status.code())?;
    }
    commands(lua, &caller)?;
    motions(lua, &caller)?;
    grasping(lua, &caller)?;
    sensors(lua, &caller)?;
    finger_interfaces(lua, &caller)?;
    user_flags(lua, &caller)?;
    numbers(lua, &caller)?;
    time_and_text(lua, &caller)?;
    let sandbox = lua.load(SANDBOX).set_name("=sandbox");
    sandbox.call::<()>((
        MAX_PATTERN_LEN,
        module_loader(lua, directory)?,
        globals.raw_get::<Table>("socket")?,
    ))?;
    for name in
        ["cmd", "mc", "grasping", "gripper", "finger", "fieldbus", "math", "string", "table", "socket"]
    {
        name_missing(lua, &caller, &globals.raw_get(name)?, &format!("{name}."))?;
    }
    name_missing(lua, &caller, &globals, "")
}

impl Caller {
    /// Calls `act` with the gripper. It must not block.
    ///
    /// # Errors
    /// Returns an error if the script was stopped or the gripper is powered off.
    fn ask<T>(&self, act: impl FnOnce(&Hub) -> T) -> Result<T> {
        self.hub.act_for_script(self.run, act).ok_or_else(switched_off)
    }

    /// Calls `wait`, which may block. A script that waits need not rest.
    fn wait<T>(&self, wait: impl FnOnce(&Hub) -> T) -> Result<T> {
        self.looks.set(0);
        if self.hub.script_is_over(self.run) {
            return Err(switched_off());
        }
        Ok(wait(&self.hub))
    }

    /// Writes lines to the log.
    fn log(&self, lines: Vec<String>) -> Result<()> {
        self.ask(|hub| {
            for line in lines {
                hub.script_output(&line);
            }
        })
    }

    /// Logs a text printed by the script, within its limit. The rest after the last line end is logged with the next text, or
    /// at the end of the script.
    fn print(&self, text: &str) -> Result<()> {
        let mut printed = self.printed.get();
        let mut lines = Vec::new();
        for piece in text.split_inclusive('\n') {
            let mut unfinished = self.unfinished.borrow_mut();
            // One more, so that the line is marked as clipped.
            let room = (MAX_LINE_LEN + 1).saturating_sub(unfinished.chars().count());
            unfinished.extend(piece.strip_suffix('\n').unwrap_or(piece).chars().take(room));
            if !piece.ends_with('\n') {
                break;
            }
            let line = std::mem::take(&mut *unfinished);
            let lost = printed.lost;
            if !printed.takes_line() {
                continue;
            }
            if lost > 0 {
                lines.push(format!(
                    "{lost} lines are omitted here: a script may write {LINES_PER_SECOND} a second"
                ));
                printed.lost = 0;
            }
            lines.push(clipped(line.strip_suffix('\r').unwrap_or(&line)));
        }
        self.printed.set(printed);
        if lines.is_empty() { Ok(()) } else { self.log(lines) }
    }

    /// Logs a message once, with the line of the script. `above` is the number of stack levels up to that line.
    fn note(&self, lua: &Lua, above: usize, what: impl Display) -> Result<()> {
        let line = lua.inspect_stack(above, |caller| caller.current_line()).flatten();
        let text = match line {
            Some(line) => format!("line {line}: {what}"),
            None => what.to_string(),
        };
        let text = clipped(&text);
        let is_new = self.noted.borrow().len() < MAX_NOTED && self.noted.borrow_mut().insert(text.clone());
        if is_new { self.log(vec![text]) } else { Ok(()) }
    }

    /// Returns the client to send a frame with this id to: the sender of the last command with the id, if it is still there
    /// or has had no answer. Otherwise the frame is a push, to the client that [`Hub::script_client`] returns, if any.
    fn receiver(&self, id: u8) -> Result<Option<PortId>> {
        let last = self.clients.borrow().get(&id).copied();
        if last.is_none() && !self.claimed.borrow().contains(&id) {
            return Err(wrong(format_args!("cmd.send: the command {id:02X}h is not registered")));
        }
        let preferred = last.map(|(port, _)| port).or(self.client.get());
        let present = self.ask(|hub| hub.script_client(preferred))?.map(|(port, _)| port);
        let Some((asked, is_answered)) = last else { return Ok(present) };
        self.clients.borrow_mut().insert(id, (asked, true));
        Ok(if is_answered { present } else { Some(asked) })
    }

    /// Waits until `is_there` returns `true` for the state; returns `false` on a time-out.
    fn wait_until(&self, mut is_there: impl FnMut(&State) -> bool) -> Result<bool> {
        let start = Instant::now();
        while !is_there(&self.ask(state)?) {
            if start.elapsed() > MAX_MOTION {
                return Ok(false);
            }
            self.wait(|hub| hub.script_sleeps(self.run, LOOK_AT_MOTION))?;
        }
        Ok(true)
    }

    /// Executes a motion and waits for its end.
    fn motion(&self, lua: &Lua, call: &str, order: Command<'static>) -> Result<u16> {
        let status = self.execute(lua, call, order)?;
        if status != Status::Success.code() {
            return Ok(status);
        }
        let mut last = GripperState::Idle;
        let has_ended = self.wait_until(|state| {
            last = state.gripper;
            !matches!(last, GripperState::Gripping | GripperState::Releasing | GripperState::Positioning)
        })?;
        Ok(match last {
            _ if !has_ended => Status::Timeout.code(),
            GripperState::NoPart | GripperState::Error => Status::CmdFailed.code(),
            _ => Status::Success.code(),
        })
    }

    /// Executes a command and returns its status. An error status is logged once.
    fn execute(&self, lua: &Lua, call: &str, order: Command<'static>) -> Result<u16> {
        self.status(lua, call, |hub| hub.act(|gripper, now| gripper.command(&order, now)))
    }

    /// Sets a number, if one is given, with the command that `order` returns.
    fn set(
        &self,
        lua: &Lua,
        call: &str,
        number: Option<f32>,
        unit: &str,
        order: impl FnOnce(f32) -> Command<'static>,
    ) -> Result<()> {
        match number {
            Some(number) if number.is_finite() => self.execute(lua, call, order(number)).map(drop),
            Some(_) => Err(wrong(format_args!("{call}: expected {unit}"))),
            None => Ok(()),
        }
    }

    /// Starts velocity mode at this speed in mm/s.
    fn run_at(&self, lua: &Lua, call: &str, speed: f32) -> Result<u16> {
        self.status(lua, call, |hub| hub.act(|gripper, now| gripper.run_for_script(speed, now)))
    }

    /// Calls `act` with the gripper and returns its status. An error status is logged once.
    fn status(&self, lua: &Lua, call: &str, act: impl FnOnce(&Hub) -> Status) -> Result<u16> {
        let status = self.ask(act)?;
        if matches!(status, Status::Success | Status::CmdPending) {
            return Ok(Status::Success.code());
        }
        self.note(lua, 2, format_args!("{call}: {status}"))?;
        Ok(status.code())
    }
}

impl Drop for Caller {
    fn drop(&mut self) {
        if !self.unfinished.borrow().is_empty() {
            // After a stop, nothing is logged any more.
            let _ = self.print("\n");
        }
    }
}

/// Returns the current state.
fn state(hub: &Hub) -> State {
    hub.look(|gripper| gripper.state())
}

/// Returns the force in N, summed over both fingers: as force sensors measure it, otherwise from the motor current.
fn measured_force(hub: &Hub) -> f32 {
    hub.look(|gripper| {
        let per_jaw = gripper.state().force / 2.0;
        [Jaw::One, Jaw::Two].iter().map(|jaw| gripper.finger(*jaw).1.unwrap_or(per_jaw)).sum()
    })
}

/// Builds a function that raises the error returned by another one in the form scripts expect: a text with the position
/// in the script.
const RAISING: &str = "
    local function finish(ok, ...)
        if ok then return ... end
        error((...), 3)
    end
    return function(f) return function(...) return finish(f(...)) end end
";

/// A table of functions under a global name.
struct Module<'a> {
    lua: &'a Lua,
    caller: &'a Rc<Caller>,
    table: Table,
}

impl<'a> Module<'a> {
    fn new(lua: &'a Lua, caller: &'a Rc<Caller>, name: &str) -> Result<Self> {
        let table = lua.create_table()?;
        lua.globals().raw_set(name, &table)?;
        Ok(Self { lua, caller, table })
    }

    fn function<A, R>(
        &self,
        name: &str,
        act: impl Fn(&Lua, &Caller, A) -> Result<R> + 'static,
    ) -> Result<&Self>
    where
        A: mlua::FromLuaMulti,
        R: IntoLuaMulti,
    {
        let caller = Rc::clone(self.caller);
        let function = self.lua.create_function(move |lua, arguments: MultiValue| {
            let result = A::from_lua_multi(arguments, lua).and_then(|arguments| act(lua, &caller, arguments));
            match result {
                Ok(values) => (true, values.into_lua_multi(lua)?).into_lua_multi(lua),
                Err(error) => (false, first_line(&error)).into_lua_multi(lua),
            }
        })?;
        let raising: Function = self.lua.load(RAISING).eval()?;
        self.table.raw_set(name, raising.call::<Function>(function)?)?;
        Ok(self)
    }
}

fn commands(lua: &Lua, caller: &Rc<Caller>) -> Result<()> {
    let module = Module::new(lua, caller, "cmd")?;
    module
        .function("register", |_, caller, id: u32| {
            let is_claimed = match u8::try_from(id) {
                Ok(id) => caller.ask(|hub| hub.act(|gripper, _| gripper.claim_for_script(id)))?,
                Err(_) => false,
            };
            if is_claimed {
                caller.claimed.borrow_mut().insert(id as u8);
                return Ok(());
            }
            let (first, last) = (SCRIPT_IDS.start(), SCRIPT_IDS.end());
            Err(wrong(format_args!(
                "cmd.register: {id:02X}h is not an id for scripts; expected {first:02X}h to {last:02X}h"
            )))
        })?
        .function("unregister", |_, caller, id: u32| match u8::try_from(id) {
            Ok(id) => {
                caller.claimed.borrow_mut().remove(&id);
                caller.ask(|hub| hub.act(|gripper, _| gripper.release_for_script(id))).map(drop)
            }
            Err(_) => Ok(()),
        })?
        .function("available", |_, caller, ()| {
            caller.ask(|hub| hub.look(|gripper| gripper.script_requests()))
        })?
        .function("online", |_, caller, ()| caller.ask(|hub| hub.script_client(None).is_some()))?
        .function("interface", |_, caller, ()| {
            let last = caller.client.get();
            caller.ask(|hub| hub.script_client(last).map(|(_, interface)| interface))
        })?
        .function("read", |lua, caller, ()| {
            let request = caller.wait(|hub| hub.script_request(caller.run))?.ok_or_else(switched_off)?;
            caller.clients.borrow_mut().insert(request.id, (request.port, false));
            caller.client.set(Some(request.port));
            Ok((request.id, lua.create_sequence_from(request.payload)?))
        })?
        .function("send", |_, caller, (id, values): (u8, MultiValue)| {
            let mut payload = Vec::new();
            for value in &values {
                append(&mut payload, value, 0)?;
            }
            let Some(port) = caller.receiver(id)? else { return Ok(()) };
            caller
                .ask(move |hub| hub.act(|gripper, _| gripper.answer_for_script(port, id, &payload)))
                .map(|_| ())
        })?;
    Ok(())
}

/// Appends a value to an answer: numbers as bytes, booleans as 0 or 1, strings as their bytes, and tables of any of these.
fn append(payload: &mut Vec<u8>, value: &Value, depth: usize) -> Result<()> {
    match value {
        Value::Integer(number) => put(payload, &[byte("cmd.send", *number as f64)?]),
        Value::Number(number) => put(payload, &[byte("cmd.send", *number)?]),
        Value::Boolean(flag) => put(payload, &[u8::from(*flag)]),
        Value::String(text) => put(payload, &text.as_bytes()),
        Value::Table(_) if depth == MAX_NESTING => {
            Err(wrong(format_args!("cmd.send: tables may be nested at most {MAX_NESTING} deep")))
        }
        Value::Table(table) => {
            table.sequence_values::<Value>().try_for_each(|value| append(payload, &value?, depth + 1))
        }
        other => {
            let kind = other.type_name();
            Err(wrong(format_args!(
                "cmd.send: a {kind} is not a byte; expected numbers, booleans, strings, or tables of them"
            )))
        }
    }
}

fn put(payload: &mut Vec<u8>, bytes: &[u8]) -> Result<()> {
    if payload.len() + bytes.len() > MAX_ANSWER_LEN {
        return Err(wrong(format_args!("cmd.send: an answer may have at most {MAX_ANSWER_LEN} bytes")));
    }
    payload.extend_from_slice(bytes);
    Ok(())
}

/// Converts a number to a byte. Fractions are truncated, as in C.
fn byte(call: &str, number: f64) -> Result<u8> {
    let byte = number.trunc();
    if (0.0..=255.0).contains(&byte) {
        Ok(byte as u8)
    } else {
        Err(wrong(format_args!("{call}: {number} is not a byte; expected 0 to 255")))
    }
}

fn motions(lua: &Lua, caller: &Rc<Caller>) -> Result<()> {
    let module = Module::new(lua, caller, "mc")?;
    module
        .function("position", |_, caller, ()| caller.ask(|hub| state(hub).reported_width))?
        .function("aforce", |_, caller, ()| caller.ask(|hub| state(hub).force))?
        .function("busy", |_, caller, ()| caller.ask(|hub| hub.look(|gripper| gripper.is_busy())))?
        .function("blocked", |_, caller, ()| {
            caller.ask(|hub| {
                state(hub).flags.intersects(SystemFlags::BLOCKED_MINUS.union(SystemFlags::BLOCKED_PLUS))
            })
        })?
        .function("speed", |lua, caller, speed: Option<f32>| match speed {
            None => caller.ask(|hub| state(hub).speed),
            Some(speed) => {
                caller.run_at(lua, "mc.speed", speed)?;
                Ok(speed)
            }
        })?
        .function("move", |lua, caller, (width, speed, flags): (f32, f32, Option<u8>)| {
            let Some(flags) = PrePositionFlags::from_bits(flags.unwrap_or(0)) else {
                return Err(wrong(format_args!("mc.move: expected the flags of Pre-position (21h), 0 to 3")));
            };
            if !width.is_finite() || !speed.is_finite() {
                return Err(wrong(format_args!("mc.move: expected a width in mm and a speed in mm/s")));
            }
            caller.execute(lua, "mc.move", Command::PrePosition { flags, width, speed })
        })?
        .function("stop", |lua, caller, ()| caller.execute(lua, "mc.stop", Command::Stop))?
        .function("force", |lua, caller, force: Option<f32>| {
            caller.set(lua, "mc.force", force, "a force in N", |force| Command::SetForceLimit { force })?;
            caller.ask(|hub| (measured_force(hub), state(hub).force_limit))
        })?
        .function("acceleration", |lua, caller, acceleration: Option<f32>| {
            let order = |acceleration| Command::SetAcceleration { acceleration };
            caller.set(lua, "mc.acceleration", acceleration, "mm/s²", order)?;
            caller.ask(|hub| state(hub).acceleration)
        })?
        .function("softlimits", |lua, caller, limits: (Option<f32>, Option<f32>)| {
            match limits {
                (Some(minus), Some(plus)) if minus.is_finite() && plus.is_finite() => {
                    let limits = SoftLimits { minus, plus };
                    caller.execute(lua, "mc.softlimits", Command::SetSoftLimits { limits })?;
                }
                (None, None) => {}
                _ => return Err(wrong(format_args!("mc.softlimits: expected two widths in mm"))),
            }
            let limits = caller.ask(|hub| state(hub).soft_limits)?;
            Ok((limits.map(|limits| limits.minus), limits.map(|limits| limits.plus)))
        })?
        .function("homing", |lua, caller, direction: Value| {
            let direction = match direction {
                Value::Nil | Value::Integer(0) => HomingDirection::Default,
                Value::Boolean(true) | Value::Integer(1) => HomingDirection::Positive,
                Value::Boolean(false) | Value::Integer(2) => HomingDirection::Negative,
                _ => {
                    return Err(wrong(format_args!(
                        "mc.homing: expected true or 1 (outward), false or 2 (inward), or 0"
                    )));
                }
            };
            caller.motion(lua, "mc.homing", Command::Homing { direction })
        })?
        .function("pid", |_, caller, gains: (Option<f64>, Option<f64>, Option<f64>)| {
            match gains {
                (None, None, None) => {}
                (Some(p), Some(i), Some(d)) if [p, i, d].iter().all(|gain| gain.is_finite()) => {
                    caller.gains.set([p, i, d]);
                }
                _ => return Err(wrong(format_args!("mc.pid: expected three gains, or none to read them"))),
            }
            let [p, i, d] = caller.gains.get();
            Ok((p, i, d))
        })?;
    Ok(())
}

/// Grip functions that wait for the end of their motion. Public scripts call them in sequence.
fn grasping(lua: &Lua, caller: &Rc<Caller>) -> Result<()> {
    Module::new(lua, caller, "grasping")?
        .function("state", |_, caller, ()| caller.ask(|hub| state(hub).gripper.code()))?
        .function("move", |lua, caller, (width, speed): (f32, f32)| {
            let flags = PrePositionFlags::STOP_ON_BLOCK;
            finite("grasping.move", &[width, speed])?;
            caller.motion(lua, "grasping.move", Command::PrePosition { flags, width, speed })
        })?
        .function("grasp", |lua, caller, (width, speed, force): (f32, f32, Option<f32>)| {
            finite("grasping.grasp", &[width, speed, force.unwrap_or(0.0)])?;
            if let Some(status) = refused_force(lua, caller, "grasping.grasp", force)? {
                return Ok(status);
            }
            caller.motion(lua, "grasping.grasp", Command::GripPart { width, speed })
        })?
        .function("release", |lua, caller, (width, speed): (f32, f32)| {
            finite("grasping.release", &[width, speed])?;
            caller.motion(lua, "grasping.release", Command::ReleasePart { width, speed })
        })?
        .function("clamp", |lua, caller, (travel, force): (f32, Option<f32>)| {
            finite("grasping.clamp", &[travel, force.unwrap_or(0.0)])?;
            if let Some(status) = refused_force(lua, caller, "grasping.clamp", force)? {
                return Ok(status);
            }
            let from = caller.ask(|hub| state(hub).width)?;
            let speed = caller.ask(|hub| hub.config().speed)?;
            let status = caller.run_at(lua, "grasping.clamp", -speed)?;
            if status != Status::Success.code() {
                return Ok(status);
            }
            let mut is_clamped = false;
            caller.wait_until(|state| {
                // Checked first: the fingers may have gone further since the last look, and have met a part there.
                let is_too_far = from - state.width > travel.abs();
                let is_blocked = state.flags.contains(SystemFlags::BLOCKED_MINUS) && state.force > 0.0;
                is_clamped = is_blocked && !is_too_far;
                is_clamped || is_too_far || !matches!(state.gripper, GripperState::Positioning)
            })?;
            if is_clamped {
                return Ok(status);
            }
            caller.execute(lua, "grasping.clamp", Command::Stop)?;
            Ok(Status::CmdFailed.code())
        })?
        .function("stop_clamping", |lua, caller, ()| {
            caller.execute(lua, "grasping.stop_clamping", Command::Stop)
        })?;
    Ok(())
}

/// Sets the force limit, if given. Returns the status if it was rejected.
fn refused_force(lua: &Lua, caller: &Caller, call: &str, force: Option<f32>) -> Result<Option<u16>> {
    let Some(force) = force else { return Ok(None) };
    let status = caller.execute(lua, call, Command::SetForceLimit { force })?;
    Ok((status != Status::Success.code()).then_some(status))
}

fn finite(call: &str, numbers: &[f32]) -> Result<()> {
    if numbers.iter().all(|number| number.is_finite()) {
        Ok(())
    } else {
        Err(wrong(format_args!("{call}: expected finite numbers in mm, mm/s and N")))
    }
}

fn sensors(lua: &Lua, caller: &Rc<Caller>) -> Result<()> {
    Module::new(lua, caller, "gripper")?
        .function("state", |_, caller, ()| caller.ask(|hub| state(hub).flags.bits()))?;
    Module::new(lua, caller, "finger")?
        .function("type", |_, caller, index: u8| {
            let jaw = jaw(index)?;
            let (finger, _) = caller.ask(|hub| hub.look(|gripper| gripper.finger(jaw)))?;
            // An empty port is reported as a generic finger.
            Ok(if finger == Finger::None { Finger::Generic.name() } else { finger.name() })
        })?
        .function("data", |_, caller, index: u8| {
            let jaw = jaw(index)?;
            let (_, force) = caller.ask(|hub| hub.look(|gripper| gripper.finger(jaw)))?;
            Ok(force)
        })?
        .function("count", |_, _, ()| Ok(2))?
        .function("power", |lua, caller, (index, enabled): (u8, bool)| {
            let order = match jaw(index)? {
                Jaw::One => Command::Finger1Power { enabled },
                Jaw::Two => Command::Finger2Power { enabled },
            };
            caller.execute(lua, "finger.power", order)
        })?;
    Ok(())
}

/// The interface of a finger with custom electronics, open until the script ends. Nothing is connected here: writes are lost
/// and reads return nothing.
fn finger_interfaces(lua: &Lua, caller: &Rc<Caller>) -> Result<()> {
    let module = Module { lua, caller, table: lua.globals().raw_get("finger")? };
    module
        .function("interface", |_, caller, (index, kind): (u8, String)| {
            let jaw = jaw(index)?;
            match kind.as_str() {
                "uart" | "spi" => caller.ask(|hub| hub.act(|gripper, _| gripper.open_finger_interface(jaw))),
                _ => Err(wrong(format_args!(
                    "finger.interface: {kind:?} is unknown; expected \"uart\" or \"spi\""
                ))),
            }
        })?
        .function("write", |lua, caller, (index, data): (u8, Value)| {
            jaw(index)?;
            bytes("finger.write", &data)?;
            caller.note(lua, 2, "finger.write: no electronics are connected; the bytes are lost")
        })?
        .function("read", |lua, _, (index, _): (u8, Option<u32>)| {
            jaw(index)?;
            lua.create_table()
        })?
        .function("bytes_available", |_, _, index: u8| jaw(index).map(|_| 0))?
        .function("spi", |_, _, (index, data): (u8, Value)| {
            jaw(index)?;
            Ok(vec![0u8; bytes("finger.spi", &data)?])
        })?;
    Ok(())
}

/// Returns the length in bytes of a number, a string or a table of numbers.
fn bytes(call: &str, data: &Value) -> Result<usize> {
    match data {
        Value::Integer(number) => byte(call, *number as f64).map(|_| 1),
        Value::Number(number) => byte(call, *number).map(|_| 1),
        Value::String(text) => Ok(text.as_bytes().len()),
        Value::Table(table) => {
            table.sequence_values::<f64>().try_fold(0, |count, number| byte(call, number?).map(|_| count + 1))
        }
        other => {
            let kind = other.type_name();
            Err(wrong(format_args!(
                "{call}: a {kind} is not data; expected a string, a byte or a table of bytes"
            )))
        }
    }
}

/// The user flags of the register interface (fieldbus manual, 5.1.1): the PLC writes IF and reads OF.
fn user_flags(lua: &Lua, caller: &Rc<Caller>) -> Result<()> {
    Module::new(lua, caller, "fieldbus")?
        .function("inputs", |_, caller, ()| caller.ask(inputs))?
        .function("input", |_, caller, number: u32| {
            let flag = flag("fieldbus.input", number)?;
            Ok(caller.ask(inputs)? & flag != 0)
        })?
        .function("outputs", |_, caller, flags: Option<f64>| {
            if let Some(flags) = flags {
                let flags = byte("fieldbus.outputs", flags)?;
                caller.ask(|hub| hub.act(|gripper, _| gripper.set_user_outputs(flags)))?;
            }
            caller.ask(outputs)
        })?
        .function("output", |_, caller, (number, on): (u32, Option<bool>)| {
            let flag = flag("fieldbus.output", number)?;
            let flags = caller.ask(outputs)?;
            let Some(on) = on else { return Ok(flags & flag != 0) };
            let flags = if on { flags | flag } else { flags & !flag };
            caller.ask(|hub| hub.act(|gripper, _| gripper.set_user_outputs(flags)))?;
            Ok(on)
        })?;
    Ok(())
}

/// Returns the IF flags.
fn inputs(hub: &Hub) -> u8 {
    hub.look(|gripper| gripper.fieldbus_images().0.user)
}

/// Returns the OF flags.
fn outputs(hub: &Hub) -> u8 {
    hub.look(|gripper| gripper.fieldbus_images().1.user)
}

/// Returns the bit of a user flag with this number.
fn flag(call: &str, number: u32) -> Result<u8> {
    match number {
        1..=8 => Ok(1 << (number - 1)),
        _ => Err(wrong(format_args!("{call}: there is no flag {number}; expected 1 to 8"))),
    }
}

fn jaw(index: u8) -> Result<Jaw> {
    match index {
        0 => Ok(Jaw::One),
        1 => Ok(Jaw::Two),
        _ => Err(wrong(format_args!("finger: there is no finger {index}; expected 0 or 1"))),
    }
}

/// Conversions between numbers and bytes, low byte first.
fn numbers(lua: &Lua, caller: &Rc<Caller>) -> Result<()> {
    let module = Module { lua, caller, table: lua.globals() };
    module
        .function("etob", |_, _, status: u16| Ok(status.to_le_bytes()))?
        .function("ntob", |_, _, number: f32| Ok(number.to_le_bytes()))?
        .function("bton", |_, _, bytes: Vec<u8>| match bytes.first_chunk() {
            Some(bytes) => Ok(f32::from_le_bytes(*bytes)),
            None => Err(wrong(format_args!(
                "bton: {} bytes cannot be converted to a number; expected 4",
                bytes.len()
            ))),
        })?;
    module.table.raw_get::<Table>("math")?.raw_set("nan", f64::NAN)
}

fn time_and_text(lua: &Lua, caller: &Rc<Caller>) -> Result<()> {
    let globals = lua.globals();
    Module::new(lua, caller, "socket")?.function("gettime", |_, _, ()| {
        Ok(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64())
    })?;
    let to_string: Function = globals.raw_get("tostring")?;
    let format: Function = globals.raw_get::<Table>("string")?.raw_get("format")?;
    let module = Module { lua, caller, table: globals };
    module
        .function("sleep", |_, caller, milliseconds: f64| {
            // A negative time does not wait.
            let duration = Duration::try_from_secs_f64(milliseconds.max(0.0) / 1_000.0)
                .map_err(|_| wrong(format_args!("sleep: expected a time in ms")))?;
            caller.wait(|hub| hub.script_sleeps(caller.run, duration))
        })?
        .function("print", move |_, caller, values: MultiValue| {
            let texts = values.iter().map(|value| Ok(to_string.call::<LuaString>(value)?.to_string_lossy()));
            caller.print(&(texts.collect::<Result<Vec<_>>>()?.join("\t") + "\n"))
        })?
        .function("printf", move |_, caller, values: MultiValue| {
            caller.print(&format.call::<LuaString>(values)?.to_string_lossy())
        })?;
    Ok(())
}

/// Returns a module as a function, or nil and the reason. A module is a text file in the directory of the script. Neither its
/// name nor a link leads out of that directory.
fn module_loader(lua: &Lua, directory: &Path) -> Result<Function> {
    let directory = directory.to_owned();
    lua.create_function(move |lua, name: Value| {
        let name = name.as_string().map(|name| name.to_string_lossy()).unwrap_or_default();
        let is_name = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-');
        if name.is_empty() || !name.bytes().all(is_name) {
            let why =
                format!("require: {:?} is not a name; expected letters, digits, _ and -", clipped(&name));
            return Ok((None, Some(why)));
        }
        let file = format!("{name}.lua");
        let source = match folder::read(&directory, &file, MAX_MODULE_LEN).and_then(loadable) {
            Ok(source) => source,
            Err(error) if error.kind() == ErrorKind::InvalidData => {
                return Ok((None, Some(format!("require: {file:?}: {error}"))));
            }
            Err(_) => {
                let why = format!("require: there is no {file:?} beside the script, or it cannot be read");
                return Ok((None, Some(why)));
            }
        };
        match lua.load(source).set_name(format!("@{file}")).set_mode(ChunkMode::Text).into_function() {
            Ok(run) => Ok((Some(run), None)),
            Err(error) => Ok((None, Some(first_line(&error)))),
        }
    })
}

/// Logs accesses to functions that do not exist.
fn name_missing(lua: &Lua, caller: &Rc<Caller>, table: &Table, prefix: &str) -> Result<()> {
    let metatable = lua.create_table()?;
    let (caller, prefix) = (Rc::clone(caller), prefix.to_owned());
    metatable.raw_set(
        "__index",
        lua.create_function(move |lua, (_, key): (Value, Value)| {
            let key = key.as_string().map(|key| key.to_string_lossy()).unwrap_or_default();
            caller.note(lua, 1, format_args!("{prefix}{key} does not exist"))?;
            Ok(Value::Nil)
        })?,
    )?;
    table.set_metatable(Some(metatable))
}

fn wrong(what: std::fmt::Arguments<'_>) -> mlua::Error {
    mlua::Error::runtime(what)
}
