//! Every public function of `wsg_protocol::gcl`: the text protocol, both directions.
#![no_std]
#![no_main]

use core::fmt::Write;

use cortex_m_rt::entry;
use wsg_probes::{bytes, keep, opaque};
use wsg_protocol::gcl::session::{Config, Session};
use wsg_protocol::gcl::{
    Answer, Autosend, CommandName, Description, LineReader, Mistake, Named, Refused, Request, Signal, Text,
    Value, Vector,
};
use wsg_protocol::{Instant, Status};

/// Takes text and keeps it.
struct Sink;

impl Write for Sink {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        keep(text);
        if opaque(true) { Ok(()) } else { Err(core::fmt::Error) }
    }
}

#[entry]
fn main() -> ! {
    static mut READER: LineReader<80> = LineReader::new();
    static mut SESSION: Session = Session::new(Config::DEFAULT);
    loop {
        reader(READER);
        requests();
        answers();
        names();
        values();
        signals();
        connection(READER, SESSION);
    }
}

#[inline(never)]
fn reader(reader: &mut LineReader<80>) {
    *reader = LineReader::new();
    let reader = opaque(reader);
    keep(&reader.push(opaque(0)));
    keep(&reader.push_slice(bytes()));
    keep(&reader.finish());
    keep(&reader.counters());
    reader.reset();
}

#[inline(never)]
fn requests() {
    let mut store = [0; 80];
    match Request::parse(bytes()) {
        Ok(request) => {
            keep(&(request.name(), request.kind(), request.check()));
            keep(&request.write(&mut Sink));
            keep(&request.write_line_into(opaque(&mut store[..])));
        }
        Err(refused) => {
            let answer: Answer<'_> = Refused::answer(&refused, opaque(false));
            keep(&answer.write_line_into(opaque(&mut store[..])));
            keep(&refused.mistake.status());
        }
    }
    keep(&Refused::too_long(bytes()).answer(opaque(true)));
    keep(&Mistake::status(opaque(Mistake::Form)));
}

#[inline(never)]
fn answers() {
    let mut store = [0; 80];
    keep(&Answer::failed(opaque(CommandName::Move), opaque(Status::Timeout)));
    if let Ok(answer) = Answer::parse(bytes()) {
        keep(&(answer.name(), answer.status(), answer.check()));
        keep(&answer.write(&mut Sink));
        keep(&answer.write_line_into(opaque(&mut store[..])));
        match answer {
            Answer::Value(value) | Answer::Update(value) => value_of(value),
            _ => {}
        }
    }
}

fn value_of(value: Value<'_>) {
    keep(&(value.name(), value.check()));
}

#[inline(never)]
fn names() {
    if let Some(name) = opaque(CommandName::from_text(opaque("MOVE"))) {
        keep(&(name.text(), name.section(), name.kind(), name.forms(), name.value_forms()));
        keep(&(name.is_acknowledged(), name.is_finished(), name.is_repeatable()));
    }
    let named = opaque(Named::at_start_of(bytes()));
    keep(&named.command());
    if let Named::Other(other) = named {
        keep(other.text());
    }
}

#[inline(never)]
fn values() {
    if let Ok(vector) = opaque(Vector::new(opaque("1"))) {
        keep(vector.as_str());
        for number in vector.numbers() {
            keep(&number);
        }
    }
    if let Ok(text) = opaque(Text::new(opaque("WSG"))) {
        keep(text.as_str());
        keep(&(text.device_type(), text.firmware_version(), text.finger_type()));
    }
    if let Some(description) = opaque(Description::new(bytes())) {
        keep(description.bytes());
    }
    keep(&Description::of(opaque(Status::Timeout)));
}

#[inline(never)]
fn signals() {
    let signal = opaque(Signal::Pos);
    keep(&(signal.name(), signal.query(), signal.is_measured()));
    keep(&Signal::of(opaque(CommandName::Pos)));
    keep(&(Autosend::every(signal, opaque(0)), Autosend::by(signal, opaque(0), opaque(0.0))));
    keep(&(Autosend::on_change(signal, opaque(0)), Autosend::off(signal)));
}

#[inline(never)]
fn connection(reader: &mut LineReader<80>, session: &mut Session) {
    let (reader, session) = (opaque(reader), opaque(session));
    let now = Instant::from_millis(opaque(0));
    if let Some(line) = reader.push(opaque(0)) {
        keep(&session.handle(now, &line));
    }
    while let Some(notice) = session.tick(now) {
        keep(&notice);
    }
    if let Ok(request) = Request::parse(bytes()) {
        keep(&session.request(request));
    }
    session.subscribe(Autosend::off(opaque(Signal::Pos)));
    keep(&session.poll_transmit(now));
    keep(&session.poll_timeout());
    session.disconnect();
    keep(&(session.is_connected(), session.motion(), session.counters(), session.is_busy()));
    keep(&session.owes_fast_stop());
    keep(&session.known().is_moving());
}
