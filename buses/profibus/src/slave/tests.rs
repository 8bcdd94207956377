//! Master and slave exchange telegrams in virtual time.

use super::*;
use std::vec;
use std::vec::Vec;

const STATION: u8 = 7;
const MASTER: u8 = 2;
const OTHER: u8 = 3;
const IDENT: u16 = 0x1234;
/// Eight bytes out, so that Data_Exchange can use SD3, and two bytes in.
const CONFIG: [u8; 2] = [0xA7, 0x11];
const _: () = assert!(crate::identifiers_fit(&CONFIG, 8, 2));

static PROFILE: Profile =
    Profile { ident: IDENT, config: &CONFIG, sync: true, freeze: true, fail_safe: true, set_address: true };
static PLAIN: Profile =
    Profile { sync: false, freeze: false, fail_safe: false, set_address: false, ..PROFILE };

const ADDRESS: Address = Address::new(STATION);
const INPUTS: [u8; 2] = [0xAA, 0xBB];
const OUT: [u8; 8] = [1, 2, 3, 4, 5, 6, 7, 8];
const NEXT: [u8; 8] = [9; 8];
const ZERO: [u8; 8] = [0; 8];

/// Function codes of requests: the first SRD of high priority, then with frame count bit 0 and 1.
const FIRST: u8 = 0x6D;
const FCB_0: u8 = 0x5D;
const FCB_1: u8 = 0x7D;
const SDN: u8 = 0x46;
const FDL_STATUS: u8 = 0x49;

const SET_SLAVE_ADDRESS: u8 = 55;
const RD_INP: u8 = 56;
const RD_OUTP: u8 = 57;
const GLOBAL_CONTROL: u8 = 58;
const GET_CFG: u8 = 59;
const SLAVE_DIAG: u8 = 60;
const SET_PRM: u8 = 61;
const CHK_CFG: u8 = 62;

fn sum(body: &[u8]) -> u8 {
    body.iter().fold(0, |sum, byte| sum.wrapping_add(*byte))
}

fn sd2(body: &[u8]) -> Vec<u8> {
    let len = body.len() as u8;
    [&[0x68, len, len, 0x68], body, &[sum(body), 0x16]].concat()
}

fn sd1(body: [u8; 3]) -> Vec<u8> {
    vec![0x10, body[0], body[1], body[2], sum(&body), 0x16]
}

fn sd3(source: u8, function_code: u8, data: [u8; 8]) -> Vec<u8> {
    let body = [&[STATION, source, function_code][..], &data].concat();
    [&[0xA2], &body[..], &[sum(&body), 0x16]].concat()
}

fn service(source: u8, function_code: u8, point: u8, data: &[u8]) -> Vec<u8> {
    sd2(&[&[STATION | 0x80, source | 0x80, function_code, point, 62], data].concat())
}

/// Returns the answer with data to a service.
fn data_of(master: u8, point: u8, data: &[u8]) -> Vec<u8> {
    sd2(&[&[master | 0x80, STATION | 0x80, 0x08, 62, point], data].concat())
}

fn inputs_answer(function_code: u8, inputs: [u8; 2]) -> Vec<u8> {
    sd2(&[&[MASTER, STATION, function_code][..], &inputs].concat())
}

const SC: [u8; 1] = [0xE5];

fn no_service(master: u8) -> Vec<u8> {
    sd1([master, STATION, 0x03])
}

/// Set_Prm: lock, watchdog of 100 ms, min T_SDR 11, groups 1 and 2.
const PARAMETERS: [u8; 7] = [0x88, 1, 10, 11, 0x12, 0x34, 0x03];

type Device = Slave<8, 2, 4>;

/// Sends a telegram after 33 bit times of silence.
fn send<'a, const O: usize, const I: usize, const D: usize>(
    slave: &'a mut Slave<O, I, D>,
    telegram: &[u8],
    now_ms: u32,
) -> (Option<Answer<'a>>, Option<Event>) {
    let (last, front) = telegram.split_last().unwrap();
    for (at, byte) in front.iter().enumerate() {
        let silence_bits = if at == 0 { 33 } else { 0 };
        assert_eq!(
            slave.push(Character::Byte(*byte), silence_bits, now_ms),
            None,
            "only the last byte completes the telegram"
        );
    }
    let silence_bits = if front.is_empty() { 33 } else { 0 };
    slave.push(Character::Byte(*last), silence_bits, now_ms).map_or((None, None), |it| (it.answer, it.event))
}

/// Returns the answer to a telegram.
fn answer_of<const O: usize, const I: usize, const D: usize>(
    slave: &mut Slave<O, I, D>,
    telegram: &[u8],
) -> Vec<u8> {
    send(slave, telegram, 0).0.unwrap().bytes.to_vec()
}

/// A bus with a slave, and a master that toggles its frame count bit.
struct Bus {
    slave: Device,
    now_ms: u32,
    fcb: bool,
    not_before_bits: u32,
}

impl Bus {
    fn new(profile: &'static Profile) -> Self {
        let mut slave = Device::new(profile, ADDRESS);
        slave.show_inputs(&INPUTS);
        Self { slave, now_ms: 1_000, fcb: true, not_before_bits: 0 }
    }

    /// Creates a slave in data exchange.
    fn exchanging(profile: &'static Profile) -> Self {
        let mut bus = Self::new(profile);
        bus.start(&PARAMETERS);
        bus
    }

    fn start(&mut self, parameters: &[u8]) {
        assert_eq!(self.ask(SET_PRM, parameters), (SC.to_vec(), None));
        assert_eq!(self.slave.state(), State::WaitCfg);
        assert_eq!(self.ask(CHK_CFG, &CONFIG), (SC.to_vec(), None));
        assert_eq!(self.slave.state(), State::DataExch);
    }

    /// Sends a telegram. Returns its answer and the event.
    fn send(&mut self, telegram: &[u8]) -> (Vec<u8>, Option<Event>) {
        let (answer, event) = send(&mut self.slave, telegram, self.now_ms);
        let Some(answer) = answer else { return (vec![], event) };
        self.not_before_bits = answer.not_before_bits;
        (answer.bytes.to_vec(), event)
    }

    /// Returns the function code of a new request.
    fn next(&mut self) -> u8 {
        self.fcb = !self.fcb;
        if self.fcb { FCB_1 } else { FCB_0 }
    }

    /// Sends a new request of the master.
    fn ask(&mut self, point: u8, data: &[u8]) -> (Vec<u8>, Option<Event>) {
        let function_code = self.next();
        self.send(&service(MASTER, function_code, point, data))
    }

    fn exchange(&mut self, outputs: [u8; 8]) -> (Vec<u8>, Option<Event>) {
        let function_code = self.next();
        self.send(&sd3(MASTER, function_code, outputs))
    }

    /// Returns the first three bytes of the diagnosis and the master's address, as read by another master.
    fn status(&mut self) -> [u8; 4] {
        let (answer, event) = self.send(&service(OTHER, FIRST, SLAVE_DIAG, &[]));
        assert_eq!(event, None);
        assert_eq!(answer[13..15], IDENT.to_be_bytes());
        answer[9..13].try_into().unwrap()
    }

    fn control(&mut self, command: u8, groups: u8) -> Option<Event> {
        self.control_from(MASTER, command, groups)
    }

    fn control_from(&mut self, source: u8, command: u8, groups: u8) -> Option<Event> {
        let telegram = sd2(&[0xFF, source | 0x80, SDN, GLOBAL_CONTROL, 62, command, groups]);
        let (answer, event) = self.send(&telegram);
        assert_eq!(answer, [], "broadcasts have no answer");
        event
    }

    fn is_out(&self, outputs: [u8; 8]) -> bool {
        *self.slave.outputs() == outputs
    }
}

#[test]
fn master_brings_a_slave_from_power_up_to_data_exchange() {
    let mut bus = Bus::new(&PROFILE);
    assert_eq!((bus.slave.state(), bus.slave.master()), (State::WaitPrm, None));
    assert_eq!(bus.status(), [0x02, 0x05, 0, 0xFF], "not ready, parameters required");

    let first = bus.send(&service(MASTER, FIRST, SLAVE_DIAG, &[]));
    assert_eq!(first, (data_of(MASTER, SLAVE_DIAG, &[0x02, 0x05, 0, 0xFF, 0x12, 0x34]), None));
    assert_eq!(bus.ask(SET_PRM, &PARAMETERS), (SC.to_vec(), None));
    assert_eq!((bus.slave.state(), bus.slave.master()), (State::WaitCfg, Some(MASTER)));
    assert_eq!(bus.status(), [0x02, 0x0C, 0, MASTER], "not ready, watchdog on");

    assert_eq!(bus.ask(CHK_CFG, &CONFIG), (SC.to_vec(), None));
    assert_eq!(bus.status(), [0x00, 0x0C, 0, MASTER]);
    assert_eq!(bus.exchange(OUT), (inputs_answer(0x08, INPUTS), Some(Event::Outputs)));
    assert!(bus.is_out(OUT));
}

#[test]
fn data_exchange_of_eight_bytes_is_accepted_as_sd3_and_as_sd2() {
    let mut bus = Bus::exchanging(&PROFILE);
    let function_code = bus.next();
    assert_eq!(bus.send(&sd3(MASTER, function_code, OUT)).1, Some(Event::Outputs));
    assert!(bus.is_out(OUT));
    let body = [&[STATION, MASTER, bus.next()][..], &NEXT].concat();
    assert_eq!(bus.send(&sd2(&body)), (inputs_answer(0x08, INPUTS), Some(Event::Outputs)));
    assert!(bus.is_out(NEXT));
}

#[test]
fn low_priority_is_served_like_high_priority() {
    let mut bus = Bus::exchanging(&PROFILE);
    let function_code = bus.next() - 1;
    assert_eq!(bus.send(&sd3(MASTER, function_code, OUT)).1, Some(Event::Outputs));
}

#[test]
fn outputs_are_accepted_only_from_the_master_in_data_exchange() {
    let mut bus = Bus::new(&PROFILE);
    assert_eq!(bus.exchange(OUT), (no_service(MASTER), None), "no parameters");
    bus.ask(SET_PRM, &PARAMETERS);
    assert_eq!(bus.exchange(OUT), (no_service(MASTER), None), "no configuration");
    bus.ask(CHK_CFG, &CONFIG);
    let other = bus.send(&sd3(OTHER, FIRST, OUT));
    assert_eq!(other, (no_service(OTHER), None), "another master");
    assert!(bus.is_out(ZERO));
    assert_eq!(bus.exchange(OUT).1, Some(Event::Outputs));
}

#[test]
fn outputs_of_another_length_end_data_exchange() {
    for len in [1, 7, 9] {
        let mut bus = Bus::exchanging(&PROFILE);
        bus.exchange(OUT);
        let body = [&[STATION, MASTER, bus.next()][..], &vec![1; len]].concat();
        assert_eq!(bus.send(&sd2(&body)), (no_service(MASTER), Some(Event::Left(Cause::OutputLength))));
        assert!(bus.is_out(ZERO));
        assert_eq!(bus.status(), [0x06, 0x05, 0, 0xFF], "{len}: wrong configuration");
        bus.start(&PARAMETERS);
        assert_eq!(bus.status(), [0x00, 0x0C, 0, MASTER], "fault cleared");
    }
}

#[test]
fn second_master_is_rejected_but_may_read() {
    let mut bus = Bus::exchanging(&PROFILE);
    bus.exchange(OUT);
    for (point, data) in
        [(SET_PRM, &PARAMETERS[..]), (SET_PRM, &[0x40, 0, 0, 0, 0x12, 0x34, 0]), (CHK_CFG, &[0])]
    {
        assert_eq!(bus.send(&service(OTHER, FIRST, point, data)), (no_service(OTHER), None), "{point}");
    }
    let no_lock = service(OTHER, FIRST, SET_PRM, &[0, 0, 0, 99, 0, 0, 0]);
    assert_eq!(bus.send(&no_lock), (no_service(OTHER), None));
    assert_eq!(bus.not_before_bits, 11);
    assert_eq!(bus.control_from(OTHER, 0x02, 0), None);
    assert_eq!((bus.slave.state(), bus.slave.master()), (State::DataExch, Some(MASTER)));
    assert!(bus.is_out(OUT));
    for (point, data) in [(RD_INP, &INPUTS[..]), (RD_OUTP, &OUT), (GET_CFG, &CONFIG)] {
        let answer = bus.send(&service(OTHER, FIRST, point, &[]));
        assert_eq!(answer, (data_of(OTHER, point, data), None), "{point}");
    }
}

#[test]
fn io_is_readable_only_in_exchange_and_configuration_always() {
    let mut bus = Bus::new(&PROFILE);
    for _ in 0..2 {
        assert_eq!(bus.ask(RD_INP, &[]), (no_service(MASTER), None));
        assert_eq!(bus.ask(RD_OUTP, &[]), (no_service(MASTER), None));
        assert_eq!(bus.ask(GET_CFG, &[]), (data_of(MASTER, GET_CFG, &CONFIG), None));
        bus.ask(SET_PRM, &PARAMETERS);
    }
    bus.ask(CHK_CFG, &CONFIG);
    assert_eq!(bus.ask(RD_INP, &[]), (data_of(MASTER, RD_INP, &INPUTS), None));
    assert_eq!(bus.ask(RD_OUTP, &[]), (data_of(MASTER, RD_OUTP, &ZERO), None));
    for point in [RD_INP, RD_OUTP, GET_CFG, SLAVE_DIAG] {
        assert_eq!(bus.ask(point, &[0]), (no_service(MASTER), None), "{point} with data");
    }
}

#[test]
fn unsupported_services_are_rejected() {
    let mut bus = Bus::exchanging(&PROFILE);
    for point in [0, 51, 54, GLOBAL_CONTROL, 63, 0x40 | SLAVE_DIAG] {
        assert_eq!(bus.ask(point, &[]), (no_service(MASTER), None), "{point}");
    }
    let from = |ssap| sd2(&[STATION | 0x80, MASTER | 0x80, FIRST, SLAVE_DIAG, ssap]);
    assert_eq!(bus.send(&from(50)).0, no_service(MASTER));
    let half = sd2(&[STATION | 0x80, MASTER, FIRST, SLAVE_DIAG]);
    assert_eq!(bus.send(&half).0, no_service(MASTER));
    for function_code in [0x43, 0x45, 0x4E, 0x4F] {
        let answer = bus.send(&sd1([STATION, MASTER, function_code]));
        assert_eq!(answer, (no_service(MASTER), None), "{function_code:02X}h");
    }
    assert_eq!(bus.slave.state(), State::DataExch);
}

#[test]
fn telegrams_for_other_stations_are_not_answered() {
    let mut bus = Bus::exchanging(&PROFILE);
    let other = STATION + 1;
    for telegram in [
        sd1([other, MASTER, FDL_STATUS]),
        sd1([127, MASTER, FDL_STATUS]),
        sd2(&[other | 0x80, MASTER | 0x80, FIRST, SLAVE_DIAG, 62]),
        sd2(&[0xFF, MASTER | 0x80, FIRST, SLAVE_DIAG, 62]),
        sd2(&[other | 0x80, MASTER | 0x80, SDN, GLOBAL_CONTROL, 62, 0x02, 0]),
        // From an invalid source.
        sd1([STATION, 127, FDL_STATUS]),
        // Answers, and telegrams that require none.
        sd1([STATION, MASTER, 0x09]),
        sd1([STATION, MASTER, 0x00]),
        sd1([STATION, MASTER, 0x47]),
        sd1([STATION, MASTER, 0xC9]),
        vec![0xDC, STATION, MASTER],
        vec![0xE5],
    ] {
        assert_eq!(bus.send(&telegram), (vec![], None), "{telegram:02X?}");
    }
}

#[test]
fn slave_responds_at_the_address_set_last() {
    let mut slave = Device::new(&PROFILE, ADDRESS);
    let other = Address::new(STATION + 1);
    slave.set_address(other);
    assert_eq!(slave.address(), other);
    assert_eq!(send(&mut slave, &sd1([STATION, MASTER, FDL_STATUS]), 0).0, None);
    let answer = answer_of(&mut slave, &sd1([STATION + 1, MASTER, FDL_STATUS]));
    assert_eq!(answer[..3], [0x10, MASTER, STATION + 1]);
}

#[test]
fn repeated_request_gets_the_same_answer_without_effect() {
    let mut bus = Bus::exchanging(&PROFILE);
    let function_code = bus.next();
    let telegram = sd3(MASTER, function_code, OUT);
    let answer = inputs_answer(0x08, INPUTS);
    assert_eq!(bus.send(&telegram), (answer.clone(), Some(Event::Outputs)));
    bus.slave.show_inputs(&[0, 0]);
    for _ in 0..3 {
        assert_eq!(bus.send(&telegram), (answer.clone(), None));
        // Newer outputs in a repetition are ignored.
        assert_eq!(bus.send(&sd3(MASTER, function_code, NEXT)), (answer.clone(), None));
    }
    assert!(bus.is_out(OUT));
    assert_eq!(bus.exchange(NEXT), (inputs_answer(0x08, [0, 0]), Some(Event::Outputs)));
    assert!(bus.is_out(NEXT));
}

#[test]
fn stored_answer_survives_fdl_status_and_unrelated_telegrams() {
    let mut bus = Bus::exchanging(&PROFILE);
    let function_code = bus.next();
    let telegram = sd3(MASTER, function_code, OUT);
    let answer = bus.send(&telegram).0;
    bus.slave.show_inputs(&[0, 0]);
    assert_eq!(bus.send(&sd1([STATION, MASTER, FDL_STATUS])).0, sd1([MASTER, STATION, 0]));
    assert_eq!(bus.send(&sd1([STATION, OTHER, FDL_STATUS])).0, sd1([OTHER, STATION, 0]));
    assert_eq!(bus.send(&sd1([STATION, MASTER, 0x4F])).0, no_service(MASTER));
    bus.send(&[0xDC, MASTER, MASTER]);
    bus.control(0, 0);
    bus.send(&sd1([STATION + 1, MASTER, FIRST]));
    assert_eq!(bus.send(&telegram), (answer, None));
}

#[test]
fn other_master_other_service_or_first_request_is_no_repetition() {
    let mut bus = Bus::exchanging(&PROFILE);
    let function_code = bus.next();
    assert_eq!(bus.send(&sd3(MASTER, function_code, OUT)).1, Some(Event::Outputs));
    // The master abandons the request and sends another one with the same bit.
    let diag = bus.send(&service(MASTER, function_code, SLAVE_DIAG, &[])).0;
    assert_eq!(diag[8], SLAVE_DIAG);
    assert_eq!(bus.send(&service(MASTER, function_code, SLAVE_DIAG, &[])).0, diag);
    let other = bus.send(&service(OTHER, function_code, SLAVE_DIAG, &[])).0;
    assert_eq!(other[4..6], [OTHER | 0x80, STATION | 0x80]);
    // First requests are marked as such and served each time.
    for _ in 0..2 {
        assert_eq!(bus.send(&sd3(MASTER, FIRST, NEXT)).1, Some(Event::Outputs));
    }
    assert_eq!(bus.send(&sd3(MASTER, FCB_1, OUT)).1, None, "a repetition of the first request");
    assert_eq!(bus.send(&sd3(MASTER, FCB_0, OUT)).1, Some(Event::Outputs), "the next request");
    // A request without a valid frame count bit.
    assert_eq!(bus.send(&sd3(MASTER, 0x4D, NEXT)).1, Some(Event::Outputs));
    assert_eq!(bus.send(&sd3(MASTER, FCB_0, OUT)).1, Some(Event::Outputs));
}

#[test]
fn repetition_after_the_watchdog_has_expired_is_rejected() {
    let mut bus = Bus::exchanging(&PROFILE);
    let function_code = bus.next();
    bus.send(&sd3(MASTER, function_code, OUT));
    bus.now_ms += 101;
    assert_eq!(bus.slave.poll(bus.now_ms), Some(Event::Left(Cause::Watchdog)));
    assert_eq!(bus.send(&sd3(MASTER, function_code, OUT)), (no_service(MASTER), None));
}

#[test]
fn watchdog_expires_after_its_time_and_not_at_it() {
    let mut bus = Bus::exchanging(&PROFILE);
    bus.exchange(OUT);
    let start_ms = bus.now_ms;
    assert_eq!(bus.slave.poll_timeout(start_ms), Some(101));
    assert_eq!(bus.slave.poll_timeout(start_ms + 100), Some(1));
    assert_eq!(bus.slave.poll(start_ms + 100), None);
    assert!(bus.is_out(OUT));
    assert_eq!(bus.slave.poll(start_ms + 101), Some(Event::Left(Cause::Watchdog)));
    assert!(bus.is_out(ZERO));
    assert_eq!((bus.slave.state(), bus.slave.master()), (State::WaitPrm, None));
    assert_eq!(bus.slave.poll(start_ms + 10_000), None, "reported once");
    assert_eq!(bus.slave.poll_timeout(start_ms + 10_000), None);
    assert_eq!(bus.status(), [0x02, 0x05, 0, 0xFF]);
}

#[test]
fn watchdog_is_wd_fact_1_times_wd_fact_2_times_10_ms() {
    for (factors, time_ms) in [([1, 1], 10), ([3, 7], 210), ([255, 255], 650_250)] {
        let mut bus = Bus::new(&PROFILE);
        bus.now_ms = u32::MAX - 5;
        bus.start(&[0x88, factors[0], factors[1], 11, 0x12, 0x34, 0]);
        assert_eq!(bus.slave.poll(bus.now_ms.wrapping_add(time_ms)), None, "{factors:?}");
        assert!(bus.slave.poll(bus.now_ms.wrapping_add(time_ms + 1)).is_some(), "{factors:?}");
    }
    let mut bus = Bus::new(&PROFILE);
    bus.start(&[0x80, 1, 1, 11, 0x12, 0x34, 0]);
    assert_eq!(bus.status(), [0x00, 0x04, 0, MASTER], "watchdog off");
    assert_eq!(bus.slave.poll(bus.now_ms + 0x7FFF_FFFF), None);
    assert_eq!(bus.slave.state(), State::DataExch);
}

#[test]
fn only_requests_of_the_master_restart_the_watchdog() {
    // The last one is a repetition.
    let restarts = [
        sd3(MASTER, FCB_0, OUT),
        service(MASTER, FCB_0, SLAVE_DIAG, &[]),
        service(MASTER, FCB_0, CHK_CFG, &CONFIG),
        service(MASTER, FCB_1, CHK_CFG, &CONFIG),
    ];
    let others = [
        sd2(&[0xFF, MASTER | 0x80, SDN, GLOBAL_CONTROL, 62, 0, 0]),
        sd1([STATION, MASTER, FDL_STATUS]),
        service(OTHER, FIRST, SLAVE_DIAG, &[]),
        sd3(OTHER, FIRST, OUT),
    ];
    let restarts = restarts.into_iter().map(|telegram| (telegram, 100));
    for (telegram, left_ms) in restarts.chain(others.into_iter().map(|telegram| (telegram, 40))) {
        let mut bus = Bus::exchanging(&PROFILE);
        bus.now_ms += 60;
        bus.send(&telegram);
        assert_eq!(bus.slave.poll(bus.now_ms + left_ms), None, "{telegram:02X?}");
        assert!(bus.slave.poll(bus.now_ms + left_ms + 1).is_some(), "{telegram:02X?}");
    }
}

#[test]
fn telegram_after_the_watchdog_time_is_not_answered() {
    let mut bus = Bus::exchanging(&PROFILE);
    bus.exchange(OUT);
    bus.now_ms += 101;
    assert_eq!(bus.exchange(NEXT), (vec![], Some(Event::Left(Cause::Watchdog))));
    assert!(bus.is_out(ZERO));
    assert_eq!(bus.exchange(NEXT), (no_service(MASTER), None), "the next telegram is answered");
}

#[test]
fn watchdog_also_ends_the_wait_for_a_configuration() {
    let mut bus = Bus::new(&PROFILE);
    bus.ask(SET_PRM, &PARAMETERS);
    bus.now_ms += 101;
    assert_eq!(bus.ask(CHK_CFG, &CONFIG), (vec![], None), "no data exchange to leave");
    assert_eq!(bus.slave.state(), State::WaitPrm);
    assert_eq!(bus.ask(CHK_CFG, &CONFIG), (SC.to_vec(), None));
    assert_eq!(bus.status(), [0x02, 0x05, 0, 0xFF], "parameters required");
}

#[test]
fn wrong_parameters_are_acknowledged_rejected_and_reported() {
    let prm_fault = [0x42, 0x05, 0, 0xFF];
    let not_supported = [0x12, 0x05, 0, 0xFF];
    for (what, parameters, expected) in [
        ("too short", &PARAMETERS[..6], prm_fault),
        ("none", &[], prm_fault),
        ("ident, low", &[0x88, 1, 10, 11, 0x12, 0x35, 0], prm_fault),
        ("ident, high", &[0x88, 1, 10, 11, 0x13, 0x34, 0], prm_fault),
        ("watchdog of 0", &[0x88, 0, 10, 11, 0x12, 0x34, 0], prm_fault),
        ("watchdog of 0", &[0x88, 10, 0, 11, 0x12, 0x34, 0], prm_fault),
        ("a user parameter", &[0x88, 1, 10, 11, 0x12, 0x34, 0, 0], prm_fault),
        ("DP-V1", &[0x88, 1, 10, 11, 0x12, 0x34, 0, 0x80, 0, 0], prm_fault),
        ("DP-V1", &[0x88, 1, 10, 11, 0x12, 0x34, 0, 0, 1, 0], prm_fault),
        ("DP-V1", &[0x88, 1, 10, 11, 0x12, 0x34, 0, 0, 0, 1], prm_fault),
        ("four", &[0x88, 1, 10, 11, 0x12, 0x34, 0, 0, 0, 0, 0], prm_fault),
        ("reserved", &[0x89, 1, 10, 11, 0x12, 0x34, 0], not_supported),
        ("reserved", &[0x8C, 1, 10, 11, 0x12, 0x34, 0], not_supported),
        ("Sync", &[0xA8, 1, 10, 11, 0x12, 0x34, 0], not_supported),
        ("Freeze", &[0x98, 1, 10, 11, 0x12, 0x34, 0], not_supported),
        ("Fail_Safe", &[0x88, 1, 10, 11, 0x12, 0x34, 0, 0x40, 0, 0], prm_fault),
    ] {
        let mut bus = Bus::new(&PLAIN);
        assert_eq!(bus.ask(SET_PRM, parameters), (SC.to_vec(), None), "{what}");
        assert_eq!(bus.status(), expected, "{what}: {parameters:02X?}");

        let mut bus = Bus::exchanging(&PLAIN);
        bus.exchange(OUT);
        let reported = Some(Event::Left(Cause::Parameters));
        assert_eq!(bus.ask(SET_PRM, parameters), (SC.to_vec(), reported), "{what}");
        assert_eq!(bus.status(), expected, "{what}, from data exchange");
        assert!(bus.is_out(ZERO));
        bus.start(&PARAMETERS);
        assert_eq!(bus.status(), [0x00, 0x0C, 0, MASTER], "fault cleared");
    }
}

#[test]
fn dp_v1_master_parameters_are_accepted_without_dp_v1_requests() {
    let parameters = |status_1| [&PARAMETERS[..], &[status_1, 0, 0]].concat();
    Bus::new(&PLAIN).start(&parameters(0));
    Bus::new(&PROFILE).start(&parameters(0));
    Bus::new(&PROFILE).start(&parameters(0x40));
}

#[test]
fn repeated_parameters_end_data_exchange_and_start_again() {
    let mut bus = Bus::exchanging(&PROFILE);
    bus.exchange(OUT);
    assert_eq!(bus.ask(SET_PRM, &PARAMETERS), (SC.to_vec(), Some(Event::Left(Cause::Parameters))));
    assert_eq!(bus.slave.state(), State::WaitCfg);
    assert!(bus.is_out(ZERO));
    assert_eq!(bus.ask(SET_PRM, &PARAMETERS), (SC.to_vec(), None));
}

#[test]
fn unlock_releases_the_slave_for_another_master() {
    for status in [0x40, 0xC0] {
        let mut bus = Bus::exchanging(&PROFILE);
        bus.exchange(OUT);
        let unlock = [status, 0, 0, 0, 0x12, 0x34, 0];
        assert_eq!(bus.ask(SET_PRM, &unlock), (SC.to_vec(), Some(Event::Left(Cause::Unlocked))));
        assert!(bus.is_out(ZERO));
        assert_eq!(bus.status(), [0x02, 0x05, 0, 0xFF]);
        assert_eq!(bus.send(&service(OTHER, FIRST, SET_PRM, &PARAMETERS)).0, SC);
        assert_eq!(bus.slave.master(), Some(OTHER));
    }
    let mut bus = Bus::exchanging(&PROFILE);
    let of_another_kind = [0x40, 0, 0, 0, 0x12, 0x35, 0];
    assert_eq!(bus.ask(SET_PRM, &of_another_kind).1, Some(Event::Left(Cause::Parameters)));
    assert_eq!(bus.status(), [0x42, 0x05, 0, 0xFF]);
}

#[test]
fn min_tsdr_follows_the_parameters_but_is_at_least_11() {
    for (asked, expected) in [(0, 11), (1, 11), (11, 11), (12, 12), (255, 255)] {
        let mut bus = Bus::new(&PROFILE);
        bus.ask(SET_PRM, &[0x88, 1, 10, asked, 0x12, 0x34, 0]);
        assert_eq!(bus.not_before_bits, expected, "{asked}");
        bus.send(&sd1([STATION, MASTER, FDL_STATUS]));
        assert_eq!(bus.not_before_bits, expected, "{asked}");
    }
}

#[test]
fn set_prm_without_lock_changes_only_min_tsdr() {
    let mut bus = Bus::new(&PROFILE);
    // The ident number does not matter.
    assert_eq!(bus.ask(SET_PRM, &[0, 1, 1, 40, 0, 0, 0]), (SC.to_vec(), None));
    assert_eq!((bus.not_before_bits, bus.slave.state()), (40, State::WaitPrm));
    bus.start(&[0x88, 1, 10, 0, 0x12, 0x34, 0]);
    assert_eq!(bus.not_before_bits, 40, "0 leaves it unchanged");
    bus.exchange(OUT);
    assert_eq!(bus.ask(SET_PRM, &[0, 0, 0, 50, 0, 0, 0]), (SC.to_vec(), None));
    assert_eq!((bus.not_before_bits, bus.slave.state()), (50, State::DataExch));
    assert!(bus.is_out(OUT));
}

#[test]
fn configuration_must_match_the_device() {
    for config in [&[][..], &CONFIG[..1], &[0x11, 0xA7], &[0xA7, 0x11, 0x00], &[0xA7, 0x10]] {
        let mut bus = Bus::new(&PROFILE);
        assert_eq!(bus.ask(CHK_CFG, config), (SC.to_vec(), None), "before parameters");
        assert_eq!(bus.status(), [0x02, 0x05, 0, 0xFF], "without effect");
        bus.ask(SET_PRM, &PARAMETERS);
        assert_eq!(bus.ask(CHK_CFG, config), (SC.to_vec(), None), "{config:02X?}");
        assert_eq!(bus.status(), [0x06, 0x05, 0, 0xFF], "{config:02X?}");
        bus.start(&PARAMETERS);
        bus.exchange(OUT);
        assert_eq!(bus.ask(CHK_CFG, &CONFIG), (SC.to_vec(), None), "repeated");
        assert_eq!(bus.slave.state(), State::DataExch);
        assert!(bus.is_out(OUT));
        let reported = Some(Event::Left(Cause::Configuration));
        assert_eq!(bus.ask(CHK_CFG, config), (SC.to_vec(), reported));
        assert_eq!(bus.status(), [0x06, 0x05, 0, 0xFF]);
        assert!(bus.is_out(ZERO));
    }
}

#[test]
fn clear_sets_the_outputs_to_0_until_the_next_data_exchange() {
    let mut bus = Bus::exchanging(&PROFILE);
    bus.exchange(OUT);
    assert_eq!(bus.control(0x02, 0), Some(Event::Cleared));
    assert!(bus.is_out(ZERO));
    assert_eq!(bus.control(0x02, 0), Some(Event::Cleared), "reported each time");
    assert_eq!(bus.exchange(OUT), (inputs_answer(0x08, INPUTS), Some(Event::Outputs)));
    assert!(bus.is_out(OUT));
    assert_eq!(bus.control(0x00, 0), None, "operating mode Operate");
    assert!(bus.is_out(OUT));
}

#[test]
fn empty_data_exchange_clears_the_outputs_only_with_fail_safe() {
    let mut bus = Bus::exchanging(&PROFILE);
    bus.exchange(OUT);
    let function_code = bus.next();
    let nothing = sd1([STATION, MASTER, function_code]);
    assert_eq!(bus.send(&nothing), (inputs_answer(0x08, INPUTS), Some(Event::Cleared)));
    assert!(bus.is_out(ZERO));
    assert_eq!(bus.exchange(OUT).1, Some(Event::Outputs));

    let mut bus = Bus::exchanging(&PLAIN);
    bus.exchange(OUT);
    let function_code = bus.next();
    let answer = bus.send(&sd1([STATION, MASTER, function_code]));
    assert_eq!(answer, (no_service(MASTER), Some(Event::Left(Cause::OutputLength))));
}

#[test]
fn global_control_applies_to_all_or_to_the_selected_groups() {
    let mut bus = Bus::exchanging(&PROFILE);
    for (groups, expected) in [(0x00, true), (0x01, true), (0x02, true), (0xFC, false), (0xFF, true)] {
        bus.exchange(OUT);
        let reported = bus.control(0x02, groups);
        assert_eq!(reported, expected.then_some(Event::Cleared), "{groups:02X}h");
        assert_eq!(bus.is_out(ZERO), expected, "{groups:02X}h");
    }
}

#[test]
fn global_control_acts_only_in_data_exchange_on_this_station() {
    let mut bus = Bus::new(&PROFILE);
    assert_eq!(bus.control(0x02, 0), None);
    bus.ask(SET_PRM, &PARAMETERS);
    assert_eq!(bus.control(0x02, 0), None);
    bus.ask(CHK_CFG, &CONFIG);
    let mine = sd2(&[STATION | 0x80, MASTER | 0x80, SDN, GLOBAL_CONTROL, 62, 0x02, 0]);
    assert_eq!(bus.send(&mine), (vec![], Some(Event::Cleared)));
    let low = sd2(&[0xFF, MASTER | 0x80, 0x44, GLOBAL_CONTROL, 62, 0x02, 0]);
    assert_eq!(bus.send(&low), (vec![], Some(Event::Cleared)));
    for telegram in [
        sd2(&[0xFF, MASTER | 0x80, SDN, GLOBAL_CONTROL, 62, 0x02]),
        sd2(&[0xFF, MASTER | 0x80, SDN, GLOBAL_CONTROL, 62, 0x02, 0, 0]),
        sd2(&[0xFF, MASTER | 0x80, SDN, GLOBAL_CONTROL, 61, 0x02, 0]),
        sd2(&[0xFF, MASTER | 0x80, SDN, SLAVE_DIAG, 62, 0x02, 0]),
        sd2(&[0x7F, MASTER, SDN, 0x02, 0]),
    ] {
        assert_eq!(bus.send(&telegram), (vec![], None), "{telegram:02X?}");
    }
}

/// Parameters with Sync_Req and Freeze_Req.
const BOTH_MODES: [u8; 7] = [0xB8, 1, 10, 11, 0x12, 0x34, 0];

#[test]
fn outputs_wait_for_the_next_sync_until_unsync() {
    let mut bus = Bus::new(&PROFILE);
    bus.start(&BOTH_MODES);
    bus.exchange(OUT);
    assert_eq!(bus.control(0x20, 0), None, "no outputs are waiting");
    assert_eq!(bus.status()[1], 0x2C, "Sync_Mode");
    assert_eq!(bus.exchange(NEXT), (inputs_answer(0x08, INPUTS), None));
    assert!(bus.is_out(OUT));
    assert_eq!(bus.ask(RD_OUTP, &[]).0, data_of(MASTER, RD_OUTP, &OUT), "outputs in effect");
    assert_eq!(bus.control(0x20, 0), Some(Event::Outputs));
    assert!(bus.is_out(NEXT));
    bus.exchange(OUT);
    assert!(bus.is_out(NEXT));
    assert_eq!(bus.control(0x30, 0), Some(Event::Outputs), "Unsync takes precedence");
    assert!(bus.is_out(OUT));
    assert_eq!(bus.status()[1], 0x0C);
    assert_eq!(bus.exchange(NEXT).1, Some(Event::Outputs));
    assert_eq!(bus.control(0x10, 0), None, "no outputs are waiting");
    assert!(bus.is_out(NEXT));
}

#[test]
fn clear_takes_effect_in_sync_mode_and_discards_waiting_outputs() {
    let mut bus = Bus::new(&PROFILE);
    bus.start(&BOTH_MODES);
    bus.exchange(OUT);
    bus.control(0x20, 0);
    bus.exchange(NEXT);
    assert_eq!(bus.control(0x22, 0), Some(Event::Cleared));
    assert!(bus.is_out(ZERO));
    assert_eq!(bus.status()[1], 0x2C, "Sync mode stays on");
    assert_eq!(bus.control(0x20, 0), Some(Event::Outputs));
    assert!(bus.is_out(ZERO));
}

#[test]
fn inputs_are_frozen_until_the_next_freeze_or_unfreeze() {
    let mut bus = Bus::new(&PROFILE);
    bus.start(&BOTH_MODES);
    assert_eq!(bus.control(0x08, 0), None);
    assert_eq!(bus.status()[1], 0x1C, "Freeze_Mode");
    bus.slave.show_inputs(&[1, 1]);
    assert_eq!(bus.exchange(OUT).0, inputs_answer(0x08, INPUTS));
    assert_eq!(bus.ask(RD_INP, &[]).0, data_of(MASTER, RD_INP, &INPUTS));
    bus.control(0x08, 0);
    bus.slave.show_inputs(&[2, 2]);
    assert_eq!(bus.exchange(OUT).0, inputs_answer(0x08, [1, 1]));
    bus.control(0x0C, 0);
    assert_eq!(bus.exchange(OUT).0, inputs_answer(0x08, [2, 2]), "Unfreeze takes precedence");
    assert_eq!(bus.status()[1], 0x0C);
}

#[test]
fn sync_and_freeze_require_their_parameters() {
    let mut bus = Bus::exchanging(&PROFILE);
    bus.control(0x28, 0);
    assert_eq!(bus.status()[1], 0x0C);
    bus.slave.show_inputs(&[1, 1]);
    assert_eq!(bus.exchange(OUT), (inputs_answer(0x08, [1, 1]), Some(Event::Outputs)));
    assert!(bus.is_out(OUT));
}

#[test]
fn modes_end_with_data_exchange() {
    let mut bus = Bus::new(&PROFILE);
    bus.start(&BOTH_MODES);
    bus.exchange(OUT);
    bus.control(0x28, 0);
    bus.exchange(NEXT);
    bus.slave.show_inputs(&[1, 1]);
    bus.ask(SET_PRM, &BOTH_MODES);
    bus.ask(CHK_CFG, &CONFIG);
    assert_eq!(bus.status()[1], 0x0C);
    assert!(bus.is_out(ZERO), "waiting outputs are discarded");
    assert_eq!(bus.exchange(OUT), (inputs_answer(0x08, [1, 1]), Some(Event::Outputs)));
    assert!(bus.is_out(OUT));
}

#[test]
fn announced_diagnosis_has_high_priority_until_master_reads_it() {
    let mut bus = Bus::exchanging(&PROFILE);
    bus.slave.show_diagnosis(&[4, 0x10, 0, 0], true);
    assert_eq!(bus.exchange(OUT).0, inputs_answer(0x08, INPUTS), "not announced yet");
    bus.slave.announce_diagnosis();
    for _ in 0..2 {
        assert_eq!(bus.exchange(OUT).0, inputs_answer(0x0A, INPUTS));
        assert_eq!(bus.status()[0], 0x08, "a read by another master does not count");
    }
    let expected = [0x08, 0x0C, 0, MASTER, 0x12, 0x34, 4, 0x10, 0, 0];
    assert_eq!(bus.ask(SLAVE_DIAG, &[]).0, data_of(MASTER, SLAVE_DIAG, &expected));
    assert_eq!(bus.exchange(OUT).0, inputs_answer(0x08, INPUTS));
    bus.slave.show_diagnosis(&[2, 0], false);
    let expected = [0x00, 0x0C, 0, MASTER, 0x12, 0x34, 2, 0];
    assert_eq!(bus.ask(SLAVE_DIAG, &[]).0, data_of(MASTER, SLAVE_DIAG, &expected), "a status");
}

#[test]
fn diagnosis_has_at_least_six_bytes_and_reports_truncation() {
    let mut bus = Bus::exchanging(&PROFILE);
    assert_eq!(bus.ask(SLAVE_DIAG, &[]).0.len(), 4 + 5 + 6 + 2);
    bus.slave.show_diagnosis(&[1, 2, 3, 4, 5], true);
    let expected = [0x08, 0x0C, 0x80, MASTER, 0x12, 0x34, 1, 2, 3, 4];
    assert_eq!(bus.ask(SLAVE_DIAG, &[]).0, data_of(MASTER, SLAVE_DIAG, &expected));
    bus.slave.show_diagnosis(&[1, 2, 3, 4], true);
    assert_eq!(bus.status(), [0x08, 0x0C, 0, MASTER]);
}

#[test]
fn master_can_change_the_address_before_it_sends_parameters() {
    let mut bus = Bus::new(&PROFILE);
    let reported = Some(Event::Address(Address { station: 9, locked: false }));
    assert_eq!(bus.ask(SET_SLAVE_ADDRESS, &[9, 0x12, 0x34, 0]), (SC.to_vec(), reported));
    assert_eq!(bus.slave.address(), Address::new(9));
    assert_eq!(bus.send(&sd1([STATION, MASTER, FDL_STATUS])).0, []);
    assert_eq!(bus.send(&sd1([9, MASTER, FDL_STATUS])).0, sd1([MASTER, 9, 0]));
    // Back to the first address, with extra bytes for the device to store, and locked.
    let back =
        [&[0x89, 0x82, bus.next(), SET_SLAVE_ADDRESS, 62][..], &[STATION, 0x12, 0x34, 1, 5, 6]].concat();
    let reported = Some(Event::Address(Address { station: STATION, locked: true }));
    assert_eq!(bus.send(&sd2(&back)), (SC.to_vec(), reported));
    assert_eq!(bus.ask(SET_SLAVE_ADDRESS, &[9, 0x12, 0x34, 0]), (no_service(MASTER), None), "locked");
}

#[test]
fn invalid_address_changes_are_rejected() {
    for data in [&[9, 0x12, 0x35, 0][..], &[9, 0x13, 0x34, 0], &[126, 0x12, 0x34, 0], &[9, 0x12, 0x34], &[]] {
        let mut bus = Bus::new(&PROFILE);
        assert_eq!(bus.ask(SET_SLAVE_ADDRESS, data), (no_service(MASTER), None), "{data:02X?}");
        assert_eq!(bus.slave.address(), ADDRESS);
    }
    let right = [125, 0x12, 0x34, 0];
    assert_eq!(Bus::new(&PLAIN).ask(SET_SLAVE_ADDRESS, &right), (no_service(MASTER), None), "not supported");
    assert_eq!(
        Bus::exchanging(&PROFILE).ask(SET_SLAVE_ADDRESS, &right),
        (no_service(MASTER), None),
        "locked by a master"
    );
    assert_eq!(Bus::new(&PROFILE).ask(SET_SLAVE_ADDRESS, &right).0, SC);
    let mut locked = Bus::new(&PROFILE);
    locked.slave = Device::new(&PROFILE, Address { station: STATION, locked: true });
    assert_eq!(
        locked.ask(SET_SLAVE_ADDRESS, &right),
        (no_service(MASTER), None),
        "address locked from the start"
    );
}

#[test]
fn slave_without_inputs_acknowledges_and_announces_diagnosis() {
    static OUTPUTS_ONLY: Profile = Profile { config: &[0x20], ..PROFILE };
    let mut slave = Slave::<1, 0, 0>::new(&OUTPUTS_ONLY, ADDRESS);
    assert_eq!(answer_of(&mut slave, &service(MASTER, FIRST, SET_PRM, &PARAMETERS)), SC);
    assert_eq!(answer_of(&mut slave, &service(MASTER, FCB_0, CHK_CFG, &[0x20])), SC);
    assert_eq!(answer_of(&mut slave, &sd2(&[STATION, MASTER, FCB_1, 0x55])), SC);
    slave.announce_diagnosis();
    let answer = answer_of(&mut slave, &sd2(&[STATION, MASTER, FCB_0, 0x55]));
    assert_eq!(answer, sd1([MASTER, STATION, 0x0A]));
}

#[test]
fn longest_outputs_inputs_and_diagnosis_fit_into_a_telegram() {
    static LARGE: Profile = Profile { config: &[0x7F], ..PROFILE };
    let mut slave = Slave::<244, 244, 238>::new(&LARGE, ADDRESS);
    slave.show_inputs(&[0x33; 244]);
    slave.show_diagnosis(&[0x44; 238], true);
    answer_of(&mut slave, &service(MASTER, FIRST, SET_PRM, &PARAMETERS));
    answer_of(&mut slave, &service(MASTER, FCB_0, CHK_CFG, &[0x7F]));
    let outputs = sd2(&[&[STATION, MASTER, FCB_1][..], &[0x22; 244]].concat());
    let inputs = sd2(&[&[MASTER, STATION, 0x08][..], &[0x33; 244]].concat());
    assert_eq!(answer_of(&mut slave, &outputs), inputs);
    let data = data_of(MASTER, RD_INP, &[0x33; 244]);
    assert_eq!(data.len(), MAX_TELEGRAM_LEN);
    assert_eq!(answer_of(&mut slave, &service(MASTER, FCB_0, RD_INP, &[])), data);
    let data = data_of(MASTER, RD_OUTP, &[0x22; 244]);
    assert_eq!(answer_of(&mut slave, &service(MASTER, FCB_1, RD_OUTP, &[])), data);
    let diagnosis = answer_of(&mut slave, &service(MASTER, FCB_0, SLAVE_DIAG, &[]));
    assert_eq!(diagnosis[15..253], [0x44; 238], "{diagnosis:02X?}");
}

#[test]
fn identifiers_are_added_up_over_all_modules() {
    use crate::identifiers_fit;
    assert!(identifiers_fit(&[], 0, 0));
    // 16 bytes out; 2 words in; 1 byte in and out.
    assert!(identifiers_fit(&[0x2F, 0x51, 0x30], 17, 5));
    assert!(!identifiers_fit(&[0x2F, 0x51, 0x30], 16, 5));
    assert!(!identifiers_fit(&[0x2F, 0x51, 0x30], 17, 4));
    // The special format.
    assert!(!identifiers_fit(&[0x40, 0x00], 1, 0));
    assert!(!identifiers_fit(&[0x00], 0, 0));
}
