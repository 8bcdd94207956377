//! A CANopen device with an opaque dictionary.

use core::hint::black_box;

use bus_canopen::{Abort, Config, DataType, Device, Dictionary, EdsEntry, Entry, entries, find, is_reserved};
use bus_slcan::ClassicFrame;

use crate::{function, functions};

struct Objects;

impl Dictionary for Objects {
    type Key = u16;

    fn find(&self, index: u16, sub: u8) -> Result<Entry<u16>, Abort> {
        find(black_box(&[]), index, sub)
    }

    fn read(&self, key: u16) -> Result<u32, Abort> {
        black_box(Ok(key.into()))
    }

    fn write(&mut self, _: u16, _: u32) -> Result<(), Abort> {
        black_box(Ok(()))
    }

    fn begin_domain(&mut self, _: u16, _: Option<u32>) -> Result<(), Abort> {
        black_box(Ok(()))
    }

    fn write_domain(&mut self, _: u16, bytes: &[u8], is_last: bool) -> Result<(), Abort> {
        black_box((bytes, is_last));
        black_box(Ok(()))
    }

    fn outcome(&self, _: u16) -> Option<Result<(), Abort>> {
        black_box(None)
    }

    fn consumer_time_ms(&self) -> u16 {
        black_box(0)
    }

    fn set_consumer_time_ms(&mut self, _: u16) -> Result<(), Abort> {
        black_box(Ok(()))
    }
}

pub(crate) fn every_function() {
    type Node = Device<2, 2, 8>;
    function!(Node::on_frame::<ClassicFrame>);
    function!(Node::poll_event::<Objects>);
    function!(Node::poll_transmit::<ClassicFrame>);
    function!(entries::<u16, 8>);
    function!(find::<u16>);
    function!(is_reserved);
    functions! {
        Node: new, state, show_tpdo, show_faults, sends, frames_lost, bus_lost, bus_joined;
        Config<2>: is_valid;
        DataType: len, code;
        EdsEntry<'static, u16>: new;
    }
}
