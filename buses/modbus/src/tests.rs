//! Byte-exact tests of each function and exception of the application protocol specification.

use super::*;
use std::vec;
use std::vec::Vec;

/// Four holding registers that overlap 64 coils, and six input registers that overlap 96 discrete inputs. Bit n is bit
/// n mod 8 of byte n div 8. Registers are two bytes, high byte first.
#[derive(Default)]
pub(super) struct Tables {
    output: [u8; 8],
    input: [u8; 12],
    written: bool,
}

impl Tables {
    /// Returns the holding registers as bytes if a request has written to them since the last call.
    pub(super) fn take_written(&mut self) -> Option<[u8; 8]> {
        core::mem::take(&mut self.written).then_some(self.output)
    }

    fn bit(bytes: &[u8], address: u16) -> Result<bool, Exception> {
        device::bit(bytes, address.into()).ok_or(Exception::IllegalDataAddress)
    }

    fn word(bytes: &[u8], address: u16) -> Result<u16, Exception> {
        let pair = bytes.as_chunks().0.get(usize::from(address));
        pair.map(|pair| u16::from_be_bytes(*pair)).ok_or(Exception::IllegalDataAddress)
    }

    fn write_coils(&mut self, first: u16, values: Bits<'_>) -> Result<(), Exception> {
        let mut bytes = self.output;
        for (n, value) in (usize::from(first)..).zip(values.iter()) {
            let byte = bytes.get_mut(n / 8).ok_or(Exception::IllegalDataAddress)?;
            *byte = *byte & !(1 << (n % 8)) | u8::from(value) << (n % 8);
        }
        (self.output, self.written) = (bytes, true);
        Ok(())
    }

    fn write_registers(&mut self, first: u16, values: Words<'_>) -> Result<(), Exception> {
        let mut bytes = self.output;
        for (n, value) in (usize::from(first)..).zip(values.iter()) {
            let pair = bytes.as_chunks_mut().0.get_mut(n).ok_or(Exception::IllegalDataAddress)?;
            *pair = value.to_be_bytes();
        }
        (self.output, self.written) = (bytes, true);
        Ok(())
    }
}

/// A device with [`Tables`], additional readable registers, configurable write rejections and an identification.
pub(super) struct Plant {
    pub(super) tables: Tables,
    /// Exception for every write of registers.
    refusal: Option<Exception>,
    /// First address and length of each write passed to the device.
    writes: Vec<(u16, usize)>,
    /// File, first record and data of each group passed to the device.
    records: Vec<(u16, u16, Vec<u8>)>,
    /// Outcome of a write of file records.
    pub(super) outcome: Option<Result<(), Exception>>,
    regular: bool,
    name: &'static str,
}

impl Plant {
    pub(super) fn new() -> Self {
        Self {
            tables: Tables::default(),
            refusal: None,
            writes: vec![],
            records: vec![],
            outcome: Some(Ok(())),
            regular: true,
            name: "V",
        }
    }

    fn ask(&mut self, request: &[u8]) -> Vec<u8> {
        let mut response = [0xEE; MAX_PDU_LEN];
        let len = serve(request, self, &mut response);
        response[..len].to_vec()
    }
}

impl Device for Plant {
    fn coil(&self, address: u16) -> Result<bool, Exception> {
        Tables::bit(&self.tables.output, address)
    }

    fn discrete_input(&self, address: u16) -> Result<bool, Exception> {
        Tables::bit(&self.tables.input, address)
    }

    fn holding_register(&self, address: u16) -> Result<u16, Exception> {
        // The highest addresses exist, to test reads past 65 535.
        if address >= 65_500 { Ok(address) } else { Tables::word(&self.tables.output, address) }
    }

    fn input_register(&self, address: u16) -> Result<u16, Exception> {
        // Enough registers for the longest response.
        if address >= 1_000 { Ok(address) } else { Tables::word(&self.tables.input, address) }
    }

    fn write_coils(&mut self, first: u16, values: Bits<'_>) -> Result<(), Exception> {
        self.writes.push((first, values.len().into()));
        self.tables.write_coils(first, values)
    }

    fn write_registers(&mut self, first: u16, values: Words<'_>) -> Result<(), Exception> {
        self.writes.push((first, values.len()));
        if let Some(refusal) = self.refusal {
            return Err(refusal);
        }
        self.tables.write_registers(first, values)
    }

    fn write_file_records(&mut self, records: FileRecords<'_>) -> Result<(), Exception> {
        if let Some(refusal) = self.refusal {
            return Err(refusal);
        }
        self.records.extend(records.iter().map(|it| (it.file, it.first, it.values.as_bytes().to_vec())));
        Ok(())
    }

    fn outcome(&self) -> Option<Result<(), Exception>> {
        self.outcome
    }

    fn identification(&self) -> Identification {
        Identification {
            vendor_name: self.name,
            product_code: "PC",
            revision: "1.2",
            regular: self.regular.then_some(["", "PN", "M", ""]),
        }
    }
}

const ILLEGAL_ADDRESS: u8 = 2;
const ILLEGAL_VALUE: u8 = 3;

#[track_caller]
fn refused(request: &[u8], exception: u8) {
    let mut plant = Plant::new();
    assert_eq!(plant.ask(request), [request[0] | 0x80, exception], "{request:02X?}");
    assert_eq!(plant.tables.take_written(), None, "{request:02X?} is rejected without a change");
}

#[test]
fn read_coils_packs_bits_from_the_lowest_and_fills_with_zeros() {
    let mut plant = Plant::new();
    plant.ask(&[6, 0, 0, 0b1000_0001, 0b1010_0110]);
    assert_eq!(plant.ask(&[1, 0, 0, 0, 8]), [1, 1, 0b1000_0001]);
    assert_eq!(plant.ask(&[1, 0, 7, 0, 3]), [1, 1, 0b0000_0101], "bits 7 to 9");
    assert_eq!(plant.ask(&[1, 0, 0, 0, 17]), [1, 3, 0b1000_0001, 0b1010_0110, 0]);
    assert_eq!(plant.ask(&[1, 0, 63, 0, 1]), [1, 1, 0]);
}

#[test]
fn read_discrete_inputs_reads_the_table_of_inputs() {
    let mut plant = Plant::new();
    (plant.tables.input[0], plant.tables.input[11]) = (0x01, 26);
    assert_eq!(plant.ask(&[2, 0, 0, 0, 1]), [2, 1, 1]);
    assert_eq!(plant.ask(&[2, 0, 88, 0, 8]), [2, 1, 26]);
}

#[test]
fn read_registers_sends_the_high_byte_first() {
    let mut plant = Plant::new();
    plant.ask(&[6, 0, 1, 0x04, 0xC4]);
    assert_eq!(plant.ask(&[3, 0, 0, 0, 2]), [3, 4, 0, 0, 0x04, 0xC4]);
    assert_eq!(plant.ask(&[4, 0x03, 0xE8, 0, 2]), [4, 4, 0x03, 0xE8, 0x03, 0xE9]);
    assert_eq!(plant.ask(&[4, 0x03, 0xE8, 0, 125]).len(), 252, "the longest response");
}

#[test]
fn invalid_quantities_are_03_before_addresses_are_checked() {
    for (code, most) in [(1u8, 2000u16), (2, 2000), (3, 125), (4, 125)] {
        let [high, low] = (most + 1).to_be_bytes();
        refused(&[code, 0xFF, 0xFF, 0, 0], ILLEGAL_VALUE);
        refused(&[code, 0xFF, 0xFF, high, low], ILLEGAL_VALUE);
        let [high, low] = most.to_be_bytes();
        refused(&[code, 0, 0, high, low], ILLEGAL_ADDRESS);
    }
}

#[test]
fn addresses_past_the_last_are_02_for_each_function() {
    for request in [
        &[1, 0, 64, 0, 1][..],
        &[1, 0, 63, 0, 2],
        &[2, 0, 96, 0, 1],
        &[2, 0, 90, 0, 7],
        &[3, 0, 4, 0, 1],
        &[3, 0, 3, 0, 2],
        &[4, 0, 6, 0, 1],
        &[4, 0, 5, 0, 2],
        &[5, 0, 64, 0xFF, 0],
        &[6, 0, 4, 0, 0],
        &[15, 0, 60, 0, 5, 1, 0x1F],
        &[16, 0, 3, 0, 2, 4, 0, 1, 0, 2],
        &[22, 0, 4, 0, 0, 0, 0],
        &[23, 0, 4, 0, 1, 0, 0, 0, 1, 2, 0, 1],
        &[23, 0, 0, 0, 1, 0, 4, 0, 1, 2, 0, 1],
    ] {
        refused(request, ILLEGAL_ADDRESS);
    }
}

#[test]
fn addresses_do_not_wrap_at_65_535() {
    let mut plant = Plant::new();
    assert_eq!(plant.ask(&[3, 0xFF, 0xFF, 0, 1]), [3, 2, 0xFF, 0xFF]);
    refused(&[3, 0xFF, 0xFF, 0, 2], ILLEGAL_ADDRESS);
    refused(&[4, 0xFF, 0xF0, 0, 17], ILLEGAL_ADDRESS);
    refused(&[16, 0xFF, 0xFF, 0, 2, 4, 0, 1, 0, 2], ILLEGAL_ADDRESS);
    refused(&[15, 0xFF, 0xFF, 0, 2, 1, 3], ILLEGAL_ADDRESS);
}

#[test]
fn write_single_coil_accepts_only_on_and_off() {
    let mut plant = Plant::new();
    assert_eq!(plant.ask(&[5, 0, 13, 0xFF, 0]), [5, 0, 13, 0xFF, 0]);
    assert_eq!(plant.tables.take_written(), Some([0, 1 << 5, 0, 0, 0, 0, 0, 0]));
    assert_eq!(plant.ask(&[5, 0, 13, 0, 0]), [5, 0, 13, 0, 0]);
    assert_eq!(plant.tables.take_written(), Some([0; 8]));
    for value in [[0, 1], [0xFF, 1], [1, 0], [0xFF, 0xFF]] {
        refused(&[5, 0xFF, 0xFF, value[0], value[1]], ILLEGAL_VALUE);
    }
}

#[test]
fn write_single_register_echoes() {
    let mut plant = Plant::new();
    assert_eq!(plant.ask(&[6, 0, 0, 0x01, 0x20]), [6, 0, 0, 0x01, 0x20]);
    assert_eq!(plant.tables.take_written(), Some([0x01, 0x20, 0, 0, 0, 0, 0, 0]));
}

#[test]
fn multiple_writes_reach_the_device_as_one() {
    let mut plant = Plant::new();
    let request = [16, 0, 0, 0, 4, 8, 0x02, 0, 0x07, 0xD0, 0x13, 0x88, 0x0F, 0xA0];
    assert_eq!(plant.ask(&request), [16, 0, 0, 0, 4]);
    assert_eq!(plant.writes, [(0, 4)]);
    assert_eq!(plant.tables.take_written(), Some([0x02, 0, 0x07, 0xD0, 0x13, 0x88, 0x0F, 0xA0]));

    assert_eq!(plant.ask(&[15, 0, 1, 0, 10, 2, 0b0000_0010, 0b11]), [15, 0, 1, 0, 10]);
    assert_eq!(plant.writes, [(0, 4), (1, 10)]);
    // Coils 1 to 10 were written; 2, 9 and 10 are on.
    assert_eq!(plant.tables.take_written(), Some([0b100, 0b110, 0x07, 0xD0, 0x13, 0x88, 0x0F, 0xA0]));
}

#[test]
fn multiple_writes_whose_counts_disagree_are_03() {
    for request in [
        &[16, 0, 0, 0, 0, 0][..],
        &[16, 0, 0, 0, 1, 4, 0, 1, 0, 2],
        &[16, 0, 0, 0, 2, 2, 0, 1],
        &[16, 0, 0, 0, 2, 4, 0, 1, 0],
        &[16, 0, 0, 0, 2, 4, 0, 1, 0, 2, 0],
        &[16, 0, 0, 0, 2],
        &[16, 0, 0, 0, 124, 248],
        &[15, 0, 0, 0, 0, 0],
        &[15, 0, 0, 0, 9, 1, 0xFF],
        &[15, 0, 0, 0, 8, 2, 0xFF, 0xFF],
        &[15, 0, 0, 0, 8, 1],
        &[15, 0, 0, 0x07, 0xB1, 247],
        &[23, 0, 0, 0, 0, 0, 0, 0, 1, 2, 0, 1],
        &[23, 0, 0, 0, 126, 0, 0, 0, 1, 2, 0, 1],
        &[23, 0, 0, 0, 1, 0, 0, 0, 0, 0],
        &[23, 0, 0, 0, 1, 0, 0, 0, 122, 244],
        &[23, 0, 0, 0, 1, 0, 0, 0, 1, 4, 0, 1, 0, 2],
        &[23, 0, 0, 0, 1, 0, 0, 0, 1, 2, 0],
    ] {
        refused(request, ILLEGAL_VALUE);
    }
}

/// Returns a request that writes these groups: reference type, file, first record and number of records.
fn file_request(groups: &[(u8, u16, u16, u8)]) -> Vec<u8> {
    let group = |(reference, file, first, count): &(u8, u16, u16, u8)| {
        let head = [&[*reference][..], &file.to_be_bytes(), &first.to_be_bytes(), &[0, *count]].concat();
        [head, (0..2 * count).collect()].concat()
    };
    let data: Vec<u8> = groups.iter().flat_map(group).collect();
    [&[21, data.len() as u8][..], &data].concat()
}

#[test]
fn write_file_record_passes_all_groups_and_echoes() {
    let mut plant = Plant::new();
    // The specification's example.
    let request = [21, 0x0D, 6, 0, 4, 0, 7, 0, 3, 0x06, 0xAF, 0x04, 0xBE, 0x10, 0x0D];
    assert_eq!(plant.ask(&request), request);
    assert_eq!(plant.records, [(4, 7, vec![0x06, 0xAF, 0x04, 0xBE, 0x10, 0x0D])]);
    let request = file_request(&[(6, u16::MAX, 9_999, 1), (6, 1, 9_880, 116)]);
    assert_eq!(plant.ask(&request), request, "the longest request with two groups");
    assert_eq!(plant.records[1..], [(u16::MAX, 9_999, vec![0, 1]), (1, 9_880, (0..232).collect())]);
    plant.refusal = Some(Exception::ServerDeviceBusy);
    assert_eq!(plant.ask(&request), [0x95, 6]);
    assert_eq!(Plant::new().ask(&file_request(&[(6, 1, 0, 122)])).len(), 253, "the longest request");
}

#[test]
fn file_records_that_cannot_exist_are_02_and_counts_that_disagree_03() {
    for (groups, exception) in [
        (&[(5, 1, 0, 1)][..], ILLEGAL_ADDRESS),
        (&[(6, 1, 0, 1), (7, 1, 0, 1)], ILLEGAL_ADDRESS),
        (&[(6, 0, 0, 1)], ILLEGAL_ADDRESS),
        (&[(6, 1, 10_000, 1)], ILLEGAL_ADDRESS),
        (&[(6, 1, 9_999, 2)], ILLEGAL_ADDRESS),
        (&[], ILLEGAL_VALUE),
        (&[(6, 1, 0, 0)], ILLEGAL_VALUE),
        (&[(5, 1, 0, 1), (6, 1, 0, 0)], ILLEGAL_VALUE),
    ] {
        refused(&file_request(groups), exception);
    }
    let whole = file_request(&[(6, 1, 0, 2), (6, 2, 0, 2)]);
    for len in 1..whole.len() {
        refused(&whole[..len], ILLEGAL_VALUE);
        let cut = [&[21, len.saturating_sub(2) as u8], &whole[2..len.max(2)]].concat();
        let is_whole = len == 2 + 11;
        let answer = Plant::new().ask(&cut);
        assert_eq!(answer[..2], if is_whole { [21, 11] } else { [0x95, ILLEGAL_VALUE] }, "{cut:02X?}");
    }
}

#[test]
fn mask_write_register_combines_by_and_then_or() {
    let mut plant = Plant::new();
    // The specification's example: 12h with And_Mask F2h and Or_Mask 25h yields 17h.
    plant.ask(&[6, 0, 1, 0, 0x12]);
    let request = [22, 0, 1, 0, 0xF2, 0, 0x25];
    assert_eq!(plant.ask(&request), request);
    assert_eq!(plant.holding_register(1), Ok(0x17));
}

#[test]
fn read_write_multiple_registers_writes_first() {
    let mut plant = Plant::new();
    let answer = plant.ask(&[23, 0, 0, 0, 3, 0, 1, 0, 2, 4, 0x07, 0xD0, 0x13, 0x88]);
    assert_eq!(answer, [23, 6, 0, 0, 0x07, 0xD0, 0x13, 0x88]);
}

#[test]
fn read_write_multiple_registers_writes_only_if_it_can_read() {
    let mut plant = Plant::new();
    assert_eq!(plant.ask(&[23, 0, 3, 0, 2, 0, 0, 0, 1, 2, 0, 1]), [0x97, ILLEGAL_ADDRESS]);
    assert_eq!(plant.writes, []);
}

#[test]
fn request_without_a_function_code_gets_no_response() {
    assert_eq!(Plant::new().ask(&[]), []);
}

#[test]
fn rejection_by_the_device_is_the_exception() {
    for (exception, code) in [
        (Exception::ServerDeviceFailure, 4),
        (Exception::ServerDeviceBusy, 6),
        (Exception::GatewayPathUnavailable, 10),
        (Exception::GatewayTargetDeviceFailedToRespond, 11),
    ] {
        let mut plant = Plant::new();
        plant.refusal = Some(exception);
        assert_eq!(plant.ask(&[6, 0, 0, 0, 1]), [0x86, code]);
        assert_eq!(plant.ask(&[16, 0, 0, 0, 1, 2, 0, 1]), [0x90, code]);
    }
}

#[test]
fn name_may_fill_a_response_and_a_longer_one_is_omitted() {
    // Function code, six bytes of header and two bytes before the name.
    const LONGEST: usize = MAX_PDU_LEN - 9;
    const NAME: &str = match core::str::from_utf8(&[b'W'; LONGEST + 1]) {
        Ok(name) => name,
        Err(_) => "",
    };
    for (len, count, more) in [(LONGEST, 1, 0), (LONGEST + 1, 0, 0xFF)] {
        let mut answer = [0; MAX_PDU_LEN];
        let mut plant = Plant { name: &NAME[..len], ..Plant::new() };
        let answered = serve(&[43, 14, 4, 0], &mut plant, &mut answer);
        assert_eq!((answer[4], answer[6]), (more, count), "{len}");
        assert_eq!(answered, if count == 1 { MAX_PDU_LEN } else { 7 });
    }
}

#[test]
fn exceptions_have_the_names_of_the_specification() {
    use std::string::ToString;
    assert_eq!(Exception::IllegalFunction.to_string(), "illegal function");
    assert_eq!(Exception::ServerDeviceBusy.to_string(), "server device busy");
}

#[test]
fn device_identification_streams_its_objects() {
    let mut plant = Plant::new();
    let basic = [&[43, 14, 1, 0x82, 0, 0, 3][..], b"\0\x01V", b"\x01\x02PC", b"\x02\x031.2"].concat();
    assert_eq!(plant.ask(&[43, 14, 1, 0]), basic);
    assert_eq!(plant.ask(&[43, 14, 1, 200]), basic, "an unknown object restarts at the first");
    let tail = [&[43, 14, 2, 0x82, 0, 0, 3][..], b"\x04\x02PN", b"\x05\x01M", b"\x06\0"].concat();
    assert_eq!(plant.ask(&[43, 14, 2, 4]), tail);
    plant.regular = false;
    assert_eq!(plant.ask(&[43, 14, 2, 0])[2..7], [2, 0x81, 0, 0, 3], "the server's own level");
}

/// Specification, 6.21: a request above the server's conformity level is answered at the server's level.
#[test]
fn extended_identification_is_answered_with_existing_objects() {
    let mut plant = Plant::new();
    let regular = plant.ask(&[43, 14, 2, 0]);
    for object in [0, 7, 0x80, 0xFF] {
        let answer = plant.ask(&[43, 14, 3, object]);
        assert_eq!(answer[..7], [43, 14, 3, 0x82, 0, 0, 7], "{object:02X}h: from the first object on");
        assert_eq!(answer[7..], regular[7..], "{object:02X}h");
        assert_eq!(plant.ask(&[43, 14, 2, object])[3..], answer[3..], "{object:02X}h");
    }
    assert_eq!(plant.ask(&[43, 14, 3, 4])[3..9], [0x82, 0, 0, 3, 4, 2]);
    for object in [7, 0x7F, 0x80, 0xFF] {
        assert_eq!(plant.ask(&[43, 14, 4, object]), [0xAB, ILLEGAL_ADDRESS], "{object:02X}h");
    }
    plant.regular = false;
    assert_eq!(plant.ask(&[43, 14, 3, 0x80])[2..7], [3, 0x81, 0, 0, 3]);
}

#[test]
fn device_identification_returns_a_single_object() {
    let mut plant = Plant::new();
    assert_eq!(plant.ask(&[43, 14, 4, 1]), [&[43, 14, 4, 0x82, 0, 0, 1][..], b"\x01\x02PC"].concat());
    plant.regular = false;
    assert_eq!(plant.ask(&[43, 14, 4, 4]), [0xAB, ILLEGAL_ADDRESS]);
    assert_eq!(plant.ask(&[43, 14, 0, 0]), [0xAB, ILLEGAL_VALUE]);
    assert_eq!(plant.ask(&[43, 14, 5, 200]), [0xAB, ILLEGAL_VALUE]);
}

#[test]
fn identification_that_does_not_fit_names_the_next_object() {
    struct Talker(Plant);
    const LONG: &str = match core::str::from_utf8(&[b'x'; 120]) {
        Ok(text) => text,
        Err(_) => "",
    };
    impl Device for Talker {
        fn coil(&self, _: u16) -> Result<bool, Exception> {
            self.0.coil(0)
        }
        fn discrete_input(&self, _: u16) -> Result<bool, Exception> {
            self.0.coil(0)
        }
        fn holding_register(&self, _: u16) -> Result<u16, Exception> {
            Ok(0)
        }
        fn input_register(&self, _: u16) -> Result<u16, Exception> {
            Ok(0)
        }
        fn write_coils(&mut self, _: u16, _: Bits<'_>) -> Result<(), Exception> {
            Ok(())
        }
        fn write_registers(&mut self, _: u16, _: Words<'_>) -> Result<(), Exception> {
            Ok(())
        }
        fn identification(&self) -> Identification {
            Identification { vendor_name: LONG, product_code: LONG, revision: LONG, regular: None }
        }
    }
    let mut response = [0; MAX_PDU_LEN];
    let mut talker = Talker(Plant::new());
    let len = serve(&[43, 14, 1, 0], &mut talker, &mut response);
    assert_eq!((len, &response[3..7]), (7 + 2 * 122, &[0x81, 0xFF, 2, 2][..]));
    let len = serve(&[43, 14, 1, 2], &mut talker, &mut response);
    assert_eq!((len, &response[3..7]), (7 + 122, &[0x81, 0, 0, 1][..]));
}

/// The response to a [`Plant`] request according to the specification, written independently of the code under test:
/// the exception or the length of the response (chapter 6, state diagram of each function). Length 0 means any.
fn by_the_specification(request: &[u8]) -> Result<usize, u8> {
    let (code, data) = (request[0], &request[1..]);
    let word = |at: usize| usize::from(data[at]) * 256 + usize::from(data[at + 1]);
    let holding = |first: usize, count: usize| {
        (first..first + count).all(|n| n < 4 || (65_500..65_536).contains(&n)).then_some(()).ok_or(2)
    };
    let writable = |first: usize, count: usize| if first + count <= 4 { Ok(()) } else { Err(2) };
    let read = |most: usize| -> Result<(usize, usize), u8> {
        if data.len() != 4 || !(1..=most).contains(&word(2)) { Err(3) } else { Ok((word(0), word(2))) }
    };
    let block = |at: usize, most: usize, bytes_of: &dyn Fn(usize) -> usize| -> Result<(usize, usize), u8> {
        let fits = data.len() > at + 4
            && (1..=most).contains(&word(at + 2))
            && usize::from(data[at + 4]) == bytes_of(word(at + 2))
            && data.len() == at + 5 + usize::from(data[at + 4]);
        if fits { Ok((word(at), word(at + 2))) } else { Err(3) }
    };
    match code {
        1 | 2 => {
            let (first, count) = read(2000)?;
            let there = if code == 1 { 64 } else { 96 };
            if first + count > there { Err(2) } else { Ok(2 + count.div_ceil(8)) }
        }
        3 => {
            let (first, count) = read(125)?;
            holding(first, count).map(|()| 2 + 2 * count)
        }
        4 => {
            let (first, count) = read(125)?;
            let there = (first..first + count).all(|n| n < 6 || (1_000..65_536).contains(&n));
            if there { Ok(2 + 2 * count) } else { Err(2) }
        }
        5 if data.len() != 4 || !matches!(word(2), 0 | 0xFF00) => Err(3),
        5 if word(0) >= 64 => Err(2),
        6 if data.len() != 4 => Err(3),
        6 => writable(word(0), 1).map(|()| 5),
        15 => {
            let (first, count) = block(0, 0x07B0, &|count| count.div_ceil(8))?;
            if first + count > 64 { Err(2) } else { Ok(5) }
        }
        16 => {
            let (first, count) = block(0, 0x7B, &|count| 2 * count)?;
            writable(first, count).map(|()| 5)
        }
        21 => {
            let (mut at, mut exists) = (1, true);
            let fits = data
                .first()
                .is_some_and(|count| (9..=251).contains(count) && data.len() == 1 + usize::from(*count));
            while fits && at < data.len() {
                let len = if at + 7 <= data.len() { 2 * word(at + 5) } else { 0 };
                if len == 0 || at + 7 + len > data.len() {
                    return Err(3);
                }
                let is_last = word(at + 3) + word(at + 5) > 10_000;
                exists &= data[at] == 6 && word(at + 1) != 0 && !is_last;
                at += 7 + len;
            }
            if !fits {
                Err(3)
            } else if exists {
                Ok(request.len())
            } else {
                Err(2)
            }
        }
        22 if data.len() != 6 => Err(3),
        22 => holding(word(0), 1).and(writable(word(0), 1)).map(|()| 7),
        23 => {
            if data.len() < 4 || !(1..=0x7D).contains(&word(2)) {
                return Err(3);
            }
            let (first, count) = block(4, 0x79, &|count| 2 * count)?;
            holding(word(0), word(2)).and(writable(first, count)).map(|()| 2 + 2 * word(2))
        }
        43 => match data {
            [14, 1..=3, _] => Ok(0),
            [14, 4, 0..=6] => Ok(0),
            [14, 4, _] => Err(2),
            [14, ..] | [] => Err(3),
            _ => Err(1),
        },
        5 => Ok(5),
        _ => Err(1),
    }
}

#[test]
fn every_function_at_every_length_is_answered_as_specified() {
    let mut answered = [0; 256];
    for code in 0..=255u8 {
        for len in 0..=260usize {
            let fill = |byte: u8| vec![byte; len];
            // A PLC's write request that fills the length, from address 0. `at` is the offset of the address.
            let write = |len: usize, at: usize, quantity: usize| {
                let mut data = vec![0; len];
                for (n, byte) in [(3, 4), (at + 3, quantity), (at + 4, len.saturating_sub(at + 5))] {
                    if let Some(place) = data.get_mut(n) {
                        *place = byte as u8;
                    }
                }
                data
            };
            let words = |len: usize, at: usize| len.saturating_sub(at + 5) / 2;
            let coils = (len.saturating_sub(5) * 8).min(255);
            // Counts that match a request one byte shorter.
            let one_too_long = |at: usize| {
                let shorter = len.saturating_sub(1);
                let mut data = write(shorter, at, words(shorter, at));
                data.resize(len, 0);
                data
            };
            let file = || {
                let count = len.saturating_sub(8) as u8 / 2;
                [vec![len.saturating_sub(1) as u8, 6, 0, 1, 0, 9, 0, count], fill(7)].concat()[..len].to_vec()
            };
            let identify = [&[14, 1, 0][..], &fill(0)].concat()[..len].to_vec();
            for data in [
                fill(0),
                fill(1),
                fill(0xFF),
                write(len, 0, words(len, 0)),
                write(len, 4, words(len, 4)),
                write(len, 0, coils),
                write(len, 0, coils.saturating_sub(3)),
                one_too_long(0),
                one_too_long(4),
                identify,
                file(),
            ] {
                let request = [&[code], &data[..]].concat();
                let mut plant = Plant::new();
                let answer = plant.ask(&request);
                match by_the_specification(&request) {
                    Err(exception) => {
                        assert_eq!(answer, [code | 0x80, exception], "{request:02X?}");
                        assert_eq!(plant.tables.take_written(), None, "{request:02X?} changes nothing");
                    }
                    Ok(length) => {
                        assert_eq!(answer[0], code, "{request:02X?}");
                        assert!(length == 0 || length == answer.len(), "{request:02X?}: {answer:02X?}");
                        answered[usize::from(code)] += 1;
                    }
                }
            }
        }
    }
    // Guards against a vacuous test: each supported function must have succeeded at least once.
    let served: Vec<u8> = (0..=255).filter(|code| answered[usize::from(*code)] > 0).collect();
    assert_eq!(served, [1, 2, 3, 4, 5, 6, 15, 16, 21, 22, 23, 43]);
}

#[test]
fn values_of_a_write_are_empty_at_length_0() {
    assert!(Bits::new(&[0xFF], 0).is_empty());
    assert!(!Bits::new(&[0xFF], 3).is_empty());
    assert_eq!(Bits::new(&[0xFF], 3).len(), 3);
    assert!(Words::new(&[]).is_empty());
    assert!(!Words::new(&[0, 1]).is_empty());
}
