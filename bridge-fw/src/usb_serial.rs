//! Control endpoint of a serial port over USB: a device of class CDC ACM (USB 2.0, chapter 9; CDC 1.2; PSTN 1.2). For boards
//! whose service port is a USB socket.
//!
//! The board implements endpoints and their buffers. `usb-device` does not fit: it shares data with a handler in a `RefCell`,
//! which can panic.

/// Largest packet of each endpoint.
pub const PACKET_LEN: u8 = 64;

/// Endpoint for notifications to the host, which are never sent, and endpoint for data in both directions.
pub const NOTIFICATIONS: u8 = 1;
/// See [`NOTIFICATIONS`].
pub const DATA: u8 = 2;

/// Fields of the request type of a setup packet (9.3): direction and type.
const TO_HOST: u8 = 0x80;
const TYPE: u8 = 0b11 << 5;
const STANDARD: u8 = 0;
const CLASS: u8 = 1 << 5;

/// Standard requests (9.4).
const GET_STATUS: u8 = 0;
const CLEAR_FEATURE: u8 = 1;
const SET_ADDRESS: u8 = 5;
const GET_DESCRIPTOR: u8 = 6;
const GET_CONFIGURATION: u8 = 8;
const SET_CONFIGURATION: u8 = 9;
const GET_INTERFACE: u8 = 10;
const SET_INTERFACE: u8 = 11;

/// Types of descriptors (9.4).
const DEVICE: u8 = 1;
const CONFIGURATION: u8 = 2;
const STRING: u8 = 3;
const INTERFACE: u8 = 4;
const ENDPOINT: u8 = 5;
const CS_INTERFACE: u8 = 0x24;

/// Requests of CDC ACM (PSTN, 6.3).
const SET_LINE_CODING: u8 = 0x20;
const GET_LINE_CODING: u8 = 0x21;
const SET_CONTROL_LINE_STATE: u8 = 0x22;
const SEND_BREAK: u8 = 0x23;

/// Vendor and product: the test product of pid.codes. A commercial device needs its own numbers.
const IDS: [u8; 4] = [0x09, 0x12, 0x01, 0x00];

/// Device descriptor: USB 2.0, class CDC, three strings (9.6.1).
static DEVICE_DESCRIPTOR: [u8; 18] = {
    let [v0, v1, p0, p1] = IDS;
    [18, DEVICE, 0x00, 0x02, 0x02, 0, 0, PACKET_LEN, v0, v1, p0, p1, 0x00, 0x01, 1, 2, 0, 1]
};

/// Configuration descriptor: bus powered with 100 mA; an interface with the class descriptors and the notification endpoint,
/// and an interface for data (9.6.3; PSTN, 5.3).
#[rustfmt::skip]
static CONFIGURATION_DESCRIPTOR: [u8; 67] = [
    9, CONFIGURATION, 67, 0, 2, 1, 0, 0x80, 50,
    9, INTERFACE, 0, 0, 1, 0x02, 0x02, 0x00, 0,
    5, CS_INTERFACE, 0x00, 0x10, 0x01,
    5, CS_INTERFACE, 0x01, 0x00, 1,
    4, CS_INTERFACE, 0x02, 0x02,
    5, CS_INTERFACE, 0x06, 0, 1,
    7, ENDPOINT, TO_HOST | NOTIFICATIONS, 0x03, 8, 0, 255,
    9, INTERFACE, 1, 0, 2, 0x0A, 0x00, 0x00, 0,
    7, ENDPOINT, DATA, 0x02, PACKET_LEN, 0, 0,
    7, ENDPOINT, TO_HOST | DATA, 0x02, PACKET_LEN, 0, 0,
];

/// Strings (9.6.7): language English, manufacturer, product.
static LANGUAGES: [u8; 4] = [4, STRING, 0x09, 0x04];
static MAKER: [u8; 22] = string(b"wsg-bridge");
static PRODUCT: [u8; 48] = string(b"WSG bridge service port");

/// Encodes ASCII as a string descriptor: length, type, UTF-16.
const fn string<const N: usize, const LEN: usize>(text: &[u8; N]) -> [u8; LEN] {
    assert!(LEN == 2 + 2 * N);
    let mut descriptor = [0; LEN];
    let mut at = 0;
    #[expect(clippy::indexing_slicing, reason = "at compile time, where it ends the build")]
    {
        descriptor[0] = LEN as u8;
        descriptor[1] = STRING;
        while at < N {
            descriptor[2 + 2 * at] = text[at];
            at += 1;
        }
    }
    descriptor
}

/// 115 200 bit/s, one stop bit, no parity, eight bits (PSTN, 6.3.11). Settings of the host have no effect.
static LINE_CODING: [u8; 7] = [0x00, 0xC2, 0x01, 0x00, 0, 0, 8];

/// Response to a request of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Send these bytes to the host, which acknowledges them.
    Data(&'static [u8]),
    /// Acknowledge the request.
    Done,
    /// Acknowledge the request, then use this address.
    Address(u8),
    /// Acknowledge the request, then enable or disable the data endpoint. Both of its directions start with DATA0.
    Configured(bool),
    /// Acknowledge the request, then restart one direction of the data endpoint with DATA0.
    Cleared {
        /// The direction to the host.
        to_host: bool,
    },
    /// Receive and acknowledge a packet of the host, and ignore its content.
    TakeData,
    /// Unknown request: stall the control endpoint until the next one.
    Stall,
}

/// Returns the response to a request. `setup` is the setup packet of a control transfer.
///
/// ```
/// use wsg_bridge_fw::usb_serial::{Answer, answer};
///
/// assert_eq!(answer([0x00, 5, 17, 0, 0, 0, 0, 0], false), Answer::Address(17));
/// ```
#[must_use]
pub fn answer(setup: [u8; 8], is_configured: bool) -> Answer {
    let [kind, request, value, value_high, index, _, len_low, len_high] = setup;
    let answer = match (kind & TYPE, request) {
        (STANDARD, GET_DESCRIPTOR) => match descriptor(value_high, value) {
            Some(bytes) => Answer::Data(bytes),
            None => Answer::Stall,
        },
        (STANDARD, SET_ADDRESS) => Answer::Address(value & 0x7F),
        (STANDARD, SET_CONFIGURATION) if value <= 1 => Answer::Configured(value == 1),
        (STANDARD, GET_CONFIGURATION) => Answer::Data(if is_configured { &[1] } else { &[0] }),
        (STANDARD, GET_STATUS) => Answer::Data(&[0, 0]),
        (STANDARD, GET_INTERFACE) => Answer::Data(&[0]),
        (STANDARD, SET_INTERFACE) if value == 0 => Answer::Done,
        (STANDARD, CLEAR_FEATURE) if index & 0x7F == DATA => {
            Answer::Cleared { to_host: index & TO_HOST != 0 }
        }
        (STANDARD, CLEAR_FEATURE) => Answer::Done,
        (CLASS, SET_LINE_CODING) => Answer::TakeData,
        (CLASS, GET_LINE_CODING) => Answer::Data(&LINE_CODING),
        (CLASS, SET_CONTROL_LINE_STATE | SEND_BREAK) => Answer::Done,
        _ => Answer::Stall,
    };
    match answer {
        // Limited to the requested length.
        Answer::Data(bytes) if kind & TO_HOST != 0 => {
            let len = usize::from(u16::from_le_bytes([len_low, len_high]));
            Answer::Data(bytes.get(..len).unwrap_or(bytes))
        }
        Answer::Data(_) => Answer::Stall,
        other => other,
    }
}

fn descriptor(kind: u8, index: u8) -> Option<&'static [u8]> {
    match (kind, index) {
        (DEVICE, 0) => Some(&DEVICE_DESCRIPTOR),
        (CONFIGURATION, 0) => Some(&CONFIGURATION_DESCRIPTOR),
        (STRING, 0) => Some(&LANGUAGES),
        (STRING, 1) => Some(&MAKER),
        (STRING, 2) => Some(&PRODUCT),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const TO_DEVICE: u8 = 0;

    fn ask(kind: u8, request: u8, value: u16, index: u8, len: u16) -> Answer {
        let [value_low, value_high] = value.to_le_bytes();
        let [len_low, len_high] = len.to_le_bytes();
        answer([kind, request, value_low, value_high, index, 0, len_low, len_high], true)
    }

    #[test]
    fn descriptors_have_consistent_lengths_and_order() {
        let Answer::Data(bytes) = ask(TO_HOST, GET_DESCRIPTOR, 0x200, 0, 255) else { panic!() };
        let mut kinds = Vec::new();
        let mut endpoints = Vec::new();
        let mut rest = bytes;
        while let [len, kind, ..] = *rest {
            let (head, tail) = rest.split_at(usize::from(len));
            kinds.push(kind);
            if kind == ENDPOINT {
                endpoints.push((head[2], head[3]));
            }
            rest = tail;
        }
        assert!(rest.is_empty());
        assert_eq!(usize::from(u16::from_le_bytes([bytes[2], bytes[3]])), bytes.len());
        assert_eq!(kinds, [2, 4, 0x24, 0x24, 0x24, 0x24, 5, 4, 5, 5]);
        assert_eq!(endpoints, [(0x81, 3), (0x02, 2), (0x82, 2)]);
        for (kind, index) in [(DEVICE, 0), (STRING, 0), (STRING, 1), (STRING, 2)] {
            let bytes = descriptor(kind, index).unwrap();
            assert_eq!((usize::from(bytes[0]), bytes[1]), (bytes.len(), kind));
        }
    }

    #[test]
    fn response_is_limited_to_the_requested_length() {
        assert_eq!(ask(TO_HOST, GET_DESCRIPTOR, 0x100, 0, 8), Answer::Data(&DEVICE_DESCRIPTOR[..8]));
        assert_eq!(ask(TO_HOST, GET_DESCRIPTOR, 0x100, 0, 64), Answer::Data(&DEVICE_DESCRIPTOR));
        assert_eq!(ask(TO_HOST, GET_DESCRIPTOR, 0x600, 0, 10), Answer::Stall);
        assert_eq!(ask(TO_DEVICE, GET_DESCRIPTOR, 0x100, 0, 8), Answer::Stall);
    }

    #[test]
    fn host_configures_the_port() {
        assert_eq!(ask(TO_DEVICE, SET_ADDRESS, 42, 0, 0), Answer::Address(42));
        assert_eq!(ask(TO_DEVICE, SET_CONFIGURATION, 1, 0, 0), Answer::Configured(true));
        assert_eq!(ask(TO_DEVICE, SET_CONFIGURATION, 0, 0, 0), Answer::Configured(false));
        assert_eq!(ask(TO_DEVICE, SET_CONFIGURATION, 2, 0, 0), Answer::Stall);
        assert_eq!(ask(0x21, SET_LINE_CODING, 0, 0, 7), Answer::TakeData);
        assert_eq!(ask(0xA1, GET_LINE_CODING, 0, 0, 7), Answer::Data(&LINE_CODING));
        assert_eq!(ask(0x21, SET_CONTROL_LINE_STATE, 3, 0, 0), Answer::Done);
        assert_eq!(ask(0x02, CLEAR_FEATURE, 0, 0x82, 0), Answer::Cleared { to_host: true });
        assert_eq!(ask(0x02, CLEAR_FEATURE, 0, 0x02, 0), Answer::Cleared { to_host: false });
        assert_eq!(ask(0x40, 1, 0, 0, 0), Answer::Stall);
    }

    /// USB 2.0, 9.4: one configuration, one setting of each interface, no halted endpoint.
    #[test]
    fn host_reads_the_state_of_the_port() {
        for (is_configured, expected) in [(false, [0]), (true, [1])] {
            let state = answer([TO_HOST, GET_CONFIGURATION, 0, 0, 0, 0, 1, 0], is_configured);
            assert!(matches!(state, Answer::Data(bytes) if bytes == expected), "{state:?}");
        }
        assert_eq!(ask(TO_HOST, GET_STATUS, 0, 0, 2), Answer::Data(&[0, 0]));
        assert_eq!(ask(0x81, GET_INTERFACE, 0, 1, 1), Answer::Data(&[0]));
        assert_eq!(ask(0x01, SET_INTERFACE, 0, 1, 0), Answer::Done);
        assert_eq!(ask(0x01, SET_INTERFACE, 1, 1, 0), Answer::Stall);
        assert_eq!(ask(0x02, CLEAR_FEATURE, 0, TO_HOST | NOTIFICATIONS, 0), Answer::Done);
    }

    #[test]
    fn strings_are_utf_16() {
        let Answer::Data([_, _, text @ ..]) = ask(TO_HOST, GET_DESCRIPTOR, 0x301, 0, 255) else { panic!() };
        let units = text.as_chunks().0.iter().map(|unit| u16::from_le_bytes(*unit));
        assert_eq!(
            char::decode_utf16(units).collect::<Result<std::string::String, _>>().unwrap(),
            "wsg-bridge"
        );
    }
}
