//! The whole bridge as `wsg gateway` runs it: requests of two Modbus/TCP masters, images of the masters of two cyclic buses, pauses of
//! the computer, and a connection to the gripper that ends and is restored.
//!
//! Properties:
//! - the [`Promises`](crate::promises::Promises), with FAST_STOP_OK high: commands follow only edges of images that an answered
//!   request wrote, or of changed images of a cyclic master, where a flag rises that was 0 in the master's image before
//! - FASTSTOP lasts until each cyclic master that set it has cleared it
//! - a request is answered in its turn, according to its content ([`Tracked`])
//! - the silence of the master that wrote last is a lost bus, regardless of the others; so is its end on a cyclic bus, and a pause
//! - a jog ends with the connection of its master
//! - saved settings are loaded at the next start
//!
//! Sockets and the computer's clock are tested with the program: `tool/tests/gateway.rs` and `tests/surfaces`.

use bus_modbus::MAX_PDU_LEN;
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::plc::{ModbusTcp, TcpInput};
use wsg_bridge_fw::storage::Page;
use wsg_bridge_fw::{Config, ControlSource, Station};
use wsg_fieldbus::{CommandFlags, OutputImage, SilenceReaction};
use wsg_protocol::Instant;

use super::bridge::{SAVE_MS, settings_pdu, start};
use super::frames::repair_checksums;
use super::input::Input;
use super::tracked::{Done, Port, Tracked};
use super::whole::{Ends, FLAGS, PARAMETERS, WholeBridge};
use crate::flash_model::FlashModel;
use crate::serial_gripper::SerialLine;
use crate::world::can::CanDouble;

/// Longest time between two turns that is not a pause, and time until the gateway connects again, in milliseconds.
const LONGEST_PAUSE_MS: u32 = 800;
const RETRY_MS: u32 = 250;

struct Model {
    station: Station<CanDouble>,
    flash: FlashModel,
    delivered: Config,
    modbus: ModbusTcp,
    tracked: Tracked,
    /// Numbers of the masters' connections.
    masters: [u64; 2],
    /// The last images of the cyclic masters, since they enabled their outputs.
    cyclic: [Option<OutputImage>; 2],
    plc: Plc,
    /// When the connection to the gripper is restored; `None` while there is one.
    restored_ms: Option<u32>,
    /// Time between two turns, in milliseconds.
    step_ms: u32,
    ends: Ends,
}

/// The PLC, until it is silent.
#[derive(Default)]
struct Plc {
    /// The master that wrote last, and the one that began the present jog.
    writer: Option<u64>,
    jogger: Option<u64>,
    /// Time of the last data of the jogger, or of the writer without a jog.
    received_ms: Option<u32>,
}

impl Plc {
    fn is(&self, master: u64) -> bool {
        [self.writer, self.jogger].contains(&Some(master))
    }

    fn is_silent(&self, now_ms: u32, timeout_ms: u32) -> bool {
        timeout_ms > 0 && self.received_ms.is_some_and(|received_ms| now_ms - received_ms >= timeout_ms)
    }
}

/// What happens in a turn.
#[derive(Clone, Copy)]
enum Event<'a> {
    Nothing,
    /// A connection sends a request.
    Request(u64, &'a [u8]),
    /// The computer has paused.
    Paused,
    /// The connection that began the jog has ended before the turn.
    JogEnded,
    /// A cyclic master provides this image after that one.
    Image(usize, OutputImage, Option<OutputImage>),
    /// A cyclic master no longer provides images.
    Left(usize),
}

/// Number of a cyclic master.
const fn number(cyclic: usize) -> u64 {
    u64::MAX - cyclic as u64
}

/// The first byte also selects turns that are 5 ms apart (bit 1), and damaged stored settings (bit 3). Each further op is a byte with
/// parameter bytes. Bit 6 omits the time after it, and bit 7 selects the second master.
pub fn bridge_gateway(data: &[u8]) {
    let mut input = Input::new(data);
    let choice = input.byte();
    let mut model = Model::new(choice & 8 != 0);
    if choice & 2 != 0 {
        model.step_ms = 5;
        // The repetitions of a query that detect the silence are sent up to a turn late, each.
        model.ends.promises.levels.max_silence_ms += 13 * (model.step_ms - 1);
    }
    model.play(choice, &mut input);
    if model.tracked.saved().is_some() {
        model.pass(SAVE_MS);
        let (_, found) = start(&model.delivered, &mut model.flash);
        assert_eq!(Some(&found.record()), model.tracked.saved());
    }
}

/// Returns a write of registers 0 to 3.
fn image_pdu(flags: CommandFlags, parameters: [u16; 3]) -> Vec<u8> {
    [&[16, 0, 0, 0, 4, 8, flags.bits(), 0][..], parameters.map(u16::to_be_bytes).as_flattened()].concat()
}

impl Model {
    fn new(is_damaged: bool) -> Self {
        let delivered = Config::DEFAULT;
        let mut flash = FlashModel::new();
        if is_damaged {
            flash = FlashModel::with_record(1, &delivered.record());
            flash.set(Page::First, 3, None);
        }
        let (station, config) = start(&delivered, &mut flash);
        let mut ends = Ends::new(&config, None);
        ends.promises.requests.refuses = is_damaged;
        Self {
            station,
            flash,
            delivered,
            modbus: ModbusTcp::new(),
            tracked: Tracked::new(&delivered.record()),
            masters: [0, 1],
            cyclic: [None; 2],
            plc: Plc::default(),
            restored_ms: None,
            step_ms: 1,
            ends,
        }
    }

    /// Ends the connection to the gripper, which may enter FAST STOP.
    fn lose_gripper(&mut self, for_ms: u32, stops_fast: bool) {
        let now_ms = self.ends.now_ms;
        self.restored_ms = Some(now_ms + for_ms);
        self.ends.gripper.change(now_ms, &mut Input::new(&[if stops_fast { 0x70 } else { 0 }]));
    }

    fn restore_gripper(&mut self) {
        self.restored_ms = None;
        self.ends.gripper.change(self.ends.now_ms, &mut Input::new(&[1]));
        self.ends.line.link = SerialLine::with_room(usize::MAX);
    }

    /// Ends the connection of a master, which connects again.
    fn disconnect(&mut self, master: usize) {
        let number = self.masters[master];
        self.masters[master] += self.masters.len() as u64;
        if self.modbus.end_jog(number) {
            self.station.bridge().silence(SilenceReaction::Hold);
        }
        if self.plc.jogger == Some(number) {
            self.plc.jogger = None;
            self.run(Event::JogEnded);
        }
    }

    /// Sends a request, sometimes with a wrong bit or truncated.
    fn send(&mut self, master: usize, mut pdu: Vec<u8>, input: &mut Input<'_>) {
        let trouble = input.byte();
        let at = usize::from(input.byte()) % pdu.len();
        match trouble % 16 {
            0 => pdu[at] ^= 1 << (trouble >> 5),
            1 => pdu.truncate(at.max(1)),
            _ => {}
        }
        self.run(Event::Request(self.masters[master], &pdu));
    }

    /// Runs a turn.
    fn run(&mut self, event: Event<'_>) {
        let now_ms = self.ends.now_ms;
        let is_paused = matches!(event, Event::Paused);
        if is_paused {
            self.lose_gripper(RETRY_MS, true);
            self.cyclic = [None; 2];
        } else if self.restored_ms.is_some_and(|restored_ms| now_ms >= restored_ms) {
            self.restore_gripper();
        }
        let is_connected = self.restored_ms.is_none();
        let Self { station, flash, modbus, tracked, ends, .. } = self;
        if !is_connected {
            ends.line.link = SerialLine::with_room(0);
        }
        station.bridge().set_link_lost(!is_connected);
        let was_up = station.bridge().is_connected();
        let (mut response, mut len, mut is_write) = ([0; MAX_PDU_LEN], 0, false);
        let input = match event {
            Event::Request(master, pdu) => {
                let (response, len, is_write) = (&mut response, &mut len, &mut is_write);
                TcpInput::Request { master, pdu, response, len, is_write }
            }
            Event::Paused => TcpInput::Paused,
            Event::Image(master, image, before) => TcpInput::Image { master: number(master), image, before },
            Event::Left(master) => TcpInput::Left { master: number(master) },
            Event::Nothing | Event::JogEnded => TcpInput::Nothing,
        };
        let outputs = station.turn_of_gateway(now_ms, ends.line.turn(), &mut modbus.over(input), flash);
        ends.wires = Inputs::FAST_STOP_OK;
        let received = ends.line.take_received();
        ends.begin_turn(&received);
        let requests = &mut ends.promises.requests;
        if matches!(event, Event::JogEnded) {
            requests.end_jog();
        }
        let commands = station.bridge().control_source() == ControlSource::Bus;
        let has_left = matches!(event, Event::Left(master) if self.plc.is(number(master)));
        if is_paused || has_left || self.plc.is_silent(now_ms, tracked.timeout_ms()) {
            self.plc = Plc::default();
            requests.lose_bus(commands && tracked.stops_at_silence());
        }
        let (master, written) = match event {
            Event::Request(master, pdu) => match tracked.take_answer(Port::Bus, pdu, &response[..len]) {
                Done::Image(image, recipe) => (Some(master), Some((image, recipe))),
                _ => (Some(master), None),
            },
            Event::Image(master, image, before) => {
                let is_written = self.plc.writer.is_none() || before != Some(image);
                let held = self.plc.writer.map(|_| before.map_or(CommandFlags::all(), |before| before.flags));
                (Some(number(master)), is_written.then(|| tracked.take_cyclic(image, held)))
            }
            _ => (None, None),
        };
        if let Some((mut image, recipe)) = written {
            let cyclic = self.cyclic.iter().flatten().map(|image| image.flags);
            image.flags |= cyclic.collect::<CommandFlags>() & CommandFlags::FASTSTOP;
            requests.take_image(image, recipe);
            self.plc.writer = master;
            let jogs = image.flags.intersects(CommandFlags::JOG);
            self.plc.jogger = self.plc.jogger.or(master).filter(|_| jogs);
        }
        if master.is_some() && self.plc.jogger.or(self.plc.writer) == master {
            self.plc.received_ms = Some(now_ms);
        }
        // A request may have shortened BUS_TIMEOUT.
        if self.plc.is_silent(now_ms, tracked.timeout_ms()) {
            self.plc = Plc::default();
            requests.lose_bus(commands && tracked.stops_at_silence());
        }
        ends.promises.levels.min_busy_ms = tracked.min_busy_ms();
        // The gateway resets the connection to a silent gripper.
        if is_connected && was_up && !station.bridge().is_connected() {
            self.lose_gripper(RETRY_MS, true);
        }
        let max_delay_ms = self.restored_ms.is_none().then_some(1);
        self.ends.end_turn(self.station.bridge(), outputs, max_delay_ms);
        // Broadcasts do not exist, so every effect is known.
        let _ = self.tracked.end_turn();
        self.tracked.configure(&mut self.ends.promises);
    }
}

impl WholeBridge for Model {
    fn ends(&mut self) -> &mut Ends {
        &mut self.ends
    }

    fn write_zeros(&mut self) {
        for flags in [CommandFlags::empty(), CommandFlags::STOP_ACK, CommandFlags::empty()] {
            self.run(Event::Request(self.masters[0], &image_pdu(flags, PARAMETERS[0])));
            self.pass(4);
        }
    }

    fn passes_after(&self, op: u8) -> bool {
        op & 0x40 == 0
    }

    fn turn(&mut self) {
        self.ends.now_ms += self.step_ms;
        self.run(Event::Nothing);
    }

    fn take(&mut self, op: u8, input: &mut Input<'_>) {
        let master = usize::from(op >> 7);
        let pdu = match op % 16 {
            3 => return self.forge(input.fewer_than(40)),
            4 => {
                let mut bytes = input.fewer_than(40).to_vec();
                repair_checksums(&mut bytes);
                return self.forge(&bytes);
            }
            5 => return self.forge_status(input),
            8 => {
                let how = input.byte();
                let ms = 3 * u32::from(input.byte());
                match how % 4 {
                    0 => {
                        self.ends.now_ms += LONGEST_PAUSE_MS + ms;
                        self.run(Event::Paused);
                    }
                    // The next turn is late, which delays the repetitions of a query. It sends a whole burst of FAST STOPs, which one
                    // fault can lose.
                    1 => {
                        self.ends.now_ms += ms;
                        self.ends.promises.levels.max_silence_ms += ms;
                        self.ends.gripper.reach.recover(Instant::from_millis(self.ends.now_ms));
                    }
                    2 => self.lose_gripper(ms, how & 4 != 0),
                    _ => self.disconnect(master),
                }
                return;
            }
            9 => [&[input.byte()], input.fewer_than(24)].concat(),
            10 if op & 0x20 != 0 => {
                self.cyclic[master] = None;
                return self.run(Event::Left(master));
            }
            10 if op & 0x10 != 0 => {
                let flags = input.pick(&FLAGS);
                let [width, speed, force_limit] = input.pick(&PARAMETERS);
                let (width, force_limit) = (width as i16, force_limit as i16);
                let image = OutputImage { flags, user: 0, width, speed, force_limit };
                let before = self.cyclic[master].replace(image);
                return self.run(Event::Image(master, image, before));
            }
            10 => image_pdu(input.pick(&FLAGS), input.pick(&PARAMETERS)),
            11 => settings_pdu(op >> 4 & 3, input),
            12 => vec![5, 0, input.byte() % 66, input.pick(&[0, 0xFF, 1]), 0],
            13 if input.byte() & 7 == 0 => vec![3, 0, input.byte() & 1, 0, 1 + input.byte() % 4],
            13 => {
                let [and, or] = [input.pick(&FLAGS), input.pick(&FLAGS)];
                vec![22, 0, 0, and.bits(), 0xFF, or.bits(), 0]
            }
            _ => {
                // An edge as a PLC writes it.
                let parameters = input.pick(&PARAMETERS);
                for flags in [CommandFlags::empty(), input.pick(&FLAGS)] {
                    self.run(Event::Request(self.masters[master], &image_pdu(flags, parameters)));
                    self.pass(4);
                }
                return;
            }
        };
        self.send(master, pdu, input);
    }
}
