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
use wsg_protocol::{Instant, SystemFlags};

use super::bridge::{SAVE_MS, coil_pdu, flags_pdu, image_pdu, settings_pdu};
use super::input::Input;
use super::tracked::{Done, Tracked};
use super::whole::{self, Ends, PARAMETERS, WholeBridge, pick_answer, pick_edge, pick_image, pick_noise};
use crate::flash_model::FlashModel;
use crate::operation::{Behaviour, GatewayEvent, Operation, Port, TelegramFault, image};
use crate::serial_gripper::SerialLine;
use crate::world::can::CanDouble;
use crate::world::start;

/// Longest time between two turns that is not a pause, and time until the gateway connects again, in milliseconds.
const LONGEST_PAUSE_MS: u32 = 800;
const RETRY_MS: u32 = 250;

pub(super) struct Model {
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
    whole::run::<Model>(data);
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
        self.restored_ms = Some(self.ends.now_ms + for_ms);
        self.change_gripper(false, if stops_fast { SystemFlags::FAST_STOP } else { SystemFlags::empty() });
    }

    fn restore_gripper(&mut self) {
        self.restored_ms = None;
        self.change_gripper(true, SystemFlags::empty());
        self.ends.line.link = SerialLine::with_room(usize::MAX);
    }

    fn change_gripper(&mut self, answers: bool, further: SystemFlags) {
        let flags = SystemFlags::REFERENCED | further;
        let behaviour = Behaviour { answers, deliveries: vec![], flags, has_part: true, is_disturbed: false };
        self.ends.gripper.change(self.ends.now_ms, &behaviour);
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
    const NAME: &'static str = "bridge_gateway";

    fn start(choice: u8) -> Self {
        let mut model = Self::new(choice & 8 != 0);
        if choice & 2 != 0 {
            model.step_ms = 5;
            // The repetitions of a query that detect the silence are sent up to a turn late, each.
            model.ends.promises.levels.max_silence_ms += 13 * (model.step_ms - 1);
        }
        model
    }

    fn end(mut self) {
        if self.tracked.saved().is_some() {
            self.pass(SAVE_MS);
            let (_, found) = start(&self.delivered, &mut self.flash);
            assert_eq!(Some(&found.record()), self.tracked.saved());
        }
    }

    fn ends(&mut self) -> &mut Ends {
        &mut self.ends
    }

    fn write_zeros(&mut self) {
        for flags in [CommandFlags::empty(), CommandFlags::STOP_ACK, CommandFlags::empty()] {
            self.execute(&Operation::Write(image(flags, PARAMETERS[0])));
            self.pass(4);
        }
    }

    fn passes_after(op: u8) -> bool {
        op & 0x40 == 0
    }

    fn turn(&mut self) {
        self.ends.now_ms += self.step_ms;
        self.run(Event::Nothing);
    }

    fn decode(op: u8, input: &mut Input<'_>, script: &mut Vec<Operation>) {
        let master = usize::from(op >> 7);
        let request = |pdu, fault| Operation::Gateway(GatewayEvent::Request { master, pdu, fault });
        let pdu = match op % 16 {
            3 | 4 => return script.push(pick_noise(input, op % 16 == 4)),
            5 => return script.push(pick_answer(input)),
            8 => {
                let how = input.byte();
                let ms = 3 * u32::from(input.byte());
                return script.push(Operation::Gateway(match how % 4 {
                    0 => GatewayEvent::ComputerPauses(ms),
                    1 => GatewayEvent::LateTurn(ms),
                    2 => GatewayEvent::LoseGripper { for_ms: ms, stops_fast: how & 4 != 0 },
                    _ => GatewayEvent::Reconnect(master),
                }));
            }
            9 => [&[input.byte()], input.fewer_than(24)].concat(),
            10 if op & 0x20 != 0 => return script.push(Operation::Gateway(GatewayEvent::Leave(master))),
            10 if op & 0x10 != 0 => {
                let image = pick_image(input);
                return script.push(Operation::Gateway(GatewayEvent::Image(master, image)));
            }
            10 => image_pdu(&pick_image(input)),
            11 => settings_pdu(op >> 4 & 3, input),
            12 => coil_pdu(input),
            13 => flags_pdu(input),
            _ => {
                let edge = pick_edge(input)
                    .map(|image| [request(image_pdu(&image), TelegramFault::Intact), Operation::Pass(4)]);
                return script.extend(edge.into_iter().flatten());
            }
        };
        let (how, at) = (input.byte(), usize::from(input.byte()));
        let fault = match how % 16 {
            0 => TelegramFault::Flip { at, bit: how >> 5 },
            1 if pdu.len() > 1 => TelegramFault::Truncate { at: (at % pdu.len()).max(1) },
            _ => TelegramFault::Intact,
        };
        script.push(request(pdu, fault));
    }

    fn execute(&mut self, operation: &Operation) {
        let event = match operation {
            Operation::Write(image) => {
                return self.run(Event::Request(self.masters[0], &image_pdu(image)));
            }
            Operation::Gateway(event) => event,
            other => whole::cannot(other),
        };
        match *event {
            GatewayEvent::Request { master, ref pdu, fault } => {
                let bytes = fault.characters(pdu, 0).into_iter().filter_map(|(byte, _)| byte);
                self.run(Event::Request(self.masters[master], &bytes.collect::<Vec<u8>>()));
            }
            GatewayEvent::Reconnect(master) => self.disconnect(master),
            GatewayEvent::Image(master, image) => {
                let before = self.cyclic[master].replace(image);
                self.run(Event::Image(master, image, before));
            }
            GatewayEvent::Leave(master) => {
                self.cyclic[master] = None;
                self.run(Event::Left(master));
            }
            GatewayEvent::ComputerPauses(ms) => {
                self.ends.now_ms += LONGEST_PAUSE_MS + ms;
                self.run(Event::Paused);
            }
            GatewayEvent::LateTurn(ms) => {
                // Delays the repetitions of a query, and sends a whole burst of FAST STOPs, which one fault can lose.
                self.ends.now_ms += ms;
                self.ends.promises.levels.max_silence_ms += ms;
                self.ends.gripper.reach.recover(Instant::from_millis(self.ends.now_ms));
            }
            GatewayEvent::LoseGripper { for_ms, stops_fast } => self.lose_gripper(for_ms, stops_fast),
        }
    }
}
