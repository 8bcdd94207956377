//! The bridge on a bus with the master of `profirust`, in virtual time. The bus panics if two stations send at once, or if a
//! response starts earlier than 11 bit times after its request.

use bus_profibus::Character;
use host_tests::world::profibus::{AT_500K, STATION};
use host_tests::world::{World, quick};
use profirust::Baudrate;
use profirust::dp::{DpMaster, Peripheral, PeripheralHandle, PeripheralOptions};
use profirust::fdl::{FdlActiveStation, ParametersBuilder};
use profirust::phy::{ProfibusPhy, SimulatorPhy};
use profirust::time::{Duration, Instant};
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::plc::UartStatus;
use wsg_bridge_fw::{Config, ProfibusConfig};
use wsg_fieldbus::profibus::PROFILE;
use wsg_fieldbus::{CommandFlags as Flag, GripperFlags as Shown, InputImage, OutputImage};
use wsg_protocol::{CommandId, Status};
use wsg_sim::Part;

const BEHIND_IT: UartStatus = UartStatus { received: None, has_room: true, is_complete: true };

/// The bridge with a timed UART.
struct Device {
    world: World,
    phy: SimulatorPhy,
    /// Time at which the handler's timer expires.
    due: Option<Instant>,
    /// The handler has not finished its response.
    is_sending: bool,
}

impl Device {
    fn poll(&mut self, now: Instant) {
        let now_us = u32::try_from(now.total_micros()).unwrap();
        while self.world.now_ms() < now_us / 1_000 {
            self.world.step();
            if !self.is_sending {
                let action = self.world.interrupt(BEHIND_IT, now_us);
                self.send(action.send, now, now_us);
            }
        }
        if self.phy.poll_transmission(now) {
            return;
        }
        if std::mem::take(&mut self.is_sending) {
            assert_eq!(self.world.interrupt(BEHIND_IT, now_us).send, None, "the response is complete");
        }
        for byte in self.phy.receive_data(now, |bytes| (bytes.len(), bytes.to_vec())) {
            let received = Some(Character::Byte(byte));
            let action = self.world.interrupt(UartStatus { received, ..BEHIND_IT }, now_us);
            assert_eq!(action.send, None);
            self.due = action.wait_us.map(|us| now + Duration::from_micros(u64::from(us)));
        }
        if self.due.is_some_and(|due| now >= due) {
            self.due = None;
            let action = self.world.interrupt(BEHIND_IT, now_us);
            self.send(action.send, now, now_us);
        }
    }

    /// Passes a complete response to the bus, without pauses.
    fn send(&mut self, first: Option<u8>, now: Instant, now_us: u32) {
        let Some(first) = first else { return };
        let mut answer = vec![first];
        let room = UartStatus { has_room: true, is_complete: false, received: None };
        while let Some(byte) = self.world.interrupt(room, now_us).send {
            answer.push(byte);
        }
        self.is_sending = true;
        self.phy.transmit_data(now, |buffer| {
            buffer[..answer.len()].copy_from_slice(&answer);
            (answer.len(), ())
        });
    }
}

struct Bus {
    device: Device,
    phy: SimulatorPhy,
    fdl: FdlActiveStation,
    master: DpMaster<'static>,
    gripper: PeripheralHandle,
    image: OutputImage,
    exchanges: u32,
    now: Instant,
    step: Duration,
}

impl Bus {
    fn new(rate: Baudrate, config: Config, gripper: wsg_sim::Config) -> Self {
        let options = PeripheralOptions {
            ident_number: PROFILE.ident,
            max_tsdr: 60,
            user_parameters: Some(&[]),
            config: Some(PROFILE.config),
            ..Default::default()
        };
        let mut master = DpMaster::new(vec![]);
        let (inputs, outputs) = (vec![0; InputImage::LEN], vec![0; OutputImage::LEN]);
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
        let mut world = World::new(config, gripper);
        world.set(Inputs::FAST_STOP_OK, true);
        world.interrupt(BEHIND_IT, 0);
        let device = Device { world, phy: phy.duplicate("bridge"), due: None, is_sending: false };
        let image = OutputImage { width: 20_00, speed: 100_00, force_limit: 40_00, ..OutputImage::ZERO };
        // Two bit times, limited to the resolution of the clock.
        let step = rate.bits_to_time(2).max(Duration::from_micros(1u64));
        Self { device, phy, fdl, master, gripper: station, image, exchanges: 0, now: Instant::ZERO, step }
    }

    /// Advances the bus by one step. Returns the inputs if an exchange was completed.
    fn turn(&mut self) -> Option<InputImage> {
        self.now += self.step;
        self.phy.set_bus_time(self.now);
        self.master.get_mut(self.gripper).pi_q_mut().copy_from_slice(&self.image.to_bytes());
        self.fdl.poll(self.now, &mut self.phy, &mut self.master);
        let event = self.master.take_last_events().peripheral;
        self.device.poll(self.now);
        let (_, profirust::dp::PeripheralEvent::DataExchanged) = event? else { return None };
        self.exchanges += 1;
        let inputs = self.master.get_mut(self.gripper).pi_i();
        Some(InputImage::from_bytes(inputs.try_into().unwrap()))
    }

    /// Exchanges these flags until the inputs are as expected, within 60 s.
    fn command(&mut self, flags: Flag, shown: (Shown, Status)) {
        self.image.flags = flags;
        let end = self.now + Duration::from_millis(60_000u64);
        let mut last = None;
        // The exchange that carries the flag still returns earlier inputs.
        let from = self.exchanges + 5;
        while self.exchanges < from || last.is_none_or(|it: InputImage| (it.state, it.status) != shown) {
            assert!(self.now < end, "{flags:?}: {last:?}");
            last = self.turn().or(last);
        }
    }
}

#[test]
fn grip_cycles_at_every_rate() {
    for (rate, set) in [
        (Baudrate::B9600, 0),
        (Baudrate::B19200, 1),
        (Baudrate::B45450, 2),
        (Baudrate::B93750, 3),
        (Baudrate::B187500, 4),
        (Baudrate::B500000, 5),
        (Baudrate::B1500000, 6),
    ] {
        let profibus = ProfibusConfig { rate: Some(ProfibusConfig::RATES[set]), ..AT_500K.profibus };
        let gripper = wsg_sim::Config { part: Part::of_width(20.0), time_scale: 100.0, ..quick() };
        let mut bus = Bus::new(rate, Config { profibus, ..AT_500K }, gripper);
        let idle = (Shown::IDLE, Status::Success);
        bus.command(Flag::empty(), idle);
        bus.command(Flag::HOMING, idle);
        for _ in 0..2 {
            bus.command(Flag::empty(), idle);
            bus.command(Flag::GRIP, (Shown::HOLDING, Status::Success));
            bus.command(Flag::empty(), (Shown::HOLDING, Status::Success));
            bus.command(Flag::RELEASE, idle);
        }
        let cycle = [CommandId::GripPart, CommandId::ReleasePart];
        let expected = [&[CommandId::Homing][..], &cycle.repeat(2)].concat();
        assert_eq!(bus.device.world.take_motions(), expected, "{rate:?}");
    }
}

#[test]
fn ten_thousand_exchanges_cause_no_motion() {
    let mut bus = Bus::new(Baudrate::B1500000, at_1_5m(), quick());
    bus.command(Flag::empty(), (Shown::IDLE, Status::Success));
    let (from, start) = (bus.exchanges, bus.now);
    while bus.exchanges < from + 10_000 {
        assert!(bus.now < start + Duration::from_millis(20_000u64), "{} exchanges", bus.exchanges);
        bus.turn();
    }
    assert!(bus.master.get_mut(bus.gripper).is_running());
    assert_eq!(bus.device.world.take_motions(), []);
}

fn at_1_5m() -> Config {
    let rate = Some(ProfibusConfig::RATES[6]);
    Config { profibus: ProfibusConfig { rate, ..AT_500K.profibus }, ..AT_500K }
}
