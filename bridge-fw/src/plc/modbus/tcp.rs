//! Modbus/TCP as a PLC side, for a gateway: a computer that runs the bridge without a board. The caller has the sockets.
//!
//! Masters share the output image, as on a Modbus RTU line. The one that wrote it last is the PLC: its silence is a lost bus,
//! even while other masters send requests. The end of its connection is not, because some masters connect for each request.
//!
//! The master of a bus that exchanges images in cycles, such as PROFINET, shares the output image, too. Only its changes are
//! writes, and its end is a lost bus if it wrote last.

use super::{BridgeDevice, Role, has_fallen_silent};
use crate::plc::View;
use crate::plc::side::{PlcEvent, PlcSide, Shown};
use crate::register::{BusCounts, Link};
use bus_modbus::MAX_PDU_LEN;
use wsg_fieldbus::{CommandFlags, Images, InputImage, MaskedFlags, OutputImage};
use wsg_protocol::Instant;

/// Number of cyclic buses beside Modbus/TCP, each with one master: PROFINET and EtherNet/IP.
const CYCLIC_BUSES: usize = 2;

/// The masters of Modbus/TCP, and the bridge's registers for them.
#[derive(Clone, Debug)]
pub struct ModbusTcp {
    images: Images,
    /// The masters of cyclic buses that hold FASTSTOP: no other master releases it.
    holders: [Option<u64>; CYCLIC_BUSES],
    /// The inputs of a cyclic bus.
    inputs: Option<InputImage>,
    /// The master that wrote the output image last, until it is silent.
    writer: Option<u64>,
    /// The master that began the present jog.
    jogger: Option<u64>,
    /// Time of the last data of the jogger, or of the writer without a jog; `None` without either.
    received_at: Option<Instant>,
}

/// Input of the masters in one turn of the bridge.
#[derive(Debug)]
pub enum TcpInput<'a> {
    /// Time has passed.
    Nothing,
    /// A request.
    Request {
        /// Number of the connection.
        master: u64,
        /// Request PDU.
        pdu: &'a [u8],
        /// Place of the response PDU.
        response: &'a mut [u8; MAX_PDU_LEN],
        /// Set to the length of the response.
        len: &'a mut usize,
        /// Set to whether the request has written the output image.
        is_write: &'a mut bool,
    },
    /// The output image of a cyclic bus, changed or not.
    Image {
        /// Number of the master.
        master: u64,
        /// The image.
        image: OutputImage,
        /// The image before. `None` for the first one since the master enabled its outputs: it starts nothing, except FASTSTOP.
        before: Option<OutputImage>,
    },
    /// The master of a cyclic bus no longer provides outputs.
    Left {
        /// Number of the master.
        master: u64,
    },
    /// The computer paused for so long that every image received before is too old.
    Paused,
}

impl ModbusTcp {
    /// Creates the side without a master.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            images: Images::new(false),
            holders: [None; CYCLIC_BUSES],
            inputs: None,
            writer: None,
            jogger: None,
            received_at: None,
        }
    }

    /// Returns the input image for a cyclic bus, or `None` while the gripper does not answer.
    #[must_use]
    pub const fn inputs(&self) -> Option<InputImage> {
        self.inputs
    }

    /// Combines the side with its input: a PLC side for one turn.
    pub const fn over<'a>(&'a mut self, input: TcpInput<'a>) -> TcpTurn<'a> {
        TcpTurn { modbus: self, input }
    }

    /// Returns whether the connection with this number is the PLC's, or began the present jog.
    #[must_use]
    pub fn is_plc(&self, master: u64) -> bool {
        [self.writer, self.jogger].contains(&Some(master))
    }

    /// Returns the master that wrote last, until it is silent.
    #[must_use]
    pub const fn writer(&self) -> Option<u64> {
        self.writer
    }

    /// Records the end of a master's connection. Returns whether the present jog is the master's, and must end.
    pub fn end_jog(&mut self, master: u64) -> bool {
        self.jogger.take_if(|jogger| *jogger == master).is_some()
    }

    /// Forgets the PLC.
    const fn lose_plc(&mut self) -> PlcEvent {
        self.writer = None;
        self.jogger = None;
        self.received_at = None;
        PlcEvent::Left { silent: true }
    }

    /// Serves a request. Returns its event and the length of the response.
    fn serve(
        &mut self,
        now: Instant,
        master: u64,
        pdu: &[u8],
        response: &mut [u8; MAX_PDU_LEN],
        view: &mut View<'_>,
    ) -> (PlcEvent, usize) {
        self.images.set_swap_bytes(view.settings.bus().swap_bytes);
        self.images.set_input(&view.image());
        // The counters are for a serial line.
        let counts = BusCounts::default();
        let images = &mut self.images;
        let mut device = BridgeDevice { role: Role::Plc, images, view, counts, configured: false };
        let len = bus_modbus::serve(pdu, &mut device, response);
        let configured = device.configured;
        let written = self.images.take_written();
        if let Some(image) = &written {
            self.note_writer(master, image);
        }
        self.note_data(now, master);
        let event = match written {
            _ if configured => PlcEvent::Configured,
            Some(image) => self.output(image),
            None => PlcEvent::Served,
        };
        (event, len)
    }

    /// Takes an image of a cyclic bus. A repeated image must not undo a write of another master.
    fn take(
        &mut self,
        now: Instant,
        master: u64,
        mut image: OutputImage,
        before: Option<OutputImage>,
    ) -> Option<PlcEvent> {
        if self.writer.is_some() && before == Some(image) {
            self.note_data(now, master);
            return None;
        }
        self.hold(master, image.flags.contains(CommandFlags::FASTSTOP));
        if self.writer.is_some() {
            // A flag that is 0 in the shared image, and that this master does not raise now, would look like an edge.
            let held = before.map_or(CommandFlags::all(), |before| before.flags);
            let mut stale = MaskedFlags::NONE;
            stale.mask(held - self.images.output().flags - CommandFlags::FASTSTOP);
            stale.see(image.flags, false);
            if image.flags.contains(CommandFlags::STOP_ACK) {
                // It suppresses motions even where it is no edge.
                stale.mask(CommandFlags::MOTIONS | CommandFlags::JOG);
            }
            image.flags = stale.counting(image.flags);
        }
        self.images.set_output(&image);
        self.note_writer(master, &image);
        self.note_data(now, master);
        Some(self.output(image))
    }

    /// Records whether the master of a cyclic bus holds FASTSTOP.
    fn hold(&mut self, master: u64, holds: bool) {
        for holder in &mut self.holders {
            holder.take_if(|holder| *holder == master);
        }
        let free = self.holders.iter_mut().find(|holder| holder.is_none());
        if let Some(free) = free.filter(|_| holds) {
            *free = Some(master);
        }
    }

    /// Returns the event of a written image, with FASTSTOP while another master holds it.
    fn output(&self, mut image: OutputImage) -> PlcEvent {
        if self.holders.iter().any(Option::is_some) {
            image.flags |= CommandFlags::FASTSTOP;
        }
        PlcEvent::Output(image)
    }

    fn note_writer(&mut self, master: u64, image: &OutputImage) {
        self.writer = Some(master);
        let jogs = image.flags.intersects(CommandFlags::JOG);
        self.jogger = if jogs { self.jogger.or(Some(master)) } else { None };
    }

    /// Records data of a master. Other masters do not hide the silence of the one that jogs.
    fn note_data(&mut self, now: Instant, master: u64) {
        if self.jogger.or(self.writer) == Some(master) {
            self.received_at = Some(now);
        }
    }
}

impl Default for ModbusTcp {
    fn default() -> Self {
        Self::new()
    }
}

/// A [`ModbusTcp`] with its input.
#[derive(Debug)]
pub struct TcpTurn<'a> {
    modbus: &'a mut ModbusTcp,
    input: TcpInput<'a>,
}

impl PlcSide for TcpTurn<'_> {
    fn receive(&mut self, now: Instant, view: &mut View<'_>) -> Option<PlcEvent> {
        let Self { modbus, input } = self;
        let is_paused = matches!(input, TcpInput::Paused);
        if is_paused {
            // A pause longer than BUS_TIMEOUT is one loss. The connections of all masters end.
            *input = TcpInput::Nothing;
            modbus.holders = [None; CYCLIC_BUSES];
        }
        // Before a request: a bridge that was late must not take it for one in time.
        if has_fallen_silent(&mut modbus.received_at, now, view.settings.timeout_ms()) || is_paused {
            return Some(modbus.lose_plc());
        }
        match core::mem::replace(input, TcpInput::Nothing) {
            TcpInput::Request { master, pdu, response, len, is_write } => {
                let (event, response_len) = modbus.serve(now, master, pdu, response, view);
                *len = response_len;
                *is_write = matches!(event, PlcEvent::Output(_));
                Some(event)
            }
            TcpInput::Image { master, image, before } => modbus.take(now, master, image, before),
            TcpInput::Left { master } => {
                modbus.hold(master, false);
                modbus.is_plc(master).then(|| modbus.lose_plc())
            }
            TcpInput::Paused | TcpInput::Nothing => None,
        }
    }

    /// Sets the inputs of a cyclic bus. A request is answered with the state at its time.
    fn show(&mut self, _: Instant, shown: &Shown) {
        self.modbus.inputs = (shown.link == Link::Up).then_some(shown.image);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gripper::GripperLink;
    use crate::io::Inputs;
    use crate::{Bridge, Config};
    use std::vec::Vec;
    use wsg_protocol::can::Identifiers;

    /// A PLC side that records the events of another.
    struct Recorded<'a>(TcpTurn<'a>, &'a mut Vec<PlcEvent>);

    impl PlcSide for Recorded<'_> {
        fn receive(&mut self, now: Instant, view: &mut View<'_>) -> Option<PlcEvent> {
            let event = self.0.receive(now, view);
            self.1.extend(event);
            event
        }

        fn show(&mut self, _: Instant, _: &Shown) {}
    }

    struct Rig {
        bridge: Bridge,
        modbus: ModbusTcp,
    }

    /// Read Input Registers: MAP_VERSION.
    const READ: &[u8] = &[4, 0, 100, 0, 1];
    /// Write Single Register: register 0.
    const WRITE: &[u8] = &[6, 0, 0, 0, 0];

    impl Rig {
        fn new() -> Self {
            Self { bridge: Bridge::new(Config::DEFAULT), modbus: ModbusTcp::new() }
        }

        fn turn(&mut self, now_ms: u32, input: TcpInput<'_>) -> Vec<PlcEvent> {
            let (mut events, mut line) = (Vec::new(), GripperLink::new(Identifiers::DEFAULT));
            let mut side = Recorded(self.modbus.over(input), &mut events);
            self.bridge.poll(now_ms, Inputs::FAST_STOP_OK, &mut line, &mut side);
            events
        }

        fn request(&mut self, now_ms: u32, master: u64, pdu: &[u8]) -> (Vec<PlcEvent>, Vec<u8>) {
            let (mut place, mut len, mut write) = ([0; MAX_PDU_LEN], 0, false);
            let (response, is_write) = (&mut place, &mut write);
            let events =
                self.turn(now_ms, TcpInput::Request { master, pdu, response, len: &mut len, is_write });
            assert_eq!(write, pdu[0] == 6, "{pdu:?}");
            (events, Vec::from(&place[..len]))
        }
    }

    fn image(flags: CommandFlags, width: i16) -> OutputImage {
        OutputImage { flags, width, ..OutputImage::ZERO }
    }

    const SILENT: PlcEvent = PlcEvent::Left { silent: true };

    #[test]
    fn reads_of_another_master_do_not_hide_the_silence_of_the_plc() {
        let mut rig = Rig::new();
        let (events, answer) = rig.request(0, 1, WRITE);
        assert!(matches!(events[..], [PlcEvent::Output(_)]), "{events:?}");
        assert_eq!(answer, WRITE);
        for now_ms in (100..1_000).step_by(100) {
            assert_eq!(rig.request(now_ms, 2, READ).0, [PlcEvent::Served]);
        }
        assert!(rig.modbus.is_plc(1));
        assert_eq!(rig.request(1_000, 2, READ).0, [SILENT, PlcEvent::Served]);
        assert!(!rig.modbus.is_plc(1) && !rig.modbus.is_plc(2) && rig.modbus.writer().is_none());
        assert_eq!(rig.turn(9_000, TcpInput::Nothing), [], "a master that only reads commands nothing");
    }

    #[test]
    fn cyclic_images_are_writes_when_they_change_and_keep_the_plc_alive() {
        let mut rig = Rig::new();
        let mut before = None;
        let mut exchange = |now_ms, image: OutputImage| {
            rig.turn(now_ms, TcpInput::Image { master: 3, image, before: before.replace(image) })
        };
        let (zero, moved) = (OutputImage::ZERO, image(CommandFlags::MOVE, 10_00));
        assert_eq!(exchange(0, zero), [PlcEvent::Output(zero)]);
        for now_ms in (8..3_000).step_by(8) {
            assert_eq!(exchange(now_ms, zero), []);
        }
        assert_eq!(exchange(3_000, moved), [PlcEvent::Output(moved)]);
        assert_eq!(exchange(4_000, moved), [SILENT, PlcEvent::Output(moved)], "late, and again the first");
        assert_eq!(exchange(4_008, moved), []);
        assert_eq!(rig.turn(4_010, TcpInput::Left { master: 3 }), [SILENT]);
        assert_eq!(rig.turn(4_011, TcpInput::Left { master: 3 }), []);
    }

    #[test]
    fn held_flag_of_a_cyclic_master_is_no_edge_and_fast_stop_stays() {
        let mut rig = Rig::new();
        let (mv, stop, none) = (CommandFlags::MOVE, CommandFlags::FASTSTOP, CommandFlags::empty());
        let mut before = None;
        // Writes by another master are `None`.
        for (now_ms, written, expected) in [
            (0, None, Some(none)),
            (1, Some((mv | stop, 0)), Some(stop)),
            (2, None, Some(stop)),
            (3, Some((mv | stop, 0)), None),
            (4, Some((mv, 1)), Some(none)),
            (5, Some((none, 1)), Some(none)),
            (6, Some((mv, 1)), Some(mv)),
            (7, Some((mv, 2)), Some(mv)),
            (8, None, Some(none)),
            (9, Some((mv, 3)), Some(none)),
        ] {
            let events = match written {
                None => rig.request(now_ms, 1, WRITE).0,
                Some((flags, width)) => {
                    let image = image(flags, width);
                    rig.turn(now_ms, TcpInput::Image { master: 3, image, before: before.replace(image) })
                }
            };
            let flags = events.iter().map(|event| match event {
                PlcEvent::Output(image) => image.flags,
                other => panic!("{other:?}"),
            });
            assert_eq!(flags.collect::<Vec<_>>(), Vec::from_iter(expected), "{now_ms}");
        }
        assert_eq!(rig.turn(10, TcpInput::Left { master: 1 }), [], "the cyclic master is the PLC");
        assert_eq!(rig.turn(11, TcpInput::Left { master: 3 }), [SILENT]);
    }

    #[test]
    fn stale_level_of_a_cyclic_master_keeps_its_effect_on_other_flags() {
        let (mv, ack) = (CommandFlags::MOVE, CommandFlags::STOP_ACK);
        let (plus, minus) = (CommandFlags::JOG_PLUS, CommandFlags::JOG_MINUS);
        let none = CommandFlags::empty();
        // Each second image comes after another master has cleared the shared one.
        for (first, second, expected) in [
            (ack, ack | mv, none),
            (ack, mv, mv),
            (plus, plus | minus, none),
            (plus, minus, none),
            (plus, mv, mv),
        ] {
            let mut rig = Rig::new();
            rig.request(0, 1, WRITE);
            let [first, second] = [first, second].map(|flags| image(flags, 0));
            let zeros = image(none, 0);
            rig.turn(1, TcpInput::Image { master: 3, image: zeros, before: None });
            rig.turn(2, TcpInput::Image { master: 3, image: first, before: Some(zeros) });
            rig.request(3, 1, WRITE);
            let events = rig.turn(4, TcpInput::Image { master: 3, image: second, before: Some(first) });
            let [PlcEvent::Output(image)] = events[..] else { panic!("{events:?}") };
            assert_eq!(image.flags, expected, "{first:?}, {second:?}");
        }
    }

    #[test]
    fn no_other_cyclic_master_releases_a_fast_stop() {
        let mut rig = Rig::new();
        let (stop, none) = (CommandFlags::FASTSTOP, CommandFlags::empty());
        let written = |rig: &mut Rig, now_ms, master, flags, width| {
            let image = image(flags, width);
            let events = rig.turn(now_ms, TcpInput::Image { master, image, before: None });
            let [PlcEvent::Output(image)] = events[..] else { panic!("{events:?}") };
            image.flags
        };
        assert_eq!(written(&mut rig, 0, 3, stop, 0), stop);
        assert_eq!(written(&mut rig, 1, 4, none, 1), stop, "master 3 holds it");
        assert_eq!(written(&mut rig, 2, 4, stop, 1), stop);
        assert_eq!(written(&mut rig, 3, 3, none, 2), stop, "master 4 holds it");
        rig.turn(4, TcpInput::Left { master: 4 });
        assert_eq!(written(&mut rig, 5, 3, none, 3), none);
        // A pause ends every connection, without a report of its end.
        assert_eq!(written(&mut rig, 6, 3, stop, 3), stop);
        rig.turn(1_000, TcpInput::Paused);
        assert!(
            matches!(rig.request(1_001, 1, WRITE).0[..], [PlcEvent::Output(image)] if image.flags == none)
        );
    }

    #[test]
    fn jog_belongs_to_the_master_that_began_it() {
        let mut rig = Rig::new();
        rig.request(0, 1, &[6, 0, 0, 0x80, 0]);
        rig.request(10, 2, &[6, 0, 2, 0, 1]);
        assert!(rig.modbus.is_plc(1) && rig.modbus.is_plc(2));
        rig.request(20, 2, WRITE);
        assert!(!rig.modbus.is_plc(1), "the jog has ended");
        // Its silence is that of the PLC, even while another master writes parameters.
        rig.request(30, 1, &[6, 0, 0, 0x80, 0]);
        for now_ms in (100..1_030).step_by(100) {
            rig.request(now_ms, 2, &[6, 0, 2, 0, 1]);
        }
        let (events, _) = rig.request(1_030, 2, &[6, 0, 2, 0, 1]);
        assert_eq!(events[0], SILENT);
        rig.request(1_040, 2, WRITE);
        rig.request(1_050, 1, &[6, 0, 0, 0x80, 0]);
        assert!(!rig.modbus.end_jog(2) && rig.modbus.end_jog(1) && !rig.modbus.end_jog(1));
    }

    #[test]
    fn pause_is_a_lost_bus_and_a_late_request_comes_after_the_time_out() {
        let mut rig = Rig::new();
        rig.request(0, 1, WRITE);
        assert_eq!(rig.turn(600, TcpInput::Paused), [SILENT]);
        rig.request(700, 1, WRITE);
        let (events, answer) = rig.request(1_800, 1, READ);
        assert_eq!(events, [SILENT, PlcEvent::Served]);
        assert_eq!(answer[..2], [4, 2]);
        assert_eq!(rig.turn(2_900, TcpInput::Paused), [SILENT]);
    }
}
