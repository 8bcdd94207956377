//! The binary protocol, its session, and the fieldbus images with their controller.

use wsg_fieldbus::{
    Cause, CommandFlags, Controller, Diagnosis, ForceUnit, GripperFlags, InputImage, MaskedFlags, OutputImage,
};
use wsg_protocol::limits::{OutOfLimits, Quantity};
use wsg_protocol::queue::Queue;
use wsg_protocol::session::{Known, Session, Topic};
use wsg_protocol::{
    AutoUpdate, Command, CommandId, DeviceTag, DeviceType, FingerData, FingerType, FirmwareVersion,
    FrameEncoder, FrameParser, GripperState, HomingDirection, Instant, LoopData, Payload, Reply, Status,
    SystemLimits, Value, checksum,
};

use core::ops::{Deref, DerefMut};

use crate::transport::Line;
use crate::{function, functions};

pub(crate) fn every_function() {
    frames();
    messages();
    values();
    session();
    fieldbus();
}

fn frames() {
    function!(checksum::of);
    function!(checksum::push);
    function!(checksum::push_slice);
    function!(checksum::update);
    function!(FrameEncoder::<&[u8]>::write_to::<Line>);
    functions! {
        FrameParser<64>: new, ignoring_checksums, push, push_slice, poll, expire, reset, counters, is_mid_frame;
        FrameParser<64>: default;
        FrameEncoder<&[u8]>: new, id, frame_len, write_into, next, size_hint, len;
        FrameEncoder<Command<'_>>: new, next;
        FrameEncoder<Reply<'_>>: new, next;
        &[u8]: byte, is_empty;
    }
}

fn messages() {
    functions! {
        Command<'_>: decode, check, check_limits, id, is_repeatable, len, is_empty, byte;
        CommandId: code, from_code, name, section, kind, is_repeatable, outlives_connection, status_of;
        CommandId: immediate_statuses, completion_statuses, may_answer;
        Reply<'_>: decode, id, status, status_only, success, value, len, is_empty, byte;
        Value<'_>: id;
        SystemLimits: range, check;
        OutOfLimits: quantity, value, least, greatest, eq;
        Quantity: unit;
    }
}

fn values() {
    functions! {
        Status: code, from_code, symbol, meaning, is_final;
        AutoUpdate: once, every, on_change;
        GripperState: code, from_code, is_motion;
        HomingDirection: code, from_code;
        DeviceType: code, from_code;
        FingerType: code, from_code;
        FirmwareVersion: new, bits, from_bits, parts;
        DeviceTag<'_>: new, as_str;
        FingerData<'_>: new, bytes;
        LoopData<'_>: new, bytes;
        Instant: from_millis, as_millis, plus, plus_at_most, since, signed_since, until, earlier_of, has_reached, age;
    }
}

fn session() {
    functions! {
        Session: new, handle, tick, request, request_borrowed, poll_transmit, poll_transmit_borrowed, poll_timeout;
        Session: take_back, has_overtaken, withdraw, disconnect, subscribe, known, motion, counters;
        Session: is_connected, is_busy, motion_is_open, fast_stop_pending;
        Known: is_moving;
        Topic: id, of;
    }
}

fn fieldbus() {
    functions! {
        Controller: new, default, handle, set_output, poll_command, refused, silence, input, is_moving;
        Controller: set_user_outputs, user_inputs, adopt_known, set_output_refusing_motions, has_refused_meanwhile, refuse, poll_incident, asks_fast_stop, ignores_motions;
        Diagnosis: is_due, to_bytes, device_part;
        CommandFlags: lowest;
        Cause: is_fast_stop, is_refusal;
        MaskedFlags: see, mask, counting;
        Queue<u8, 2>: new, deref, deref_mut;
        ForceUnit: of, per_newton;
        InputImage: from_bytes, to_bytes;
        OutputImage: from_bytes, to_bytes, width_mm, speed_mm_s, force_limit_n, parameters_differ;
    }
    function!(<GripperFlags as From<GripperState>>::from);
}
