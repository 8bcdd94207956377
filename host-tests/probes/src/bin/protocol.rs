//! Every public function of `wsg-protocol`, with inputs that the compiler knows nothing of.
//!
//! `cargo xtask panics` compares this list with the crate's sources and fails when one is missing. What is written for a
//! person to read (`Display`, `Debug`) is apart, in the program `text`.
#![no_std]
#![no_main]

use core::convert::Infallible;

use cortex_m_rt::entry;
use embedded_io::{ErrorType, Write};
use wsg_probes::{bytes, keep, opaque};
use wsg_protocol::fieldbus::{
    CommandFlags, Controller, Diagnosis, ForceUnit, GripperFlags, InputImage, OutputImage, SilenceReaction,
};
use wsg_protocol::session::{self, Session, Signal};
use wsg_protocol::{
    AutoUpdate, Command, CommandId, DeviceTag, DeviceType, Event, FingerData, FingerType, FirmwareVersion,
    Frame, FrameEncoder, FrameParser, GripperState, HomingDirection, Instant, LoopData, Payload, Refusal,
    Reply, Status, SystemFlags, checksum,
};

/// A writer that takes some of what it is given.
struct Sink;

impl ErrorType for Sink {
    type Error = Infallible;
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        keep(bytes);
        Ok(opaque(bytes.len()))
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

#[entry]
fn main() -> ! {
    static mut PARSER: FrameParser<64> = FrameParser::new();
    static mut SESSION: Session = Session::new(session::Config::DEFAULT);
    static mut CONTROLLER: Controller = Controller::new();
    loop {
        checksums();
        parser(PARSER);
        encoders();
        commands();
        replies();
        values();
        moments();
        connection(PARSER, SESSION, CONTROLLER);
        images();
    }
}

#[inline(never)]
fn checksums() {
    keep(&checksum::update(opaque(0), opaque(0)));
    keep(&checksum::push(opaque(0), opaque(0)));
    keep(&checksum::push_slice(opaque(0), bytes()));
    keep(&checksum::of(bytes()));
}

#[inline(never)]
fn parser(parser: &mut FrameParser<64>) {
    *parser = if opaque(false) { FrameParser::ignoring_checksums() } else { FrameParser::new() };
    let parser = opaque(parser);
    keep(&parser.push(opaque(0)));
    keep(&parser.push_slice(bytes()));
    keep(&parser.poll());
    keep(&parser.expire());
    keep(&parser.counters());
    keep(&parser.is_mid_frame());
    parser.reset();
}

#[inline(never)]
fn encoders() {
    let mut store = [0; 64];
    let buffer = opaque(&mut store[..]);
    let encoder = FrameEncoder::new(opaque(0), bytes());
    keep(&encoder.frame_len());
    keep(&encoder.write_into(buffer));
    keep(&encoder.write_to(&mut Sink));
    for byte in encoder {
        keep(&byte);
    }
    keep(&encoder.len());
    keep(&Payload::len(&bytes()));
    keep(&Payload::is_empty(&bytes()));
    keep(&Payload::byte(&bytes(), opaque(0)));
}

#[inline(never)]
fn commands() {
    let id = opaque(CommandId::from_code(opaque(0)));
    keep(&id.code());
    keep(&id.name());
    keep(&id.section());
    keep(&id.kind());
    keep(&id.immediate_statuses());
    keep(&id.completion_statuses());
    keep(&id.may_answer(Status::from_code(opaque(0))));
    keep(&id.is_repeatable());
    keep(&id.status_of(opaque(Refusal::TooLong)));
    if let Ok(command) = Command::decode(&Frame { id: opaque(0), payload: bytes() }) {
        keep(&command.id());
        keep(&command.check());
        keep(&command.len());
        keep(&command.is_empty());
        keep(&command.byte(opaque(0)));
        for byte in FrameEncoder::new(opaque(0), command) {
            keep(&byte);
        }
    }
}

#[inline(never)]
fn replies() {
    keep(&Reply::status_only(CommandId::from_code(opaque(0)), Status::from_code(opaque(0))));
    if let Ok(reply) = Reply::decode(&Frame { id: opaque(0), payload: bytes() }) {
        keep(&reply.id());
        keep(&reply.status());
        keep(&reply.len());
        keep(&reply.is_empty());
        keep(&reply.byte(opaque(0)));
        for byte in FrameEncoder::new(opaque(0), reply) {
            keep(&byte);
        }
        if let Some(value) = reply.value() {
            keep(&value.id());
            keep(&Reply::success(value));
        }
    }
}

#[inline(never)]
fn values() {
    let status = opaque(Status::from_code(opaque(0)));
    keep(&(status.code(), status.symbol(), status.is_final()));
    if let Some(state) = opaque(GripperState::from_code(opaque(0))) {
        keep(&(state.code(), state.is_motion(), GripperFlags::from(state)));
    }
    keep(&HomingDirection::from_code(opaque(0)).map(HomingDirection::code));
    keep(&FingerType::from_code(opaque(0)).code());
    let device = opaque(DeviceType::from_code(opaque(0)));
    keep(&(device.code(), ForceUnit::of(device).per_newton()));
    keep(&(AutoUpdate::once(), AutoUpdate::every(opaque(0)), AutoUpdate::on_change(opaque(0))));
    let version = opaque(FirmwareVersion::new(opaque(0), opaque(0), opaque(0), opaque(0)));
    keep(&(version.bits(), FirmwareVersion::from_bits(opaque(0)).parts()));
    keep(&LoopData::new(bytes()).map(LoopData::bytes));
    keep(&FingerData::new(bytes()).map(FingerData::bytes));
    keep(&DeviceTag::new(opaque("WSG")).map(DeviceTag::as_str));
}

#[inline(never)]
fn moments() {
    let (one, other) = (Instant::from_millis(opaque(0)), Instant::from_millis(opaque(0)));
    keep(&(one.as_millis(), one.plus(opaque(0)), one.since(other), one.has_reached(other)));
    keep(&(one.earlier_of(other), one.until(other)));
}

#[inline(never)]
fn connection(parser: &mut FrameParser<64>, session: &mut Session, controller: &mut Controller) {
    let (parser, session, controller) = (opaque(parser), opaque(session), opaque(controller));
    let now = Instant::from_millis(opaque(0));
    let event: Option<Event<'_>> = parser.push(opaque(0));
    if let Some(event) = event
        && let Some(notice) = session.handle(now, &event)
    {
        controller.handle(&notice, session.known());
    }
    while let Some(notice) = session.tick(now) {
        controller.handle(&notice, session.known());
    }
    controller.set_output(&opaque(OutputImage::ZERO), session.known());
    while let Some(command) = controller.poll_command() {
        if let Err(error) = session.request(command) {
            controller.refused(command.id(), error);
        }
    }
    controller.silence(opaque(SilenceReaction::Stop), session.known());
    controller.set_user_outputs(opaque(0));
    keep(&controller.user_inputs());
    keep(&controller.is_moving(session.known()));
    keep(&controller.input(session.known()));
    keep(&session.poll_transmit(now));
    keep(&session.poll_timeout());
    if let Ok(data) = LoopData::new(bytes()) {
        let lent = Command::Loop { data };
        keep(&session.request_lent(&lent));
        keep(&session.poll_transmit_lent(now, Some(lent)));
    }
    keep(&session.take_back(opaque(CommandId::Loop)));
    session.subscribe(opaque(Signal::Width), AutoUpdate::once());
    keep(&Signal::of(opaque(CommandId::GetForce)).map(Signal::id));
    session.withdraw();
    session.disconnect();
    keep(&(session.is_connected(), session.motion(), session.counters(), session.owes_fast_stop()));
    keep(&session.is_busy());
    keep(&session.known().is_moving());
}

#[inline(never)]
fn images() {
    let output = opaque(OutputImage::from_bytes(opaque([0; OutputImage::LEN])));
    keep(&output.to_bytes());
    keep(&(output.width_mm(), output.speed_mm_s(), output.force_limit_n(opaque(ForceUnit::Tenth))));
    keep(&output.parameters_differ(&opaque(OutputImage::ZERO)));
    keep(&output.flags.contains(opaque(CommandFlags::MOVE)));
    keep(&output.flags.lowest());
    let system = SystemFlags::from_bits_retain(opaque(0));
    keep(&Diagnosis::is_due(system, SystemFlags::from_bits_retain(opaque(0))));
    keep(&Diagnosis { standard: opaque([0; 4]), system }.to_bytes());
    keep(&InputImage::from_bytes(opaque([0; InputImage::LEN])).to_bytes());
}
