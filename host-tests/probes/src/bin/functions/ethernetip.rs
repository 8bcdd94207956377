//! An EtherNet/IP adapter with outputs and inputs, and its parts.

use bus_ethernetip::{Device, Profile, Receiver};

use crate::functions;

pub(crate) fn every_function() {
    type Gripper = Device<8, 12>;
    functions! {
        Gripper: new, request, receive_datagram, receive_packet, closed, poll, poll_transmit, poll_timeout;
        Gripper: state, counters, outputs, show_inputs, has_session;
        Profile: is_valid;
        Receiver: new, default, push_slice;
    }
}
