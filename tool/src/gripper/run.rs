//! Executes commands over either protocol.

use std::io;
use std::time::{Duration, Instant};

use wsg_protocol::driver::blocking::GripperOver;
use wsg_protocol::driver::host::StdClock;
use wsg_protocol::driver::{
    Binary, Error, Finger, Gcl, Grip, Mm, MmPerS, MotionResult, N, Pending, Protocol,
};
use wsg_protocol::session::{Known, Topic};
use wsg_protocol::{
    AutoUpdate, DeviceTag, FingerType, GrippingStatistics, SoftLimits, Status, SystemInfo, SystemLimits,
};

use super::action::{Action, Bytes, Switch, on_block};
use super::answer::{Answer, CELSIUS, Datum, MM, MM_PER_S, MM_PER_S2, NEWTON, Outcome};
use super::line::{Connection, LOOK_MS};
use super::trouble::Trouble;

/// A gripper on any line, with either protocol.
pub(crate) type Gripper<P> = GripperOver<Connection, StdClock, P>;

/// Maximum length in bytes of an answer to `raw` or `finger-data`.
const MAX_ANSWER: usize = 1_024;

/// Shows the known state while a motion is in progress.
pub(crate) type Live<'a> = &'a mut dyn FnMut(&Known) -> io::Result<()>;

/// Commands that only one of the protocols supports.
pub(crate) trait ProtocolCommands: Protocol + Sized {
    /// Sets the part width tolerance in mm if one is given, and returns the value in effect.
    fn part_width_tolerance(gripper: &mut Gripper<Self>, set: Option<f32>) -> Result<f32, Trouble>;

    /// Sets the clamping travel in mm if one is given, and returns the value in effect.
    fn clamping_travel(gripper: &mut Gripper<Self>, set: Option<f32>) -> Result<f32, Trouble>;
}

fn only_in_gcl<T>() -> Result<T, Trouble> {
    Err(Trouble::Usage("not supported by the binary protocol; use GCL (gcl://HOST)".to_owned()))
}

impl ProtocolCommands for Binary {
    fn part_width_tolerance(_: &mut Gripper<Self>, _: Option<f32>) -> Result<f32, Trouble> {
        only_in_gcl()
    }

    fn clamping_travel(_: &mut Gripper<Self>, _: Option<f32>) -> Result<f32, Trouble> {
        only_in_gcl()
    }
}

impl ProtocolCommands for Gcl {
    fn part_width_tolerance(gripper: &mut Gripper<Self>, set: Option<f32>) -> Result<f32, Trouble> {
        Ok(match set {
            Some(tolerance) => gripper.set_part_width_tolerance(Mm(tolerance))?.0,
            None => gripper.part_width_tolerance()?.0,
        })
    }

    fn clamping_travel(gripper: &mut Gripper<Self>, set: Option<f32>) -> Result<f32, Trouble> {
        Ok(match set {
            Some(travel) => gripper.set_clamping_travel(Mm(travel))?.0,
            None => gripper.clamping_travel()?.0,
        })
    }
}

/// Executes a command. Motions are awaited to their end.
pub(crate) fn carry_out<P: ProtocolCommands>(
    gripper: &mut Gripper<P>,
    action: &Action,
    live: Live<'_>,
) -> Result<Answer, Trouble> {
    let done = Answer::done();
    Ok(match *action {
        Action::Home { end } => completed(finish(gripper, |it| it.begin_home(end.into()), live))?,
        Action::Move { width, speed, clamp } => {
            let begin = |it: &mut Gripper<P>| it.begin_move_to(Mm(width), MmPerS(speed), on_block(clamp));
            completed(finish(gripper, begin, live))?
        }
        Action::MoveBy { offset, speed, clamp } => {
            let begin = |it: &mut Gripper<P>| it.begin_move_by(Mm(offset), MmPerS(speed), on_block(clamp));
            completed(finish(gripper, begin, live))?
        }
        Action::Grip { width, speed, force } => grip(gripper, width, speed, force, live)?,
        Action::Release { width, speed } => {
            completed(finish(gripper, |it| it.begin_release(Mm(width), MmPerS(speed)), live))?
        }
        Action::Stop => completed(gripper.stop())?,
        Action::FastStop => completed(gripper.fast_stop())?,
        Action::Ack => completed(gripper.acknowledge())?,

        Action::ForceLimit { force } => {
            if let Some(force) = force {
                gripper.set_force_limit(N(force))?;
            }
            done.number("force limit", gripper.force_limit()?.0, NEWTON)
        }
        Action::Acceleration { acceleration } => {
            if let Some(acceleration) = acceleration {
                gripper.set_acceleration(acceleration)?;
            }
            done.number("acceleration", gripper.acceleration()?, MM_PER_S2)
        }
        Action::SoftLimits { from, to, clear } => soft_limits(gripper, from.zip(to), clear)?,
        Action::Overdrive { switch } => completed(gripper.set_overdrive(switch == Switch::On))?,
        Action::Tare => completed(gripper.tare())?,
        Action::PartWidthTolerance { tolerance } => {
            done.number("part width tolerance", P::part_width_tolerance(gripper, tolerance)?, MM)
        }
        Action::ClampingTravel { travel } => {
            done.number("clamping travel", P::clamping_travel(gripper, travel)?, MM)
        }

        Action::Status => status(gripper)?,
        Action::State => done.text("state", gripper.gripper_state()?),
        Action::Flags => done.with("flags", names(gripper.system_state()?.iter_names())),
        Action::Width => done.number("width", gripper.width()?.0, MM),
        Action::Speed => done.number("speed", gripper.speed()?.0, MM_PER_S),
        Action::Force => done.number("force", gripper.force()?.0, NEWTON),
        Action::Temperature => {
            done.number("temperature", f32::from(gripper.temperature()?.0) / 10.0, CELSIUS)
        }
        Action::Statistics { reset } => statistics(gripper.statistics(reset)?),

        Action::Info => info(gripper.system_info()?),
        Action::Limits => limits(gripper.limits()?),
        Action::Tag { ref text } => tag(gripper, text.as_deref())?,

        Action::FingerInfo { finger } => {
            let info = gripper.finger_info(finger)?;
            done.text("finger", info.finger).with("bytes of data", Datum::Count(info.data_len.into()))
        }
        Action::FingerFlags { finger } => {
            done.with("flags", names(gripper.finger_flags(finger)?.iter_names()))
        }
        Action::FingerPower { finger, switch } => {
            completed(gripper.set_finger_power(finger, switch == Switch::On))?
        }
        Action::FingerData { finger } => finger_data(gripper, finger)?,

        Action::Loop { ref bytes } => completed(gripper.loop_back(&Bytes::joined(bytes)))?,
        Action::Raw { id, ref payload } => raw(gripper, id, &Bytes::joined(payload))?,
        Action::Disconnect => completed(match gripper.announce_disconnect() {
            // Not available on lines that need no announcement.
            Err(Error::Refused(Status::NotAvailable)) => Ok(()),
            result => result,
        })?,
        Action::Pause { seconds } => completed(pause(gripper, Duration::from_secs_f32(seconds), live))?,
    })
}

/// Returns whether a command may move the fingers, which must then be stopped if it is interrupted.
pub(crate) const fn is_motion(action: &Action) -> bool {
    matches!(
        action,
        Action::Home { .. }
            | Action::Move { .. }
            | Action::MoveBy { .. }
            | Action::Grip { .. }
            | Action::Release { .. }
            | Action::Raw { .. }
    )
}

/// Subscribes to width, speed and force, in addition to the state.
pub(crate) fn subscribe<P: Protocol>(gripper: &mut Gripper<P>, period_ms: u16) {
    for topic in [Topic::Width, Topic::Speed, Topic::Force] {
        gripper.subscribe(topic, AutoUpdate::on_change(period_ms));
    }
}

/// Cancels these subscriptions, because they outlive this program on lines without a connection, such as RS-232 or CAN. Ignores
/// a gripper that no longer answers.
pub(crate) fn unsubscribe<P: Protocol>(gripper: &mut Gripper<P>) {
    for topic in [Topic::Width, Topic::Speed, Topic::Force] {
        gripper.subscribe(topic, AutoUpdate::once());
    }
    // This request also sends the changed subscriptions.
    let _ = gripper.gripper_state();
}

fn completed(result: Result<(), impl Into<Trouble>>) -> Result<Answer, Trouble> {
    result.map(|()| Answer::done()).map_err(Into::into)
}

/// Begins a motion and waits for its end.
fn finish<P: Protocol, T: MotionResult>(
    gripper: &mut Gripper<P>,
    begin: impl FnOnce(&mut Gripper<P>) -> Result<Pending<T>, Error<io::Error>>,
    live: Live<'_>,
) -> Result<T, Trouble> {
    let motion = begin(gripper)?;
    loop {
        if let Some(result) = gripper.poll(&motion)? {
            return Ok(result);
        }
        gripper.next_update(LOOK_MS)?;
        live(gripper.known())?;
    }
}

fn pause<P: Protocol>(gripper: &mut Gripper<P>, time: Duration, live: Live<'_>) -> Result<(), Trouble> {
    let end = Instant::now() + time;
    while Instant::now() < end {
        gripper.next_update(LOOK_MS)?;
        live(gripper.known())?;
    }
    Ok(())
}

fn grip<P: Protocol>(
    gripper: &mut Gripper<P>,
    width: f32,
    speed: f32,
    force: Option<f32>,
    live: Live<'_>,
) -> Result<Answer, Trouble> {
    let (width, speed) = (Mm(width), MmPerS(speed));
    let begin = |it: &mut Gripper<P>| match force {
        Some(force) => it.begin_grip_with_force(width, speed, N(force)),
        None => it.begin_grip(width, speed),
    };
    Ok(match finish(gripper, begin, live)? {
        Grip::Held => {
            let held = Answer::of(Outcome::Held);
            held.number("width", gripper.width()?.0, MM).number("force", gripper.force()?.0, NEWTON)
        }
        Grip::NoPart => Answer::of(Outcome::NoPart),
    })
}

fn status<P: Protocol>(gripper: &mut Gripper<P>) -> Result<Answer, Trouble> {
    Ok(Answer::done()
        .text("state", gripper.gripper_state()?)
        .number("width", gripper.width()?.0, MM)
        .number("speed", gripper.speed()?.0, MM_PER_S)
        .number("force", gripper.force()?.0, NEWTON)
        .with("flags", names(gripper.system_state()?.iter_names())))
}

/// Clears the soft limits, or sets them if a range is given, and returns the range in effect.
fn soft_limits<P: Protocol>(
    gripper: &mut Gripper<P>,
    range: Option<(f32, f32)>,
    clear: bool,
) -> Result<Answer, Trouble> {
    if clear {
        gripper.clear_soft_limits()?;
    } else if let Some((minus, plus)) = range {
        gripper.set_soft_limits(SoftLimits { minus, plus })?;
    }
    Ok(match gripper.soft_limits()? {
        Some(SoftLimits { minus, plus }) => Answer::done().number("from", minus, MM).number("to", plus, MM),
        None => Answer::done().with("soft limits", Datum::Nothing),
    })
}

/// Sets the device tag if a text is given, and returns the tag in effect.
fn tag<P: Protocol>(gripper: &mut Gripper<P>, text: Option<&str>) -> Result<Answer, Trouble> {
    if let Some(text) = text {
        gripper.set_tag(text)?;
    }
    let mut buffer = [0; DeviceTag::MAX_LEN];
    Ok(match gripper.tag(&mut buffer) {
        Err(Error::Refused(Status::NotAvailable)) => Answer::done().with("tag", Datum::Nothing),
        tag => Answer::done().text("tag", tag?),
    })
}

fn statistics(counts: GrippingStatistics) -> Answer {
    Answer::done()
        .with("grips", Datum::Count(counts.total))
        .with("without part", Datum::Count(counts.no_part.into()))
        .with("parts lost", Datum::Count(counts.part_lost.into()))
}

fn info(info: SystemInfo) -> Answer {
    Answer::done()
        .text("device", info.device)
        .with("hardware revision", Datum::Count(info.hardware_revision.into()))
        .text("firmware", info.firmware)
        .with("serial number", Datum::Count(info.serial_number))
}

fn limits(limits: SystemLimits) -> Answer {
    Answer::done()
        .number("stroke", limits.stroke, MM)
        .number("least speed", limits.min_speed, MM_PER_S)
        .number("greatest speed", limits.max_speed, MM_PER_S)
        .number("least acceleration", limits.min_acceleration, MM_PER_S2)
        .number("greatest acceleration", limits.max_acceleration, MM_PER_S2)
        .number("least force", limits.min_force, NEWTON)
        .number("nominal force", limits.nominal_force, NEWTON)
        .number("overdrive force", limits.overdrive_force, NEWTON)
}

fn finger_data<P: Protocol>(gripper: &mut Gripper<P>, finger: Finger) -> Result<Answer, Trouble> {
    let kind = gripper.finger_info(finger)?.finger;
    let mut buffer = [0; MAX_ANSWER];
    let data = gripper.finger_data(finger, &mut buffer)?;
    Ok(match (kind, data.first_chunk()) {
        (FingerType::Fmf, Some(bytes)) => Answer::done().number("force", f32::from_le_bytes(*bytes), NEWTON),
        _ => Answer::done().with("data", hex(data)),
    })
}

fn raw<P: Protocol>(gripper: &mut Gripper<P>, id: u8, payload: &[u8]) -> Result<Answer, Trouble> {
    let mut buffer = [0; MAX_ANSWER];
    Ok(Answer::done().with("answer", hex(gripper.raw(id, payload, &mut buffer)?)))
}

fn hex(bytes: &[u8]) -> Datum {
    Datum::Names(bytes.iter().map(|byte| format!("{byte:02X}")).collect())
}

fn names<T>(flags: impl Iterator<Item = (&'static str, T)>) -> Datum {
    Datum::Names(flags.map(|(name, _)| name.to_owned()).collect())
}
