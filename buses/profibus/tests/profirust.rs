//! Tests the slave against the master of `profirust` on a bus in virtual time. The bus panics if both send at once, or
//! if an answer starts earlier than 11 bit times after its request.

use bus_profibus::{
    Address, Baud, BaudSearch, Cause, Character, Event, MIN_TSDR_BITS, Profile, Slave, State, identifiers_fit,
};
use profirust::dp::{DpMaster, Peripheral, PeripheralEvent, PeripheralHandle, PeripheralOptions};
use profirust::fdl::{FdlActiveStation, ParametersBuilder};
use profirust::phy::{ProfibusPhy, SimulatorPhy};
use profirust::time::{Duration, Instant};
use profirust::{Baudrate, dp};

const STATION: u8 = 7;
const IDENT: u16 = 0x1234;
const OUTPUTS: usize = 8;
const INPUTS: usize = 12;
const CONFIG: [u8; 2] = [0xA7, 0x9B];
const _: () = assert!(identifiers_fit(&CONFIG, OUTPUTS, INPUTS));

static PROFILE: Profile = Profile {
    ident: IDENT,
    config: &CONFIG,
    sync: false,
    freeze: false,
    fail_safe: false,
    set_address: false,
};

type Station = Slave<OUTPUTS, INPUTS, 10>;

/// The slave with a UART that measures silences.
struct Device {
    slave: Station,
    phy: SimulatorPhy,
    rate: Baudrate,
    /// End of the last character.
    last_character: Instant,
    /// A pending answer with its earliest start.
    pending: Option<(Instant, Vec<u8>)>,
    /// Events for the application except outputs, which are counted.
    events: Vec<Event>,
    output_events: u32,
    received: u32,
    answers: u32,
    /// Damages every n-th character, and loses every n-th answer; 0 disables it.
    damage_every: u32,
    lose_every: u32,
}

impl Device {
    fn poll(&mut self, now: Instant) {
        let now_ms = u32::try_from(now.total_millis()).unwrap();
        if let Some(event) = self.slave.poll(now_ms) {
            self.on_event(event);
        }
        if self.phy.poll_transmission(now) {
            return;
        }
        for byte in self.phy.receive_data(now, |bytes| (bytes.len(), bytes.to_vec())) {
            self.receive(byte, now, now_ms);
        }
        if self.pending.as_ref().is_some_and(|(at, _)| now >= *at) {
            let (_, answer) = self.pending.take().unwrap();
            self.answers += 1;
            if !self.answers.is_multiple_of(self.lose_every) {
                self.phy.transmit_data(now, |buffer| {
                    buffer[..answer.len()].copy_from_slice(&answer);
                    (answer.len(), ())
                });
            }
        }
    }

    fn receive(&mut self, byte: u8, now: Instant, now_ms: u32) {
        let silence_bits = (self.rate.time_to_bits(now - self.last_character) as u32).saturating_sub(11);
        self.last_character = now;
        self.received += 1;
        let is_damaged = self.received.is_multiple_of(self.damage_every);
        let character = if is_damaged { Character::Damaged } else { Character::Byte(byte) };
        let Some(outcome) = self.slave.push(character, silence_bits, now_ms) else { return };
        if let Some(answer) = outcome.answer {
            assert!(answer.not_before_bits >= MIN_TSDR_BITS);
            // Times are whole microseconds, and the bus rounds down.
            let wait = self.rate.bits_to_time(answer.not_before_bits) + Duration::from_micros(1u64);
            self.pending = Some((now + wait, answer.bytes.to_vec()));
        }
        if let Some(event) = outcome.event {
            self.on_event(event);
        }
    }

    /// The application: returns the outputs as inputs, followed by the number of output events.
    fn on_event(&mut self, event: Event) {
        match event {
            Event::Outputs => self.output_events += 1,
            event => self.events.push(event),
        }
        let mut inputs = [0; INPUTS];
        inputs[..OUTPUTS].copy_from_slice(self.slave.outputs());
        inputs[OUTPUTS..].copy_from_slice(&self.output_events.to_be_bytes());
        self.slave.show_inputs(&inputs);
    }
}

struct Bus {
    device: Device,
    phy: SimulatorPhy,
    fdl: FdlActiveStation,
    master: DpMaster<'static>,
    station: PeripheralHandle,
    /// Events of the master about the station except exchanges, which are counted.
    events: Vec<PeripheralEvent>,
    exchanges: u32,
    now: Instant,
    step: Duration,
    master_is_on: bool,
}

/// The master's configuration of the station.
fn options() -> PeripheralOptions<'static> {
    PeripheralOptions {
        ident_number: IDENT,
        max_tsdr: 60,
        user_parameters: Some(&[]),
        config: Some(&CONFIG),
        ..Default::default()
    }
}

impl Bus {
    fn new(rate: Baudrate, options: PeripheralOptions<'static>) -> Self {
        let mut master = DpMaster::new(vec![]);
        let (inputs, outputs) = (vec![0; INPUTS], vec![0; OUTPUTS]);
        let peripheral = Peripheral::new(STATION, options, inputs, outputs).with_diag_buffer(vec![0; 64]);
        let station = master.add(peripheral);
        master.enter_operate();
        let parameters = ParametersBuilder::new(2, rate)
            .highest_station_address(10)
            .max_retry_limit(3)
            .watchdog_timeout(Duration::from_millis(500u64))
            .build_verified(&master);
        let mut fdl = FdlActiveStation::new(parameters);
        fdl.set_online();
        let phy = SimulatorPhy::new(rate, "master");
        let device = Device {
            slave: Station::new(&PROFILE, Address::new(STATION)),
            phy: phy.duplicate("slave"),
            rate,
            last_character: Instant::ZERO,
            pending: None,
            events: vec![],
            output_events: 0,
            received: 0,
            answers: 0,
            damage_every: 0,
            lose_every: 0,
        };
        // Two bit times, but at least the resolution of the clock.
        let step = rate.bits_to_time(2).max(Duration::from_micros(1u64));
        Self {
            device,
            phy,
            fdl,
            master,
            station,
            events: vec![],
            exchanges: 0,
            now: Instant::ZERO,
            step,
            master_is_on: true,
        }
    }

    fn turn(&mut self) {
        self.now += self.step;
        self.phy.set_bus_time(self.now);
        if self.master_is_on {
            self.fdl.poll(self.now, &mut self.phy, &mut self.master);
            if let Some((_, event)) = self.master.take_last_events().peripheral {
                match event {
                    PeripheralEvent::DataExchanged => self.exchanges += 1,
                    event => self.events.push(event),
                }
            }
        }
        self.device.poll(self.now);
    }

    fn run_for(&mut self, time_ms: u64) {
        let end = self.now + Duration::from_millis(time_ms);
        while self.now < end {
            self.turn();
        }
    }

    /// Runs until the condition holds. Panics if it does not within `within_ms`.
    fn run_until(&mut self, within_ms: u64, mut holds: impl FnMut(&mut Self) -> bool) {
        let end = self.now + Duration::from_millis(within_ms);
        while !holds(self) {
            assert!(self.now < end, "not within {within_ms} ms: {:?}, {:?}", self.events, self.device.events);
            self.turn();
        }
    }

    fn station(&mut self) -> &mut Peripheral<'static> {
        self.master.get_mut(self.station)
    }

    /// Runs until the master has completed `count` exchanges. Sends changing outputs, and checks the inputs that the master reads.
    fn exchange(&mut self, count: u32, within_ms: u64) {
        let (mut seen, end) = (self.exchanges, self.exchanges + count);
        let mut sent = [0; OUTPUTS];
        self.run_until(within_ms, |bus| {
            let exchanges = bus.exchanges;
            if exchanges != seen {
                seen = exchanges;
                let output_events = bus.device.output_events;
                let (inputs, outputs) = bus.station().pi_both();
                // Inputs date from before the exchange, so they match the previous outputs.
                assert_eq!(inputs[OUTPUTS..], (output_events - 1).to_be_bytes());
                if output_events > 1 && sent != [0; OUTPUTS] {
                    assert_eq!(inputs[..OUTPUTS], sent);
                }
                sent.copy_from_slice(outputs);
                outputs.copy_from_slice(
                    &(u64::from(seen).wrapping_mul(0x0123_4567_89AB_CDEF) | 1).to_be_bytes(),
                );
            }
            exchanges >= end
        });
    }
}

#[test]
fn ten_thousand_exchanges_are_each_applied_once() {
    let mut bus = Bus::new(Baudrate::B500000, options());
    bus.exchange(10_000, 60_000);
    assert_eq!(bus.device.output_events, bus.exchanges);
    assert_eq!(bus.device.slave.counters().damaged, 0);
    assert_eq!(bus.device.slave.master(), Some(2));
    assert!(bus.device.events.is_empty());
}

#[test]
fn exchanges_succeed_at_every_serial_port_rate() {
    for rate in [
        Baudrate::B9600,
        Baudrate::B19200,
        Baudrate::B45450,
        Baudrate::B93750,
        Baudrate::B187500,
        Baudrate::B1500000,
    ] {
        let mut bus = Bus::new(rate, options());
        bus.exchange(50, 20_000);
        assert_eq!(bus.device.output_events, bus.exchanges, "{rate:?}");
    }
}

#[test]
fn outputs_are_applied_once_despite_lost_answers() {
    let mut bus = Bus::new(Baudrate::B500000, options());
    bus.device.lose_every = 7;
    bus.exchange(2_000, 60_000);
    assert!(bus.device.answers > 2_300, "{} answers", bus.device.answers);
    assert_eq!(bus.device.output_events, bus.exchanges);
    assert!(bus.device.events.is_empty());
}

#[test]
fn damaged_characters_cause_retries_only() {
    let mut bus = Bus::new(Baudrate::B500000, options());
    // A prime number, so that the damage moves through the telegrams.
    bus.device.damage_every = 101;
    bus.exchange(2_000, 60_000);
    assert!(bus.device.slave.counters().damaged > 200);
    assert_eq!(bus.device.output_events, bus.exchanges);
    assert!(bus.device.events.is_empty());
}

#[test]
fn announced_diagnosis_is_read_and_exchange_continues() {
    let mut bus = Bus::new(Baudrate::B500000, options());
    bus.exchange(20, 5_000);
    let part = [10, 0x00, 0x10, 0, 0, 0, 0, 0, 0, 0];
    bus.device.slave.show_diagnosis(&part, true);
    bus.device.slave.announce_diagnosis();
    bus.run_until(1_000, |bus| bus.events.last() == Some(&PeripheralEvent::Diagnostics));
    let diagnosis = bus.station().last_diagnostics().unwrap();
    assert_eq!((diagnosis.ident_number, diagnosis.master_address), (IDENT, Some(2)));
    assert_eq!(diagnosis.flags, dp::DiagnosticFlags::EXT_DIAG | dp::DiagnosticFlags::WATCHDOG_ON);
    assert_eq!(diagnosis.extended_diagnostics.raw_diag_buffer(), Some(&part[..]));
    let reads = |bus: &Bus| bus.events.iter().filter(|it| **it == PeripheralEvent::Diagnostics).count();
    assert_eq!(reads(&bus), 1);
    bus.exchange(100, 5_000);
    assert_eq!(reads(&bus), 1, "read once");
}

#[test]
fn watchdog_ends_exchange_until_the_stopped_master_returns() {
    let mut bus = Bus::new(Baudrate::B500000, options());
    bus.exchange(20, 5_000);
    bus.master_is_on = false;
    bus.run_for(495);
    assert_eq!(bus.device.slave.state(), State::DataExch);
    bus.run_for(10);
    assert_eq!(bus.device.events.last(), Some(&Event::Left(Cause::Watchdog)));
    assert_eq!(bus.device.slave.outputs(), &[0; OUTPUTS]);
    bus.master_is_on = true;
    let before = bus.exchanges;
    bus.run_until(5_000, |bus| bus.exchanges > before + 20);
    assert_eq!(bus.device.slave.state(), State::DataExch);
}

#[test]
fn power_cycled_slave_is_parameterized_again() {
    let mut bus = Bus::new(Baudrate::B500000, options());
    bus.exchange(21, 5_000);
    bus.device.slave = Station::new(&PROFILE, Address::new(STATION));
    bus.device.pending = None;
    let before = bus.exchanges;
    bus.run_until(5_000, |bus| bus.exchanges > before + 20);
    assert_eq!(bus.device.slave.state(), State::DataExch);
}

#[test]
fn wrong_ident_number_or_configuration_is_reported_to_master() {
    let wrong_ident = PeripheralOptions { ident_number: 0x4321, ..options() };
    let wrong_config = PeripheralOptions { config: Some(&[0xA7, 0x9A]), ..options() };
    for (options, expected) in
        [(wrong_ident, PeripheralEvent::ParameterError), (wrong_config, PeripheralEvent::ConfigError)]
    {
        let mut bus = Bus::new(Baudrate::B500000, options);
        bus.run_until(2_000, |bus| bus.events.contains(&expected));
        assert_eq!((bus.exchanges, bus.device.events.len()), (0, 0));
        assert_ne!(bus.device.slave.state(), State::DataExch);
    }
}

/// A port at another rate than the bus receives only damaged characters.
#[test]
fn search_finds_the_rate_of_a_bus_with_only_a_master() {
    static RATES: [Baud; 3] = [Baud::K187_5, Baud::K500, Baud::M1_5];
    let mut bus = Bus::new(Baudrate::B500000, options());
    bus.device.damage_every = 1;
    let mut search = BaudSearch::new(&RATES, 0);
    while !search.is_found() {
        bus.turn();
        let now_ms = u32::try_from(bus.now.total_millis()).unwrap();
        assert!(now_ms < 1_000);
        if let Some(baud) = search.poll(now_ms, bus.device.slave.counters().telegrams) {
            bus.device.damage_every = u32::from(baud != Baud::K500);
        }
    }
    assert_eq!(search.baud(), Some(Baud::K500));
    bus.exchange(100, 5_000);
}
