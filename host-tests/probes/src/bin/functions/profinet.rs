//! An IO device with outputs and inputs, and its parts.

use bus_profinet::{Device, IpParameters, Profile, StationName};
use wsg_fieldbus::profinet;

use crate::{function, functions};

pub(crate) fn every_function() {
    type Gripper = Device<8, 12>;
    functions! {
        Gripper: new, receive, receive_datagram, poll, poll_transmit, poll_timeout, state, counters, outputs;
        Gripper: show_inputs, show_bad_inputs, show_faults, disconnect, name, ip, stored;
        IpParameters: is_set, prefix_len, are_valid;
        Profile: fits;
        StationName: new, from_bytes, as_str, is_empty;
    }
    function!(profinet::faults);
}
