//! The MODBUS server, on a serial line, on TCP and without a line, and the register images as its tables.

use bus_modbus::{Bits, Exception, FileRecords, Function, MAX_PDU_LEN, Words, rtu, serve, tcp};
use wsg_fieldbus::{Content, Images};
use wsg_probes::gripper::Gripper;

use crate::{function, functions};

pub(crate) fn every_function() {
    type Serve = fn(&[u8], &mut [u8; MAX_PDU_LEN]) -> usize;
    type Frame = [u8; tcp::MAX_FRAME_LEN];
    function!(serve::<Gripper>);
    function!(rtu::crc);
    function!(rtu::Server::push::<Gripper>);
    function!(rtu::Server::silence::<Gripper>);
    function!(tcp::Request::answer, for<'a> fn(&tcp::Request<'static>, &'a mut Frame, Serve) -> &'a [u8]);
    functions! {
        Bits<'_>: new, iter, len, is_empty;
        Words<'_>: new, iter, len, is_empty, as_bytes;
        FileRecords<'_>: iter;
        Exception: code;
        Function: code, from_code, may_be_broadcast;
        Content: is_number;
        Images: new, coil, discrete_input, holding_register, input_register, write_coils, write_registers;
        Images: output, set_input, set_output, set_swap_bytes, take_written;
        rtu::Receiver: new, configure, push, silence, reset, is_idle;
        rtu::Server: new, configure, counters, is_idle, is_listen_only;
        rtu::Timing: of;
        tcp::Receiver: new, default, push, push_slice, is_lost;
    }
}
