//! Compares the MODBUS server with `rmodbus`, with a list of allowed disagreements.
//!
//! The specification tests are beside the server's code and define the expectations. This test finds differences that
//! they do not cover. Both servers keep the same plain tables. The client of `rmodbus` also serves as a master, over
//! both framings.

use bus_modbus::rtu::{self, Character, Mode, Server, Timing, crc};
use bus_modbus::tcp;
use bus_modbus::{Bits, Device, Exception, Identification, MAX_PDU_LEN, Words, serve};
use proptest::prelude::*;
use rmodbus::client::ModbusRequest;
use rmodbus::server::ModbusFrame;
use rmodbus::server::storage::ModbusStorage;
use rmodbus::{ErrorKind, ModbusProto};

const BITS: usize = 40;
const REGISTERS: usize = 130;
const UNIT: u8 = 7;

/// Independent coils, discrete inputs, input registers and holding registers.
type Tables = ModbusStorage<BITS, BITS, REGISTERS, REGISTERS>;

fn tables() -> Tables {
    Tables {
        discretes: std::array::from_fn(|n| n % 3 == 0),
        inputs: std::array::from_fn(|n| 0x1000 + n as u16),
        ..Tables::default()
    }
}

struct Ours(Tables);

fn get<T: Copy>(table: &[T], address: u16) -> Result<T, Exception> {
    table.get(usize::from(address)).copied().ok_or(Exception::IllegalDataAddress)
}

fn put<T>(table: &mut [T], first: u16, values: impl ExactSizeIterator<Item = T>) -> Result<(), Exception> {
    let first = usize::from(first);
    let slots = table.get_mut(first..first + values.len()).ok_or(Exception::IllegalDataAddress)?;
    slots.iter_mut().zip(values).for_each(|(slot, value)| *slot = value);
    Ok(())
}

impl Device for Ours {
    fn coil(&self, address: u16) -> Result<bool, Exception> {
        get(&self.0.coils, address)
    }

    fn discrete_input(&self, address: u16) -> Result<bool, Exception> {
        get(&self.0.discretes, address)
    }

    fn holding_register(&self, address: u16) -> Result<u16, Exception> {
        get(&self.0.holdings, address)
    }

    fn input_register(&self, address: u16) -> Result<u16, Exception> {
        get(&self.0.inputs, address)
    }

    fn write_coils(&mut self, first: u16, values: Bits<'_>) -> Result<(), Exception> {
        put(&mut self.0.coils, first, values.iter().collect::<Vec<_>>().into_iter())
    }

    fn write_registers(&mut self, first: u16, values: Words<'_>) -> Result<(), Exception> {
        put(&mut self.0.holdings, first, values.iter().collect::<Vec<_>>().into_iter())
    }

    fn identification(&self) -> Identification {
        Identification { vendor_name: "", product_code: "", revision: "", regular: None }
    }
}

fn frame(pdu: &[u8]) -> Vec<u8> {
    let mut frame = [&[UNIT], pdu].concat();
    frame.extend(crc(&frame).to_le_bytes());
    frame
}

/// Returns the answer of `rmodbus`; empty without an answer.
fn theirs(tables: &mut Tables, pdu: &[u8]) -> Vec<u8> {
    let request = frame(pdu);
    let mut response = Vec::new();
    let mut server = ModbusFrame::new(UNIT, &request, ModbusProto::Rtu, &mut response);
    if server.parse().is_err() {
        return vec![];
    }
    if server.processing_required {
        let result = if server.readonly { server.process_read(tables) } else { server.process_write(tables) };
        if result.is_err() {
            return vec![];
        }
    }
    if server.response_required && server.finalize_response().is_err() {
        return vec![];
    }
    response
}

fn ours(device: &mut Ours, pdu: &[u8]) -> Vec<u8> {
    let mut response = [0; MAX_PDU_LEN];
    let len = serve(pdu, device, &mut response);
    frame(&response[..len])
}

fn be(value: u16) -> [u8; 2] {
    value.to_be_bytes()
}

fn address() -> impl Strategy<Value = u16> {
    prop_oneof![4 => 0..45u16, 2 => 100..140u16, 1 => any::<u16>(), 1 => 65_400..=u16::MAX]
}

/// Generates requests whose length, quantity and byte count agree and are in range.
fn request() -> impl Strategy<Value = Vec<u8>> {
    let read = |code: u8, most: u16| {
        (address(), prop_oneof![4 => 1..30u16, 1 => 1..=most])
            .prop_map(move |(first, quantity)| [&[code][..], &be(first), &be(quantity)].concat())
    };
    let coil = (address(), any::<bool>())
        .prop_map(|(at, on)| [&[5][..], &be(at), &[if on { 0xFF } else { 0 }, 0]].concat());
    let register = (address(), any::<u16>()).prop_map(|(at, value)| [&[6][..], &be(at), &be(value)].concat());
    let coils = (address(), proptest::collection::vec(any::<bool>(), 1..50)).prop_map(|(first, values)| {
        let mut bytes = vec![0u8; values.len().div_ceil(8)];
        for (n, value) in values.iter().enumerate() {
            bytes[n / 8] |= u8::from(*value) << (n % 8);
        }
        [&[15][..], &be(first), &be(values.len() as u16), &[bytes.len() as u8], &bytes].concat()
    });
    let registers =
        (address(), proptest::collection::vec(any::<u16>(), 1..=123)).prop_map(|(first, values)| {
            let bytes: Vec<u8> = values.iter().flat_map(|value| be(*value)).collect();
            [&[16][..], &be(first), &be(values.len() as u16), &[bytes.len() as u8], &bytes].concat()
        });
    prop_oneof![read(1, 2000), read(2, 2000), read(3, 125), read(4, 125), coil, register, coils, registers]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn requests_in_order_get_equal_answers_and_leave_equal_tables(requests in proptest::collection::vec(request(), 1..40)) {
        let mut our_device = Ours(tables());
        let mut their_tables = tables();
        for pdu in requests {
            prop_assert_eq!(ours(&mut our_device, &pdu), theirs(&mut their_tables, &pdu), "{:02X?}", pdu);
        }
        prop_assert_eq!(our_device.0.coils, their_tables.coils);
        prop_assert_eq!(our_device.0.holdings, their_tables.holdings);
    }
}

/// Returns the answer of our server to a frame with this framing.
fn answer(device: &mut Ours, framing: ModbusProto, frame: &[u8]) -> Vec<u8> {
    if framing == ModbusProto::TcpUdp {
        let mut receiver = tcp::Receiver::new();
        let (_, Some(tcp::Event::Request(request))) = receiver.push_slice(frame) else {
            panic!("the server found no frame: {frame:02X?}")
        };
        let mut place = [0; tcp::MAX_FRAME_LEN];
        return request.answer(&mut place, |pdu, response| serve(pdu, device, response)).to_vec();
    }
    let timing = Timing::of(19_200, 11);
    let mut server = Server::new(rtu::Config { unit: UNIT, mode: Mode::Strict, broadcast: false }, timing);
    for byte in frame {
        assert_eq!(server.push(Character::Byte(*byte), 0, device), None);
    }
    match server.silence(timing.t3_5_us, device) {
        Some(rtu::Event::Answer(answer)) => answer.to_vec(),
        event => panic!("{event:?} to {frame:02X?}"),
    }
}

#[test]
fn client_of_rmodbus_is_served_and_understands_every_answer() {
    for framing in [ModbusProto::TcpUdp, ModbusProto::Rtu] {
        let mut device = Ours(tables());
        let mut client = ModbusRequest::new(UNIT, framing);
        let mut frame = Vec::new();
        let mut asked = |frame: &mut Vec<u8>| answer(&mut device, framing, &std::mem::take(frame));

        client.generate_set_coils_bulk(3, &[true, false, true], &mut frame).unwrap();
        client.parse_ok(&asked(&mut frame)).unwrap();
        client.generate_set_coil(4, true, &mut frame).unwrap();
        client.parse_ok(&asked(&mut frame)).unwrap();
        client.generate_set_holdings_bulk(100, &[7, 0xFFFF], &mut frame).unwrap();
        client.parse_ok(&asked(&mut frame)).unwrap();
        client.generate_set_holding(102, 0x1234, &mut frame).unwrap();
        client.parse_ok(&asked(&mut frame)).unwrap();

        let (mut bits, mut registers) = (Vec::new(), Vec::new());
        client.generate_get_coils(2, 9, &mut frame).unwrap();
        client.parse_bool(&asked(&mut frame), &mut bits).unwrap();
        assert_eq!(bits, [false, true, true, true, false, false, false, false, false]);
        bits.clear();
        client.generate_get_discretes(0, 4, &mut frame).unwrap();
        client.parse_bool(&asked(&mut frame), &mut bits).unwrap();
        assert_eq!(bits, [true, false, false, true]);
        client.generate_get_holdings(99, 4, &mut frame).unwrap();
        client.parse_u16(&asked(&mut frame), &mut registers).unwrap();
        assert_eq!(registers, [0, 7, 0xFFFF, 0x1234]);
        registers.clear();
        client.generate_get_inputs(5, 120, &mut frame).unwrap();
        client.parse_u16(&asked(&mut frame), &mut registers).unwrap();
        assert!(registers.iter().copied().eq(0x1005..0x1005 + 120));

        client.generate_get_holdings(129, 2, &mut frame).unwrap();
        assert_eq!(client.parse_ok(&asked(&mut frame)), Err(ErrorKind::IllegalDataAddress));
        client.generate_get_holdings(0, 126, &mut frame).unwrap();
        assert_eq!(client.parse_ok(&asked(&mut frame)), Err(ErrorKind::IllegalDataValue));
    }
}

/// Requires each disagreement to exist, so a change in `rmodbus` removes its line here.
#[test]
fn specification_supports_us_in_each_allowed_disagreement() {
    const VALUE: &[u8] = &[3];
    let refused = |code: u8, exception: &[u8]| frame(&[&[code | 0x80], exception].concat());
    for (why, pdu, exception) in [
        ("a read quantity of 0 is invalid (6.1 to 6.4)", &[3, 0, 0, 0, 0][..], VALUE),
        ("a write quantity of 0 is invalid (6.12)", &[16, 0, 0, 0, 0, 0], VALUE),
        ("byte count and quantity disagree (6.12)", &[16, 0, 0, 0, 1, 4, 0, 1, 0, 2], VALUE),
        ("byte count and quantity disagree (6.11)", &[15, 0, 0, 0, 1, 2, 1, 0], VALUE),
    ] {
        let (mut our_device, mut their_tables) = (Ours(tables()), tables());
        assert_eq!(ours(&mut our_device, pdu), refused(pdu[0], exception), "{why}");
        assert_ne!(
            theirs(&mut their_tables, pdu),
            refused(pdu[0], exception),
            "{why}: the servers now agree; remove this line"
        );
        assert_eq!(our_device.0.holdings, tables().holdings);
    }
    // `rmodbus` does not serve functions 22, 23 and 43.
    for pdu in [&[22, 0, 0, 0xFF, 0xFF, 0, 0][..], &[23, 0, 0, 0, 1, 0, 0, 0, 1, 2, 0, 1], &[43, 14, 1, 0]] {
        assert_eq!(ours(&mut Ours(tables()), pdu)[1], pdu[0]);
        assert_ne!(theirs(&mut tables(), pdu).get(1), Some(&pdu[0]));
    }
    // `rmodbus` numbers the gateway exceptions 09 and 0A, the specification 0A and 0B (chapter 7).
    assert_eq!(rmodbus::consts::ModbusErrorCode::GatewayPathUnavailable as u8, 9);
    assert_eq!(Exception::GatewayPathUnavailable.code(), 10);
}
