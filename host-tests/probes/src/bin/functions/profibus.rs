//! A DP slave with outputs, inputs and a diagnosis, and its bit rate search.

use bus_profibus::{Address, Baud, BaudSearch, Character, Slave, identifiers_fit};

use crate::{function, functions};

pub(crate) fn every_function() {
    type Station = Slave<8, 12, 10>;
    function!(identifiers_fit);
    functions! {
        Station: new, push, poll, poll_timeout, state, master, address, counters, outputs;
        Station: show_inputs, show_diagnosis, announce_diagnosis, set_address;
        Address: new;
        Baud: bit_s, max_tsdr_bits;
        BaudSearch: new, baud, is_found, poll;
        Character: is_stray;
    }
}
