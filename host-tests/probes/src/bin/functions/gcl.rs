//! The text protocol, both directions, and its session.

use core::fmt;
use core::hint::black_box;

use wsg_protocol::gcl::session::{Known, Session};
use wsg_protocol::gcl::{
    Answer, Autosend, CommandName, Description, LineReader, Named, OtherName, ParseError, Refused, Request,
    Text, Topic, Value, Vector,
};

use crate::{function, functions};

/// An opaque writer, which may fail.
struct Sink;

impl fmt::Write for Sink {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        black_box(text);
        black_box(Ok(()))
    }
}

pub(crate) fn every_function() {
    function!(Answer::write, fn(&Answer<'static>, &mut Sink) -> _);
    function!(Request::write, fn(&Request, &mut Sink) -> _);
    function!(<Named<'_> as From<CommandName>>::from);
    functions! {
        LineReader<80>: new, default, push, push_slice, finish, reset, counters;
        Request: parse, check, kind, name, write_line_into;
        Answer<'_>: parse, check, failed, name, status, write_line_into;
        Refused<'_>: answer, too_long;
        ParseError: status;
        CommandName: from_text, text, section, kind, forms, value_forms;
        CommandName: is_acknowledged, is_finished, is_repeatable;
        Named<'_>: at_start_of, command, eq;
        OtherName<'_>: text;
        Autosend: by, every, off, on_change;
        Topic: of, name, query, is_measured;
        Value<'_>: check, name;
        Vector<'_>: new, as_str, numbers;
        Text<'_>: new, as_str, device_type, finger_type, firmware_version, stroke;
        Description<'_>: new, of, bytes;
        Session: new, handle, tick, request, poll_transmit, poll_timeout, take_back, withdraw;
        Session: disconnect, subscribe, known, motion, counters, is_connected, is_busy, fast_stop_pending;
        Known: is_moving;
    }
}
