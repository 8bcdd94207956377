//! Every public function of `wsg_protocol::can`: messages over CAN frames both ways, and CAN frames over a serial line.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use embedded_can::{Frame, StandardId};
use wsg_probes::{bytes, keep, opaque};
use wsg_protocol::Instant;
use wsg_protocol::can::slcan::{self, Adapter, Decoder, Line};
use wsg_protocol::can::{
    ClassicFrame, HALF_MESSAGE_MS, Identifiers, MAX_FRAMES, Reassembler, Segmenter, Segments,
};

type Messages = Reassembler<MAX_FRAMES>;

#[entry]
fn main() -> ! {
    static mut SEGMENTER: Segmenter = Segmenter::new();
    static mut MESSAGES: Messages =
        Reassembler::new(Identifiers::DEFAULT.controller().receive, HALF_MESSAGE_MS);
    static mut DECODER: Decoder = Decoder::new();
    static mut ADAPTER: Adapter = Adapter::new();
    loop {
        identifiers();
        sent(opaque(&mut *SEGMENTER));
        received(opaque(&mut *MESSAGES));
        serial(opaque(&mut *DECODER), opaque(&mut *ADAPTER));
    }
}

#[inline(never)]
fn identifiers() {
    if let Some(identifiers) = Identifiers::from_base(opaque(0)) {
        keep(&(identifiers.controller(), identifiers.gripper()));
    }
}

#[inline(never)]
fn sent(segmenter: &mut Segmenter) {
    let id = opaque(Identifiers::DEFAULT.gripper().transmit);
    for segment in Segments::new(bytes().iter().copied()) {
        keep(segment.data());
        keep(&segment.frame::<ClassicFrame>(id));
    }
    keep(&segmenter.push(opaque(0)).is_some());
    keep(&segmenter.is_mid_message());
    segmenter.reset();
}

#[inline(never)]
fn received(messages: &mut Messages) {
    let now = Instant::from_millis(opaque(0));
    if let Some(frame) = ClassicFrame::new(opaque(StandardId::ZERO), bytes()) {
        messages.receive(now, opaque(&frame), |event| keep(&event));
    }
    keep(&(messages.poll_timeout(), messages.counters()));
    messages.handle_timeout(now, |event| keep(&event));
    messages.reset();
}

#[inline(never)]
fn serial(decoder: &mut Decoder, adapter: &mut Adapter) {
    if let Some(line) = decoder.push::<ClassicFrame>(opaque(0)) {
        keep(adapter.answer(&line));
        if let Line::Frame(frame) = line {
            keep(slcan::encode(&frame).as_bytes());
        }
    }
    keep(&adapter.is_open());
}
