//! Every public function of `wsg-protocol`, with inputs that the compiler knows nothing of.
//!
//! `cargo xtask panics` compares this list with the crate's sources and fails when one is missing. What is written for a
//! person to read (`Display`, `Debug`) is apart, in the program `text`.
#![no_std]
#![no_main]

use core::convert::Infallible;

use cortex_m_rt::entry;
use embedded_io::{ErrorType, Write};
use wsg_probes::{bytes, opaque};
use wsg_protocol::fieldbus::{CommandFlags, Controller, ForceUnit, GripperFlags, InputImage, OutputImage};
use wsg_protocol::session::{self, Session};
use wsg_protocol::{
    AutoUpdate, Command, CommandId, DeviceTag, DeviceType, Event, FingerData, FingerType, FirmwareVersion,
    Frame, FrameEncoder, FrameParser, GripperState, HomingDirection, Instant, LoopData, Payload, Refusal,
    Reply, Status, checksum,
};

/// A writer that takes some of what it is given.
struct Sink;

impl ErrorType for Sink {
    type Error = Infallible;
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        opaque(bytes);
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

fn checksums() {
    opaque(checksum::update(opaque(0), opaque(0)));
    opaque(checksum::push(opaque(0), opaque(0)));
    opaque(checksum::push_slice(opaque(0), bytes()));
    opaque(checksum::of(bytes()));
}

fn parser(parser: &mut FrameParser<64>) {
    *parser = if opaque(false) { FrameParser::ignoring_checksums() } else { FrameParser::new() };
    let parser = opaque(parser);
    opaque(parser.push(opaque(0)));
    opaque(parser.push_slice(bytes()));
    opaque(parser.poll());
    opaque(parser.expire());
    opaque(parser.counters());
    opaque(parser.is_mid_frame());
    parser.reset();
}

fn encoders() {
    let mut store = [0; 64];
    let buffer = opaque(&mut store[..]);
    let encoder = FrameEncoder::new(opaque(0), bytes());
    opaque(encoder.frame_len());
    let _ = opaque(encoder.write_into(buffer));
    let _ = opaque(encoder.write_to(&mut Sink));
    for byte in encoder {
        opaque(byte);
    }
    opaque(encoder.len());
    opaque(Payload::len(&bytes()));
    opaque(Payload::is_empty(&bytes()));
    opaque(Payload::byte(&bytes(), opaque(0)));
}

fn commands() {
    let id = opaque(CommandId::from_code(opaque(0)));
    opaque(id.code());
    opaque(id.name());
    opaque(id.section());
    opaque(id.kind());
    opaque(id.immediate_statuses());
    opaque(id.completion_statuses());
    opaque(id.may_answer(Status::from_code(opaque(0))));
    opaque(id.is_repeatable());
    opaque(id.status_of(opaque(Refusal::TooLong)));
    if let Ok(command) = opaque(Command::decode(&Frame { id: opaque(0), payload: bytes() })) {
        opaque(command.id());
        let _ = opaque(command.check());
        opaque(command.len());
        opaque(command.is_empty());
        opaque(command.byte(opaque(0)));
        for byte in FrameEncoder::new(opaque(0), command) {
            opaque(byte);
        }
    }
}

fn replies() {
    opaque(Reply::status_only(CommandId::from_code(opaque(0)), Status::from_code(opaque(0))));
    if let Ok(reply) = opaque(Reply::decode(&Frame { id: opaque(0), payload: bytes() })) {
        opaque(reply.id());
        opaque(reply.status());
        opaque(reply.len());
        opaque(reply.is_empty());
        opaque(reply.byte(opaque(0)));
        for byte in FrameEncoder::new(opaque(0), reply) {
            opaque(byte);
        }
        if let Some(value) = opaque(reply.value()) {
            opaque(value.id());
            opaque(Reply::success(value));
        }
    }
}

fn values() {
    let status = opaque(Status::from_code(opaque(0)));
    opaque((status.code(), status.symbol(), status.is_final()));
    if let Some(state) = opaque(GripperState::from_code(opaque(0))) {
        opaque((state.code(), state.is_motion(), GripperFlags::from(state)));
    }
    opaque(HomingDirection::from_code(opaque(0)).map(HomingDirection::code));
    opaque(FingerType::from_code(opaque(0)).code());
    let device = opaque(DeviceType::from_code(opaque(0)));
    opaque((device.code(), ForceUnit::of(device).per_newton()));
    opaque((AutoUpdate::once(), AutoUpdate::every(opaque(0)), AutoUpdate::on_change(opaque(0))));
    let version = opaque(FirmwareVersion::new(opaque(0), opaque(0), opaque(0), opaque(0)));
    opaque((version.bits(), FirmwareVersion::from_bits(opaque(0)).parts()));
    let _ = opaque(LoopData::new(bytes()).map(LoopData::bytes));
    let _ = opaque(FingerData::new(bytes()).map(FingerData::bytes));
    let _ = opaque(DeviceTag::new(opaque("WSG")).map(DeviceTag::as_str));
}

fn moments() {
    let (one, other) = (Instant::from_millis(opaque(0)), Instant::from_millis(opaque(0)));
    opaque((one.as_millis(), one.plus(opaque(0)), one.since(other), one.has_reached(other)));
    opaque((one.earlier_of(other), one.until(other)));
}

fn connection(parser: &mut FrameParser<64>, session: &mut Session, controller: &mut Controller) {
    let (parser, session, controller) = (opaque(parser), opaque(session), opaque(controller));
    let now = Instant::from_millis(opaque(0));
    let event: Option<Event<'_>> = opaque(parser.push(opaque(0)));
    if let Some(event) = event
        && let Some(notice) = opaque(session.handle(now, &event))
    {
        controller.handle(&notice, session.known());
    }
    while let Some(notice) = opaque(session.tick(now)) {
        controller.handle(&notice, session.known());
    }
    controller.set_output(&opaque(OutputImage::ZERO), session.known());
    while let Some(command) = opaque(controller.poll_command()) {
        if let Err(error) = opaque(session.request(command)) {
            controller.refused(command.id(), error);
        }
    }
    opaque(controller.input(session.known()));
    opaque(session.poll_transmit(now));
    opaque(session.poll_timeout());
    opaque((session.is_connected(), session.motion(), session.counters(), session.owes_fast_stop()));
    opaque(session.known().is_moving());
}

fn images() {
    let output = opaque(OutputImage::from_bytes(opaque([0; OutputImage::LEN])));
    opaque(output.to_bytes());
    opaque((output.width_mm(), output.speed_mm_s(), output.force_limit_n(opaque(ForceUnit::Tenth))));
    opaque(output.parameters_differ(&opaque(OutputImage::ZERO)));
    opaque(output.flags.contains(opaque(CommandFlags::MOVE)));
    opaque(InputImage::from_bytes(opaque([0; InputImage::LEN])).to_bytes());
}
