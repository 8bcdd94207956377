//! What a script can call (`docs/scripts.md`).

use super::{Call, ask, ask_for, first_line};
use crate::finger::{Finger, Jaw};
use crate::gripper::State;
use crate::port::{MAX_FRAME_LEN, PortId};
use crate::script::SCRIPT_IDS;
use crate::server::hub::Hub;
use mlua::{Function, IntoLuaMulti, Lua, MultiValue, Result, Table, Value};
use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::rc::Rc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::sync::mpsc::UnboundedSender;
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{Command, HomingDirection, PrePositionFlags, Status, SystemFlags};

/// The longest answer.
const MAX_ANSWER_LEN: usize = MAX_FRAME_LEN - OVERHEAD;

/// How many things a script is told of once.
const MAX_NOTED: usize = 100;

/// A script's side of the gripper.
struct Caller {
    asks: UnboundedSender<Call>,
    /// Looks at the script since it waited last.
    looks: Rc<Cell<u32>>,
    /// Who asked last, by command.
    clients: RefCell<BTreeMap<u8, PortId>>,
    /// Who asked last at all.
    client: Cell<Option<PortId>>,
    noted: RefCell<BTreeSet<String>>,
}

/// Gives a script everything that it can call, and takes away what could harm the machine that it runs on.
pub(super) fn install(lua: &Lua, asks: &UnboundedSender<Call>, looks: &Rc<Cell<u32>>) -> Result<()> {
    let caller = Rc::new(Caller {
        asks: asks.clone(),
        looks: Rc::clone(looks),
        clients: RefCell::default(),
        client: Cell::default(),
        noted: RefCell::default(),
    });
    let globals = lua.globals();
    for file in ["dofile", "loadfile"] {
        globals.raw_set(file, Value::Nil)?;
    }
    for status in Status::ALL {
        globals.raw_set(status.symbol(), status.code())?;
    }
    commands(lua, &caller)?;
    motions(lua, &caller)?;
    sensors(lua, &caller)?;
    numbers(lua, &caller)?;
    time_and_text(lua, &caller)?;
    for name in ["cmd", "mc", "gripper", "finger", "math", "string", "table", "socket"] {
        name_what_is_missing(lua, &caller, &globals.raw_get(name)?, &format!("{name}."))?;
    }
    name_what_is_missing(lua, &caller, &globals, "")
}

impl Caller {
    fn ask<T: Send + 'static>(&self, act: impl FnOnce(&Hub) -> T + Send + 'static) -> Result<T> {
        ask(&self.asks, act)
    }

    /// Waits for an answer that may take as long as it likes.
    fn wait<T>(&self, call: impl FnOnce(std::sync::mpsc::SyncSender<T>) -> Call) -> Result<T> {
        self.looks.set(0);
        ask_for(&self.asks, call)
    }

    /// Writes a line to the log.
    fn log(&self, text: String) -> Result<()> {
        self.ask(move |hub| hub.note_of("script", format_args!("{text}")))
    }

    /// Writes a line to the log, once, with the line of the script. `above`: how many functions above it this is.
    fn note(&self, lua: &Lua, above: usize, what: impl Display) -> Result<()> {
        let line = lua.inspect_stack(above, |caller| caller.current_line()).flatten();
        let text = match line {
            Some(line) => format!("line {line}: {what}"),
            None => what.to_string(),
        };
        let is_new = self.noted.borrow().len() < MAX_NOTED && self.noted.borrow_mut().insert(text.clone());
        if is_new { self.log(text) } else { Ok(()) }
    }

    /// Carries out a command; what refused it is in the log, once, and returned.
    fn command(
        &self,
        lua: &Lua,
        call: &str,
        act: impl FnOnce(&Hub) -> Status + Send + 'static,
    ) -> Result<u16> {
        let status = self.ask(act)?;
        if matches!(status, Status::Success | Status::CmdPending) {
            return Ok(Status::Success.code());
        }
        self.note(lua, 2, format_args!("{call}: {status}"))?;
        Ok(status.code())
    }
}

/// How things stand now.
fn state(hub: &Hub) -> State {
    hub.act(|gripper, now| {
        gripper.advance(now);
        gripper.state()
    })
}

fn command(hub: &Hub, command: &Command<'_>) -> Status {
    hub.act(|gripper, now| gripper.command(command, now))
}

/// Makes a function that raises what another one returns, as scripts know errors: a text, with the place in the script.
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
                Ok(id) => caller.ask(move |hub| hub.act(|gripper, _| gripper.claim_for_script(id)))?,
                Err(_) => false,
            };
            if is_claimed {
                return Ok(());
            }
            let (first, last) = (SCRIPT_IDS.start(), SCRIPT_IDS.end());
            Err(wrong(format_args!(
                "cmd.register: {id:02X}h is no id for scripts; expected {first:02X}h to {last:02X}h"
            )))
        })?
        .function("online", |_, caller, ()| caller.ask(|hub| hub.interface(None).is_some()))?
        .function("interface", |_, caller, ()| {
            let last = caller.client.get();
            caller.ask(move |hub| hub.interface(last))
        })?
        .function("read", |lua, caller, ()| {
            let request = caller.wait(Call::Read)?;
            caller.clients.borrow_mut().insert(request.id, request.port);
            caller.client.set(Some(request.port));
            Ok((request.id, lua.create_sequence_from(request.payload)?))
        })?
        .function("send", |_, caller, (id, values): (u8, MultiValue)| {
            let mut payload = Vec::new();
            for value in &values {
                append(&mut payload, value)?;
            }
            let Some(port) = caller.clients.borrow().get(&id).copied() else {
                return Err(wrong(format_args!(
                    "cmd.send: no command {id:02X}h was read; nobody waits for an answer"
                )));
            };
            caller
                .ask(move |hub| hub.act(|gripper, _| gripper.answer_for_script(port, id, &payload)))
                .map(|_| ())
        })?;
    Ok(())
}

/// Puts a number, or all numbers of a table, behind what there is of an answer.
fn append(payload: &mut Vec<u8>, value: &Value) -> Result<()> {
    let number = match value {
        Value::Integer(number) => *number as f64,
        Value::Number(number) => *number,
        Value::Table(table) => {
            return table.sequence_values::<Value>().try_for_each(|value| append(payload, &value?));
        }
        other => {
            let kind = other.type_name();
            return Err(wrong(format_args!(
                "cmd.send: a {kind} is no byte; expected numbers, or tables of them"
            )));
        }
    };
    // As C takes a fraction.
    let byte = number.trunc();
    if !(0.0..=255.0).contains(&byte) {
        return Err(wrong(format_args!("cmd.send: {number} is no byte; expected 0 to 255")));
    }
    if payload.len() >= MAX_ANSWER_LEN {
        return Err(wrong(format_args!("cmd.send: an answer has {MAX_ANSWER_LEN} bytes at the most")));
    }
    payload.push(byte as u8);
    Ok(())
}

fn motions(lua: &Lua, caller: &Rc<Caller>) -> Result<()> {
    let module = Module::new(lua, caller, "mc")?;
    module
        .function("position", |_, caller, ()| caller.ask(|hub| state(hub).reported_width))?
        .function("aforce", |_, caller, ()| caller.ask(|hub| state(hub).force))?
        .function("busy", |_, caller, ()| caller.ask(|hub| state(hub).flags.contains(SystemFlags::MOVING)))?
        .function("blocked", |_, caller, ()| {
            caller.ask(|hub| {
                state(hub).flags.intersects(SystemFlags::BLOCKED_MINUS.union(SystemFlags::BLOCKED_PLUS))
            })
        })?
        .function("speed", |lua, caller, speed: Option<f32>| match speed {
            None => caller.ask(|hub| state(hub).speed),
            Some(speed) => {
                caller.command(lua, "mc.speed", move |hub| {
                    hub.act(|gripper, now| gripper.run_for_script(speed, now))
                })?;
                Ok(speed)
            }
        })?
        .function("move", |lua, caller, (width, speed, flags): (f32, f32, Option<u8>)| {
            let Some(flags) = PrePositionFlags::from_bits(flags.unwrap_or(0)) else {
                return Err(wrong(format_args!("mc.move: flags are those of Pre-position (21h), 0 to 3")));
            };
            if !width.is_finite() || !speed.is_finite() {
                return Err(wrong(format_args!("mc.move: expected a width in mm and a speed in mm/s")));
            }
            caller.command(lua, "mc.move", move |hub| {
                command(hub, &Command::PrePosition { flags, width, speed })
            })
        })?
        .function("stop", |lua, caller, ()| {
            caller.command(lua, "mc.stop", |hub| command(hub, &Command::Stop))
        })?
        .function("force", |lua, caller, force: Option<f32>| {
            match force {
                Some(force) if force.is_finite() => {
                    caller.command(lua, "mc.force", move |hub| {
                        command(hub, &Command::SetForceLimit { force })
                    })?;
                }
                Some(_) => return Err(wrong(format_args!("mc.force: expected a force in N"))),
                None => {}
            }
            caller.ask(|hub| state(hub).force_limit)
        })?
        .function("homing", |lua, caller, direction: Option<u8>| {
            let direction = match direction {
                None | Some(0) => HomingDirection::Default,
                Some(1) => HomingDirection::Positive,
                Some(2) => HomingDirection::Negative,
                Some(_) => {
                    return Err(wrong(format_args!("mc.homing: expected 0, 1 (outward) or 2 (inward)")));
                }
            };
            caller.command(lua, "mc.homing", move |hub| command(hub, &Command::Homing { direction }))
        })?;
    Ok(())
}

fn sensors(lua: &Lua, caller: &Rc<Caller>) -> Result<()> {
    Module::new(lua, caller, "gripper")?
        .function("state", |_, caller, ()| caller.ask(|hub| state(hub).flags.bits()))?;
    Module::new(lua, caller, "finger")?
        .function("type", |_, caller, index: u8| {
            let jaw = jaw(index)?;
            let (finger, _) = caller.ask(move |hub| hub.act(|gripper, _| gripper.finger(jaw)))?;
            // An empty port shows like a generic finger.
            Ok(if finger == Finger::None { Finger::Generic.name() } else { finger.name() })
        })?
        .function("data", |_, caller, index: u8| {
            let jaw = jaw(index)?;
            let (_, force) = caller.ask(move |hub| hub.act(|gripper, _| gripper.finger(jaw)))?;
            Ok(force)
        })?;
    Ok(())
}

fn jaw(index: u8) -> Result<Jaw> {
    match index {
        0 => Ok(Jaw::One),
        1 => Ok(Jaw::Two),
        _ => Err(wrong(format_args!("finger: there is none of number {index}; expected 0 or 1"))),
    }
}

/// Numbers to bytes and back, low byte first.
fn numbers(lua: &Lua, caller: &Rc<Caller>) -> Result<()> {
    let module = Module { lua, caller, table: lua.globals() };
    module
        .function("etob", |_, _, status: u16| Ok(status.to_le_bytes()))?
        .function("ntob", |_, _, number: f32| Ok(number.to_le_bytes()))?
        .function("bton", |_, _, bytes: Vec<u8>| match bytes.first_chunk() {
            Some(bytes) => Ok(f32::from_le_bytes(*bytes)),
            None => Err(wrong(format_args!("bton: {} bytes are no number; expected 4", bytes.len()))),
        })?;
    module.table.raw_get::<Table>("math")?.raw_set("nan", f64::NAN)
}

fn time_and_text(lua: &Lua, caller: &Rc<Caller>) -> Result<()> {
    let globals = lua.globals();
    Module::new(lua, caller, "socket")?.function("gettime", |_, _, ()| {
        Ok(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64())
    })?;
    let socket: Table = globals.raw_get("socket")?;
    let to_string: Function = globals.raw_get("tostring")?;
    let format: Function = globals.raw_get::<Table>("string")?.raw_get("format")?;
    let module = Module { lua, caller, table: globals };
    module
        .function("require", move |_, _, name: String| match name.as_str() {
            "socket" => Ok(socket.clone()),
            _ => Err(wrong(format_args!("require: there is no {name:?} here; expected \"socket\""))),
        })?
        .function("sleep", |_, caller, milliseconds: f64| {
            // A time that is over already is none.
            let duration = Duration::try_from_secs_f64(milliseconds.max(0.0) / 1_000.0)
                .map_err(|_| wrong(format_args!("sleep: expected a time in ms")))?;
            caller.wait(|answer| Call::Sleep(duration, answer))
        })?
        .function("print", move |_, caller, values: MultiValue| {
            let texts = values.iter().map(|value| to_string.call::<String>(value));
            caller.log(texts.collect::<Result<Vec<_>>>()?.join("\t"))
        })?
        .function("printf", move |_, caller, values: MultiValue| caller.log(format.call(values)?))?;
    Ok(())
}

/// Names in the log what a script asks for that there is not.
fn name_what_is_missing(lua: &Lua, caller: &Rc<Caller>, table: &Table, prefix: &str) -> Result<()> {
    let metatable = lua.create_table()?;
    let (caller, prefix) = (Rc::clone(caller), prefix.to_owned());
    metatable.raw_set(
        "__index",
        lua.create_function(move |lua, (_, key): (Value, Value)| {
            let key = key.as_string().map(|key| key.to_string_lossy()).unwrap_or_default();
            caller.note(lua, 1, format_args!("{prefix}{key} is not there"))?;
            Ok(Value::Nil)
        })?,
    )?;
    table.set_metatable(Some(metatable))
}

fn wrong(what: std::fmt::Arguments<'_>) -> mlua::Error {
    mlua::Error::runtime(what)
}
