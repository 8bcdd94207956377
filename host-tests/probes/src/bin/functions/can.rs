//! Messages over CAN frames, and CAN frames over a serial line.

use bus_slcan::{Adapter, ClassicFrame, Decoder, Encoded, encode};
use embedded_can::{Frame as _, StandardId};
use wsg_protocol::can::{Identifiers, MAX_FRAMES, Reassembler, Segment, Segmenter, Segments};
use wsg_protocol::{Command, Event, FrameEncoder, Instant};

use crate::{function, functions};

pub(crate) fn every_function() {
    type Messages = Reassembler<MAX_FRAMES>;
    type Deliver = for<'a> fn(Event<'a>);
    function!(encode::<ClassicFrame>);
    function!(Adapter::answer::<ClassicFrame>);
    function!(Decoder::push::<ClassicFrame>);
    function!(Segment::frame::<ClassicFrame>);
    function!(ClassicFrame::new, fn(StandardId, &[u8]) -> _);
    function!(ClassicFrame::new_remote, fn(StandardId, usize) -> _);
    function!(Messages::receive, fn(&mut Messages, Instant, &ClassicFrame, Deliver));
    function!(Messages::handle_timeout, fn(&mut Messages, Instant, Deliver));
    functions! {
        Messages: new, poll_timeout, counters, reset;
        Identifiers: from_base, base, controller, gripper;
        Segment: data, spoil;
        Segmenter: new, default, push, reset, is_mid_message;
        Segments<FrameEncoder<Command<'_>>>: new, next;
        Adapter: new, is_open;
        Decoder: new, default;
        Encoded: as_bytes;
        ClassicFrame: is_extended, is_remote_frame, id, dlc, data;
    }
}
