//! The images of the fieldbus manual in words.

use host_tests::plc_names::command_flags;
use wsg_fieldbus::{CommandFlags, InputImage, OutputImage};

/// A step of the PLC in a cycle of homing, grip and release from power-up.
pub(super) struct Step {
    pub(super) name: &'static str,
    pub(super) image: OutputImage,
    pub(super) then: Then,
}

/// The condition for which the PLC waits after a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Then {
    Nothing,
    /// Reads the gripper's state once.
    Look,
    /// The start of the motion.
    Begin,
    /// The end of the motion.
    End,
}

impl Then {
    /// Returns the name of the condition in the document.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Nothing | Self::Look => "",
            Self::Begin => "running",
            Self::End => "done",
        }
    }
}

/// Returns the steps of the cycle. WIDTH, SPEED and FORCELIMIT stay unchanged when a flag is reset.
pub(super) fn steps() -> Vec<Step> {
    let grip = OutputImage { width: 20_00, speed: 50_00, force_limit: 40_00, ..OutputImage::ZERO };
    let release = OutputImage { width: 40_00, ..grip };
    let step = |name, image, flags, then| Step { name, image: OutputImage { flags, ..image }, then };
    let back = |image, then| step("flag cleared", image, CommandFlags::empty(), then);
    let zeros = OutputImage::ZERO;
    vec![
        step("zeros", zeros, CommandFlags::empty(), Then::Look),
        step("STOP/ACK: acknowledge the FAST STOP of power-up", zeros, CommandFlags::STOP_ACK, Then::End),
        back(zeros, Then::Nothing),
        step("HOMING", zeros, CommandFlags::HOMING, Then::Begin),
        back(zeros, Then::End),
        step("GRIP", grip, CommandFlags::GRIP, Then::Begin),
        back(grip, Then::End),
        step("RELEASE", release, CommandFlags::RELEASE, Then::Begin),
        back(release, Then::End),
    ]
}

fn hundredths(value: impl Into<f64>) -> String {
    format!("{:.2}", value.into() / 100.0)
}

fn names<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<&str> = names.collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Returns the parts of the output image, each with its length in bytes and its meaning.
pub(super) fn output_parts(image: &OutputImage) -> Vec<(usize, String)> {
    let mut flags = command_flags();
    flags.retain(|flag| image.flags.bits() & 1 << flag.bit != 0);
    vec![
        (1, format!("CMDFLAGS: {}", names(flags.iter().map(|flag| &flag.name[..])))),
        (1, "IF: user flags, none".to_owned()),
        (2, format!("WIDTH: {} mm", hundredths(image.width))),
        (2, format!("SPEED: {} mm/s", hundredths(image.speed))),
        (2, format!("FORCELIMIT: {} N", hundredths(image.force_limit))),
    ]
}

pub(super) fn state(image: &InputImage) -> String {
    format!("GSTATE: {}", names(image.state.iter_names().map(|(name, _)| name)))
}

pub(super) fn system(image: &InputImage) -> String {
    format!("SYSSTATE: {}", names(image.system.iter_names().map(|(name, _)| name)))
}

pub(super) fn width(image: &InputImage) -> String {
    format!("WIDTH: {} mm", hundredths(image.width))
}

pub(super) fn force(image: &InputImage) -> String {
    format!("Gripping Force: {} N", hundredths(image.force))
}

pub(super) fn status(image: &InputImage) -> String {
    format!("Status Code: {}, {}", image.status.code(), image.status.symbol())
}

pub(super) fn code(image: &InputImage) -> String {
    image.status.code().to_string()
}

/// Returns a part without its name.
pub(super) fn value(part: &str) -> &str {
    part.split_once(": ").map_or(part, |(_, value)| value)
}

/// Joins a step and a meaning. Either may be empty.
pub(super) fn joined(step: &str, meaning: &str) -> String {
    let parts = [step, meaning].into_iter().filter(|part| !part.is_empty());
    parts.collect::<Vec<_>>().join(": ")
}

/// Returns the parts of the input image in the byte order of a Modbus master.
pub(super) fn input_parts(image: &InputImage) -> Vec<(usize, String)> {
    vec![
        (1, state(image)),
        (1, "OF: user flags, none".to_owned()),
        (4, system(image)),
        (2, width(image)),
        (2, force(image)),
        (2, status(image)),
    ]
}

pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" ")
}

/// Splits a message into its parts, as table rows with positions, values and meaning.
pub(super) fn explain(message: &[u8], parts: &[(usize, String)]) -> Vec<[String; 3]> {
    let mut at = 0;
    let rows = parts.iter().map(|(len, meaning)| {
        let bytes = if *len == 1 { at.to_string() } else { format!("{at} to {}", at + len - 1) };
        at += len;
        [bytes, hex(&message[at - len..at]), meaning.clone()]
    });
    let rows = rows.collect();
    assert_eq!(at, message.len());
    rows
}
