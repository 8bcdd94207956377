//! What can happen around a bridge, as one type: of time, wires, PLC, line and gripper.
//!
//! The fuzz bodies decode operations from bytes, the exploration enumerates them, the sweep of line faults plays its courses with
//! them, and a test writes them down. A failure is printed as a [`script`] that a test can contain ([`fuzz_bodies::play`],
//! [`explore::replay`]).
//!
//! [`fuzz_bodies::play`]: crate::fuzz_bodies::play
//! [`explore::replay`]: crate::explore::replay

use wsg_bridge_fw::io::Inputs;
use wsg_fieldbus::{CommandFlags, OutputImage};
use wsg_protocol::SystemFlags;

pub use crate::gripper_states::GripperEvent;

/// One event. Each rig executes the events of its lines, and panics at others.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "the fields are described with their variants")]
pub enum Operation {
    /// Time passes, in milliseconds.
    Pass(u32),
    /// Time passes until the session's next deadline.
    Wait,
    /// The wires from the PLC have these levels.
    Wires(Inputs),
    /// Wires change.
    Toggle(Inputs),
    /// Low wires rise and high ones fall in the same reading.
    Change { rising: Inputs, falling: Inputs },
    /// The PLC writes an image over its bus.
    Write(OutputImage),
    /// The PLC stops sending over the bus until the bridge detects it.
    FallSilent,
    /// Characters, `None` for a damaged one, each after a silence: in microseconds on Modbus, in bits on PROFIBUS.
    Characters(Port, Vec<(Option<u8>, u32)>),
    /// A Modbus request.
    Modbus { port: Port, unit: Unit, pdu: Vec<u8>, fault: TelegramFault },
    /// An event on the CAN bus.
    Can(CanEvent),
    /// A PROFIBUS telegram after a silence in bits.
    Profibus { telegram: Telegram, silence: u32, fault: TelegramFault },
    /// A PROFIBUS master starts the slave, with a watchdog in units of 10 ms.
    StartSlave { master: u8, watchdog: u8, min_tsdr: u8 },
    /// An event of a gateway.
    Gateway(GatewayEvent),
    /// An event in the gripper.
    Gripper(GripperEvent),
    /// The gripper behaves differently from now on.
    Behave(Behaviour),
    /// Bytes that are not from the gripper reach the bridge.
    Forge(Vec<u8>),
    /// The line delivers all messages, including replies to further commands, until both sides are silent.
    AnswersAll,
    /// The line delivers the next message.
    Answer,
    /// The line delivers the next message and keeps it for a second delivery.
    AnswerTwice,
    /// The line loses the next message.
    AnswerLost,
    /// The line loses the last byte of the next message.
    AnswerCut,
    /// The line delivers the next message in the same turn as the next event.
    AnswerWithNext,
    /// The line is cut or restored. Messages in transit are lost.
    ToggleLine,
    /// The bridge is reset.
    RestartBridge,
}

/// A line for Modbus, or the line of the PLC's bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Port {
    /// The PLC's bus.
    Bus,
    /// The service port.
    Service,
}

/// Addressee of a Modbus request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// The bridge, also after a change of its address.
    Own,
    /// All units.
    Broadcast,
    /// A unit that does not exist.
    Other,
}

/// A fault of a telegram on its way. Positions are taken modulo its length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the fields are described with their variants")]
pub enum TelegramFault {
    /// No fault.
    Intact,
    /// A wrong bit.
    Flip { at: usize, bit: u8 },
    /// The end is missing.
    Truncate { at: usize },
    /// A silence before a character.
    Pause { at: usize, silence: u32 },
    /// A damaged character.
    Damage { at: usize },
}

impl TelegramFault {
    /// Decodes a fault; most bytes mean none.
    pub(crate) fn of(how: u8, at: u8, silence: impl FnOnce() -> u32) -> Self {
        let at = at.into();
        match how % 16 {
            0 => Self::Flip { at, bit: how >> 5 },
            1 => Self::Truncate { at },
            2 => Self::Pause { at, silence: silence() },
            3 => Self::Damage { at },
            _ => Self::Intact,
        }
    }

    /// Returns the telegram as it arrives: each character, `None` for a damaged one, with the silence before it. `silence` is the
    /// one before the telegram.
    pub(crate) fn characters(self, telegram: &[u8], silence: u32) -> Vec<(Option<u8>, u32)> {
        let mut characters: Vec<_> = telegram.iter().map(|byte| (Some(*byte), 0)).collect();
        let Some(first) = characters.first_mut() else { return characters };
        first.1 = silence;
        let length = characters.len();
        match self {
            Self::Intact => {}
            Self::Flip { at, bit } => {
                let (byte, _) = &mut characters[at % length];
                *byte = byte.map(|byte| byte ^ 1 << bit);
            }
            Self::Truncate { at } => characters.truncate(at % length),
            Self::Pause { at, silence } => characters[at % length].1 = silence,
            Self::Damage { at } => characters[at % length].0 = None,
        }
        characters
    }
}

/// An event on the CAN bus.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "the fields are described with their variants")]
pub enum CanEvent {
    /// A data frame with an identifier of 11 bits.
    Data(u16, Vec<u8>),
    /// A data frame with an identifier of 29 bits, which has the same arbitration; without bit 11 the same number.
    Extended(u16, Vec<u8>),
    /// A remote frame that asks for this number of bytes.
    Remote(u16, usize),
    /// A heartbeat of the PLC, or of another node.
    Heartbeat { of_plc: bool, state: u8 },
    /// A forged message of the gripper, whose frames or bytes are spoilt in this way.
    Message { bytes: Vec<u8>, spoilt: u8 },
    /// The controller goes bus-off, and recovers after this many turns.
    BusOff(u32),
    /// The next frame is lost.
    Overrun,
    /// No node acknowledges the bridge's frames.
    Unacknowledged(bool),
    /// The controller rejects frames.
    Rejects(bool),
    /// The controller is error passive, with this count of transmit errors.
    Passive(u8),
    /// The bridge tries to recover at once.
    Retry,
    /// All faults end.
    Recovers,
}

/// A telegram of a PROFIBUS master, which adds addresses and its frame count bit.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the fields are described with their variants")]
pub enum Telegram {
    /// Data_Exchange.
    Exchange { master: u8, outputs: Vec<u8> },
    /// A request to a service access point.
    ServiceRequest { master: u8, point: u8, data: Vec<u8> },
    /// The last telegram again.
    Repetition,
    /// These bytes.
    Raw(Vec<u8>),
}

/// An event of a gateway.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "the fields are described with their variants")]
pub enum GatewayEvent {
    /// A Modbus/TCP master sends a request.
    Request { master: usize, pdu: Vec<u8>, fault: TelegramFault },
    /// A Modbus/TCP master connects again.
    Reconnect(usize),
    /// A cyclic master provides an image.
    Image(usize, OutputImage),
    /// A cyclic master no longer provides images.
    Leave(usize),
    /// The computer pauses, this much longer than the shortest pause, in milliseconds.
    ComputerPauses(u32),
    /// The next turn is this late, in milliseconds.
    LateTurn(u32),
    /// The connection to the gripper ends for this time, and the gripper may enter FAST STOP.
    LoseGripper { for_ms: u32, stops_fast: bool },
}

/// Behaviour of the gripper.
#[derive(Clone, Debug, PartialEq)]
pub struct Behaviour {
    /// Whether it answers.
    pub answers: bool,
    /// Delivery of successive commands and answers; the last one applies to the rest. Empty means at once.
    pub deliveries: Vec<Delivery>,
    /// Its flags; none after a restart.
    pub flags: SystemFlags,
    /// Whether it finds a part.
    pub has_part: bool,
    /// Whether it loses the part, or a third party acts: acknowledges FAST STOP, stops a motion or starts one.
    pub is_disturbed: bool,
}

/// Delivery of a command and its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// Executed, and answered after this many milliseconds.
    Late(u32),
    /// Answered at once, and again after this many milliseconds.
    Twice(u32),
    /// Executed without an answer.
    Unanswered,
    /// Refused.
    Refused,
    /// Lost, together with all following bytes until this many have been received or the frame times out.
    Unheard(u32),
}

/// Returns operations as Rust. All of their names are in [`names`].
#[must_use]
pub fn script<'a>(operations: impl IntoIterator<Item = &'a Operation>) -> String {
    operations.into_iter().map(|operation| format!("    {},\n", rust(operation))).collect()
}

/// Turns the output of `Debug` into Rust: lists, and names of flags.
fn rust(operation: &Operation) -> String {
    let mut text = format!("{operation:?}").replace('[', "vec![");
    for flags in ["Inputs", "CommandFlags", "SystemFlags"] {
        let constant = |name: &str| match name.strip_prefix("0x") {
            Some("0") => format!("{flags}::empty()"),
            Some(_) => format!("{flags}::from_bits_retain({name})"),
            None => format!("{flags}::{name}"),
        };
        let debug = format!("{flags}(");
        let mut parts = text.split(debug.as_str());
        let mut constants = parts.next().unwrap_or_default().to_owned();
        for part in parts {
            let (names, rest) = part.split_once(')').unwrap_or((part, ""));
            constants += &names.split(" | ").map(constant).collect::<Vec<_>>().join(" | ");
            constants += rest;
        }
        text = constants;
    }
    text
}

/// All names of a [`script`].
pub mod names {
    pub use wsg_bridge_fw::io::Inputs;
    pub use wsg_fieldbus::{CommandFlags, OutputImage};
    pub use wsg_protocol::{CommandId::*, SystemFlags};

    pub use super::CanEvent::*;
    pub use super::Delivery::*;
    pub use super::GatewayEvent::*;
    pub use super::GripperEvent::*;
    pub use super::Operation::{self, *};
    pub use super::Port::*;
    pub use super::Telegram::*;
    pub use super::TelegramFault::*;
    pub use super::Unit::*;
    pub use super::{Behaviour, script};
}

/// Returns an image with these flags, and with these values of WIDTH, SPEED and FORCELIMIT.
#[must_use]
pub const fn image(flags: CommandFlags, [width, speed, force_limit]: [u16; 3]) -> OutputImage {
    OutputImage { flags, user: 0, width: width.cast_signed(), speed, force_limit: force_limit.cast_signed() }
}
