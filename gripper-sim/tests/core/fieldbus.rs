//! The rules of the fieldbus manual (chapters 4 to 6), one by one in virtual time: writes and reads of a PLC over Modbus/TCP.

use wsg_fieldbus::{CommandFlags as Flag, GripperFlags as Shown, InputImage, OutputImage};
use wsg_protocol::{Command, GripperState, PrePositionFlags, SoftLimits, Status, SystemFlags};
use wsg_sim::{
    Config, Direction, MAX_FRAME_LEN, Model, Part, PortId, PortKind, SilenceReaction, Time, VirtualGripper,
};

/// Parameters within the limits of a WSG 50.
pub(crate) const PARAMETERS: OutputImage =
    OutputImage { flags: Flag::empty(), user: 0, width: 20_00, speed: 100_00, force_limit: 40_00 };

/// The reaction to the loss of a master with cyclic data exchange, its motion, and whether the motion continues or a FAST
/// STOP ends it.
pub(crate) const REACTIONS: [(SilenceReaction, Flag, bool, bool); 4] = [
    (SilenceReaction::Hold, Flag::MOVE, true, false),
    (SilenceReaction::Hold, Flag::JOG_MINUS, false, false),
    (SilenceReaction::Stop, Flag::MOVE, false, false),
    (SilenceReaction::FastStop, Flag::MOVE, false, true),
];

/// A PLC connected to a gripper, with virtual time.
pub(crate) struct Plc {
    pub(crate) gripper: VirtualGripper,
    pub(crate) port: PortId,
    pub(crate) image: OutputImage,
    pub(crate) now: Time,
}

impl Plc {
    /// Powers up; the PLC has not written these flags and its parameters yet.
    fn before_its_first_write(config: Config, flags: Flag) -> Self {
        let mut gripper = VirtualGripper::new(config);
        let port = gripper.connect(PortKind::ModbusTcp).expect("a port is free");
        Self { gripper, port, image: OutputImage { flags, ..PARAMETERS }, now: Time::ZERO }
    }

    /// Powers up; the PLC has written its parameters with all flags 0.
    pub(crate) fn new(config: Config) -> Self {
        let mut plc = Self::before_its_first_write(config, Flag::empty());
        plc.write();
        plc
    }

    /// Homes in the outward direction.
    fn homed(part: Option<Part>) -> Self {
        Self::homed_with(Config { part, ..Config::default() })
    }

    fn homed_with(config: Config) -> Self {
        let mut plc = Self::new(Config { homing_default: Direction::Plus, ..config });
        plc.raise(Flag::HOMING);
        plc.wait(4_000);
        plc.lower(Flag::HOMING);
        assert_eq!(plc.shows(), (Shown::IDLE, Status::Success));
        plc
    }

    /// Homes with a bus time-out of 500 ms.
    fn watched(bus_reaction: SilenceReaction) -> Self {
        let mut plc = Self::new(Config { bus_timeout_ms: 500, bus_reaction, ..Config::default() });
        plc.raise(Flag::HOMING);
        for _ in 0..40 {
            plc.wait(100);
            plc.read();
        }
        plc.lower(Flag::HOMING);
        assert_eq!(plc.shows(), (Shown::IDLE, Status::Success));
        plc
    }

    /// Sends a request PDU from a client and returns the response PDU.
    fn ask_from(&mut self, port: PortId, pdu: &[u8]) -> Vec<u8> {
        let header = [0x15, 0x01, 0, 0, 0, pdu.len() as u8 + 1, 0xFF];
        self.gripper.receive(port, self.now, &[&header, pdu].concat());
        let mut buffer = [0; MAX_FRAME_LEN];
        let answer = self.gripper.transmit(port, &mut buffer).expect("an answer").to_vec();
        assert_eq!(answer[..4], header[..4], "{answer:02X?}");
        assert_eq!(usize::from(answer[5]) + 6, answer.len(), "{answer:02X?}");
        assert_eq!(answer[6], 0xFF);
        assert_eq!(self.gripper.transmit(port, &mut buffer), None);
        answer[7..].to_vec()
    }

    fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        self.ask_from(self.port, pdu)
    }

    /// Writes the entire output image.
    pub(crate) fn write(&mut self) {
        let answer = self.ask(&[&[16, 0, 0, 0, 4, 8][..], &self.image.to_bytes()].concat());
        assert_eq!(answer, [16, 0, 0, 0, 4]);
    }

    fn change(&mut self, change: impl FnOnce(&mut OutputImage)) {
        change(&mut self.image);
        self.write();
    }

    pub(crate) fn raise(&mut self, flags: Flag) {
        self.change(|image| image.flags |= flags);
    }

    fn lower(&mut self, flags: Flag) {
        self.change(|image| image.flags &= !flags);
    }

    #[track_caller]
    fn move_to(&mut self, width: i16) {
        self.change(|image| image.width = width);
        self.raise(Flag::MOVE);
        assert_eq!(self.shows(), (Shown::POSITIONING, Status::CmdPending));
        self.wait(4_000);
        assert_eq!(self.shows(), (Shown::IDLE, Status::Success));
        self.lower(Flag::MOVE);
    }

    /// Reads the entire input image.
    pub(crate) fn read(&mut self) -> InputImage {
        let answer = self.ask(&[4, 0, 0, 0, 6]);
        assert_eq!(answer[..2], [4, 12]);
        InputImage::from_bytes(answer[2..].try_into().unwrap())
    }

    fn shows(&mut self) -> (Shown, Status) {
        let input = self.read();
        (input.state, input.status)
    }

    fn flags(&mut self) -> SystemFlags {
        self.read().system
    }

    /// The real opening width in mm.
    fn width(&self) -> f32 {
        self.gripper.state().width
    }

    pub(crate) fn wait(&mut self, millis: u64) {
        self.now = self.now.plus_millis(millis);
        self.gripper.advance(self.now);
    }

    /// Executes a command of another client, and returns its first status.
    fn other(&mut self, command: &Command<'_>) -> Status {
        self.gripper.command(command, self.now)
    }

    /// Asserts 41h with GSTATE, and the status register.
    #[track_caller]
    fn follows(&mut self, (gripper, shown): (GripperState, Shown), status: Status) {
        assert_eq!((self.gripper.state().gripper, self.shows()), (gripper, (shown, status)));
    }

    #[track_caller]
    fn assert_fast_stopped(&mut self) {
        let input = self.read();
        assert_eq!(input.state, Shown::IDLE);
        assert!(input.system.contains(SystemFlags::FAST_STOP));
        assert_eq!(self.gripper.state().speed, 0.0);
    }

    /// Lets a motion end, and asserts what the fingers at rest show.
    #[track_caller]
    fn ends(&mut self, shown: Shown, status: Status) {
        self.wait(3_000);
        assert_eq!(self.shows(), (shown, status));
        self.assert_stands();
    }

    #[track_caller]
    fn assert_stands(&mut self) {
        let before = self.width();
        self.wait(500);
        assert_eq!(self.width(), before);
    }
}

#[test]
fn first_write_gives_no_edge_but_fast_stop_counts() {
    let first = |flags| {
        let mut plc = Plc::before_its_first_write(Config::default(), flags);
        plc.write();
        plc
    };
    for flag in [Flag::MOVE, Flag::GRIP, Flag::RELEASE, Flag::HOMING, Flag::JOG_PLUS, Flag::JOG_MINUS] {
        let mut plc = first(flag);
        plc.assert_stands();
        assert_eq!(plc.shows(), (Shown::IDLE, Status::Success), "{flag:?}");
    }
    first(Flag::FASTSTOP).assert_fast_stopped();
}

#[test]
fn reading_before_the_first_write_gives_it_no_edge() {
    let mut plc = Plc::before_its_first_write(Config::default(), Flag::HOMING);
    plc.ask(&[3, 0, 0, 0, 4]);
    plc.write();
    plc.assert_stands();
}

/// The controller's own tests have each rule of chapter 6 in detail.
#[test]
fn rules_of_the_controller_apply_to_the_gripper_itself() {
    // The lowest of two edges.
    let mut plc = Plc::homed(None);
    plc.raise(Flag::MOVE | Flag::GRIP);
    plc.ends(Shown::IDLE, Status::Success);

    // A parameter that changes during a motion, and one outside the limits.
    let mut plc = Plc::homed(None);
    plc.raise(Flag::MOVE);
    plc.change(|image| image.width += 1);
    plc.assert_fast_stopped();
    plc.raise(Flag::STOP_ACK);
    plc.ends(Shown::IDLE, Status::Success);
    plc.change(|image| (image.flags, image.speed) = (Flag::empty(), 420_01));
    plc.raise(Flag::MOVE);
    plc.assert_fast_stopped();

    // STOP/ACK acknowledges only while FASTSTOP is 0.
    let mut plc = Plc::homed(None);
    plc.raise(Flag::FASTSTOP);
    plc.raise(Flag::STOP_ACK);
    plc.lower(Flag::FASTSTOP);
    plc.assert_fast_stopped();
    plc.lower(Flag::STOP_ACK);
    plc.raise(Flag::STOP_ACK);
    plc.ends(Shown::IDLE, Status::Success);
    assert!(!plc.flags().contains(SystemFlags::FAST_STOP));

    // A lost part, and MOVE after it.
    let mut plc = Plc::homed(Part::of_width(20.0));
    plc.raise(Flag::GRIP);
    plc.ends(Shown::HOLDING, Status::Success);
    plc.gripper.set_part(None, plc.now);
    plc.ends(Shown::PART_LOST, Status::Success);
    plc.raise(Flag::MOVE);
    plc.ends(Shown::PART_LOST, Status::AccessDenied);

    // MOVE and a jog onto a part, and STOP/ACK after them.
    for (flag, shown) in [(Flag::MOVE, Shown::ERROR), (Flag::JOG_MINUS, Shown::IDLE)] {
        let mut plc = Plc::homed(Part::of_width(50.0));
        plc.raise(flag);
        plc.ends(shown, Status::AxisBlocked);
        plc.lower(flag);
        plc.raise(Flag::STOP_ACK);
        plc.ends(Shown::IDLE, Status::Success);
    }

    // A jog, until its flag is 0.
    let mut plc = Plc::homed(None);
    plc.raise(Flag::JOG_MINUS);
    plc.wait(200);
    assert_eq!(plc.shows(), (Shown::RELEASING, Status::CmdPending));
    plc.lower(Flag::JOG_MINUS);
    plc.ends(Shown::IDLE, Status::Success);
}

/// Fieldbus, 5.1.2 and appendix C; GCL, 3.2.1. The other client speaks the binary protocol.
#[test]
fn gstate_follows_a_client_that_stops_the_plc_motion() {
    let pre_position = Command::PrePosition { flags: PrePositionFlags::empty(), width: 60.0, speed: 100.0 };
    let grip = Command::GripPart { width: 20.0, speed: 100.0 };
    for flag in [Flag::MOVE, Flag::GRIP, Flag::RELEASE, Flag::HOMING] {
        let mut plc = Plc::homed(None);
        plc.raise(flag);
        plc.wait(100);
        assert_eq!(plc.other(&Command::Stop), Status::Success);
        plc.follows((GripperState::Idle, Shown::IDLE), Status::CmdAborted);
        plc.wait(1_000);
        plc.follows((GripperState::Idle, Shown::IDLE), Status::CmdAborted);
        if flag == Flag::HOMING {
            continue; // Not referenced.
        }
        assert_eq!(plc.other(&pre_position), Status::CmdPending);
        plc.follows((GripperState::Positioning, Shown::POSITIONING), Status::CmdAborted);
        plc.wait(1_000);
        plc.follows((GripperState::Idle, Shown::IDLE), Status::CmdAborted);
        plc.other(&grip);
        plc.follows((GripperState::Gripping, Shown::GRIPPING), Status::CmdAborted);
        plc.wait(1_000);
        plc.follows((GripperState::NoPart, Shown::NO_PART), Status::CmdAborted);
        plc.other(&Command::Stop);
        plc.follows((GripperState::Idle, Shown::IDLE), Status::CmdAborted);
        plc.lower(flag);
        plc.move_to(40_00);
    }
}

/// Fieldbus, 6.6: FASTSTOP is level-sensitive.
#[test]
fn asserted_faststop_outlasts_a_third_party_acknowledgement() {
    let mut plc = Plc::homed(None);
    plc.raise(Flag::FASTSTOP);
    for _ in 0..3 {
        let now = plc.now;
        plc.gripper.command(&Command::ACKNOWLEDGE, now);
        let width = plc.width();
        let there = Command::PrePosition { flags: PrePositionFlags::empty(), width: 20.0, speed: 100.0 };
        plc.gripper.command(&there, now);
        plc.wait(250);
        plc.assert_fast_stopped();
        assert_eq!(plc.width(), width);
    }
    plc.lower(Flag::FASTSTOP);
    plc.assert_fast_stopped();
    let now = plc.now;
    plc.gripper.command(&Command::ACKNOWLEDGE, now);
    assert_eq!(plc.flags() & SystemFlags::FAST_STOP, SystemFlags::empty());
    plc.raise(Flag::MOVE);
    plc.wait(2_000);
    assert_eq!(plc.read().width, 20_00, "the acknowledgement unlocks motion");
}

#[test]
fn jog_follows_the_dial_without_a_halt() {
    let mut plc = Plc::homed(None);
    plc.raise(Flag::JOG_MINUS);
    plc.wait(200);
    let mut before = -100.0;
    // Speed and force limit of the dial; 0 selects the minimum speed.
    for (speed, force_limit) in [(30_00, 40_00), (30_00, 10_00), (60_00, 10_00), (90_00, 40_00), (0, 20_00)] {
        plc.change(|image| (image.speed, image.force_limit) = (speed, force_limit));
        let end = -f32::from(speed.max(5_00)) / 100.0;
        for ms in 0..150 {
            let state = plc.gripper.state();
            let range = f32::min(before, end)..=f32::max(before, end);
            assert!(
                range.contains(&state.speed),
                "{} mm/s {ms} ms after the dial went to {end}",
                state.speed
            );
            plc.wait(1);
        }
        let state = plc.gripper.state();
        assert_eq!((state.speed, state.force_limit), (end, f32::from(force_limit) / 100.0));
        before = end;
    }
    assert_eq!(plc.flags() & SystemFlags::AXIS_STOPPED, SystemFlags::empty());
    assert_eq!(plc.shows(), (Shown::RELEASING, Status::CmdPending));
}

/// Command set, 3.3.5: limits 20 to 80 mm with fingers at 10 mm, and limits 20 to 90 mm with fingers at 110 mm.
#[test]
fn plc_motion_outside_soft_limits_needs_a_target_inside() {
    for (begin, plus, targets, onward, back) in [
        (10_00, 80.0, [18_00, 10_00, 5_00], Flag::JOG_MINUS, Flag::JOG_PLUS),
        (110_00, 90.0, [95_00, 110_00, 109_99], Flag::JOG_PLUS, Flag::JOG_MINUS),
    ] {
        let mut plc = Plc::homed(None);
        plc.move_to(begin);
        let limits = SoftLimits { minus: 20.0, plus };
        assert_eq!(plc.other(&Command::SetSoftLimits { limits }), Status::Success);
        for (flag, width) in [Flag::MOVE, Flag::RELEASE, Flag::GRIP]
            .into_iter()
            .flat_map(|flag| targets.map(|width| (flag, width)))
        {
            plc.change(|image| image.width = width);
            plc.raise(flag);
            plc.wait(500);
            assert_eq!(plc.shows(), (Shown::ERROR, Status::RangeError), "{flag:?} {width}");
            assert_eq!(plc.read().width, begin);
            plc.change(|image| image.flags = Flag::STOP_ACK);
            plc.lower(Flag::STOP_ACK);
        }
        plc.raise(onward);
        plc.wait(500);
        assert_eq!((plc.shows(), plc.read().width), ((Shown::IDLE, Status::RangeError), begin), "{onward:?}");
        plc.lower(onward);
        plc.raise(back);
        plc.wait(3_000);
        assert_eq!(plc.shows(), (Shown::IDLE, Status::Success), "{back:?}");
        let end = if back == Flag::JOG_PLUS { plus * 100.0 } else { 20_00.0 };
        assert_eq!(f32::from(plc.read().width), end);
        plc.lower(back);
        plc.move_to(50_00);
    }
}

#[test]
fn jog_ends_when_the_connection_that_wrote_last_is_gone() {
    let mut plc = Plc::homed(None);
    let other = plc.gripper.connect(PortKind::ModbusTcp).unwrap();
    plc.raise(Flag::JOG_MINUS);
    plc.wait(100);
    plc.gripper.disconnect(plc.port, plc.now);
    plc.port = other;
    plc.assert_stands();
    assert_eq!(plc.shows(), (Shown::IDLE, Status::Success));
    assert_eq!(plc.flags() & SystemFlags::FAST_STOP, SystemFlags::empty());
    // The level alone does not restart it.
    plc.write();
    plc.assert_stands();
    plc.lower(Flag::JOG_MINUS);
    plc.raise(Flag::JOG_MINUS);
    plc.wait(100);
    assert_eq!(plc.gripper.state().speed, -100.0);
}

#[test]
fn connection_that_only_reads_may_go_at_any_time() {
    let mut plc = Plc::homed(None);
    let watcher = plc.gripper.connect(PortKind::ModbusTcp).unwrap();
    plc.raise(Flag::JOG_MINUS);
    plc.wait(100);
    assert_eq!(plc.ask_from(watcher, &[4, 0, 0, 0, 6]).len(), 14);
    plc.gripper.disconnect(watcher, plc.now);
    plc.wait(10);
    assert_eq!(plc.gripper.state().speed, -100.0);
}

#[test]
fn motion_continues_when_the_last_master_disconnects() {
    let mut plc = Plc::homed(None);
    plc.raise(Flag::MOVE);
    plc.wait(100);
    plc.gripper.disconnect(plc.port, plc.now);
    plc.wait(2_000);
    plc.port = plc.gripper.connect(PortKind::ModbusTcp).unwrap();
    assert_eq!(plc.shows(), (Shown::IDLE, Status::Success));
    assert_eq!(plc.read().width, 20_00);
    // The image is kept, so the same flag is not an edge.
    plc.change(|image| image.width = 80_00);
    plc.assert_stands();
}

#[test]
fn time_out_ends_a_jog_at_any_reaction_and_a_return_is_no_edge() {
    for reaction in [SilenceReaction::Hold, SilenceReaction::Stop] {
        let mut plc = Plc::watched(reaction);
        plc.change(|image| image.speed = 10_00);
        plc.raise(Flag::JOG_MINUS);
        plc.wait(400);
        // A read also restarts the time-out.
        plc.read();
        // The time-out wakes the gripper.
        assert!(plc.gripper.next_wake().is_some());
        plc.wait(499);
        assert!(plc.gripper.state().speed < 0.0, "{reaction:?}: not yet");
        plc.wait(1);
        assert_eq!(plc.gripper.state().speed, 0.0, "{reaction:?}");
        // Jog and motion flags of the next write take effect only after they have been 0.
        plc.write();
        plc.assert_stands();
        plc.change(|image| image.flags = Flag::GRIP);
        plc.assert_stands();
        plc.change(|image| image.flags = Flag::empty());
        plc.raise(Flag::GRIP);
        plc.wait(100);
        assert!(plc.gripper.state().speed < 0.0, "{reaction:?}: an edge starts the jog");
    }
}

#[test]
fn silent_master_holds_stops_or_fast_stops_a_motion_as_set() {
    for (reaction, moves, is_fast_stopped) in [
        (SilenceReaction::Hold, true, false),
        (SilenceReaction::Stop, false, false),
        (SilenceReaction::FastStop, false, true),
    ] {
        let mut plc = Plc::watched(reaction);
        plc.change(|image| (image.width, image.speed) = (0, 10_00));
        plc.raise(Flag::MOVE);
        plc.wait(499);
        assert!(plc.gripper.state().speed < 0.0);
        plc.wait(1);
        assert_eq!(plc.gripper.state().speed < 0.0, moves, "{reaction:?}");
        assert_eq!(plc.flags().contains(SystemFlags::FAST_STOP), is_fast_stopped, "{reaction:?}");
        // It happens only once: a silent client does not time out again.
        plc.wait(5_000);
        assert_eq!(plc.flags().contains(SystemFlags::FAST_STOP), is_fast_stopped, "{reaction:?}");
    }
}

#[test]
fn master_that_never_wrote_or_is_not_watched_is_not_missed() {
    let config = Config { bus_timeout_ms: 500, bus_reaction: SilenceReaction::FastStop, ..Config::default() };
    let mut plc = Plc::before_its_first_write(config, Flag::empty());
    plc.read();
    plc.wait(5_000);
    assert_eq!(plc.flags(), SystemFlags::empty());
    let mut plc = Plc::homed(None);
    plc.change(|image| image.speed = 5_00);
    plc.raise(Flag::JOG_MINUS);
    plc.wait(20_000);
    assert!(plc.gripper.state().speed < 0.0, "the default is no time-out");
}

#[test]
fn lost_binary_connection_shows_in_the_registers() {
    let mut plc = Plc::homed(None);
    plc.raise(Flag::MOVE);
    plc.wait(100);
    let binary = plc.gripper.connect(PortKind::Tcp).unwrap();
    plc.gripper.disconnect(binary, plc.now);
    plc.assert_fast_stopped();
    assert_eq!(plc.shows().1, Status::CmdAborted);
}

#[test]
fn force_registers_of_a_wsg_70_count_tenths_of_a_newton() {
    let part = Part::of_width(20.0);
    let mut plc = Plc::homed_with(Config { model: Model::Wsg70, part, ..Config::default() });
    plc.change(|image| image.force_limit = 150_0);
    plc.raise(Flag::GRIP);
    plc.wait(4_000);
    assert_eq!(plc.shows(), (Shown::HOLDING, Status::Success));
    assert_eq!(plc.gripper.state().force_limit, 150.0);
    assert_eq!(plc.read().force, 150_0);
}

#[test]
fn swapped_bytes_are_those_of_the_numbers_alone() {
    let mut plc = Plc::homed_with(Config::default());
    assert_eq!(plc.ask(&[4, 0, 3, 0, 1]), [4, 2, 0x2A, 0xF8], "110.00 mm");
    let config = Config { modbus_swap_bytes: true, ..Config::default() };
    let mut plc = Plc::before_its_first_write(config, Flag::empty());
    plc.image = OutputImage::ZERO;
    plc.write();
    plc.raise(Flag::HOMING);
    plc.wait(4_000);
    plc.lower(Flag::HOMING);
    assert_eq!(plc.ask(&[4, 0, 3, 0, 1]), [4, 2, 0xF8, 0x2A]);
    // 50.00 mm at 100.00 mm/s with 40.00 N; CMDFLAGS is not swapped.
    assert_eq!(plc.ask(&[16, 0, 0, 0, 4, 8, 0x01, 0, 0x88, 0x13, 0x10, 0x27, 0xA0, 0x0F]), [16, 0, 0, 0, 4]);
    plc.wait(2_000);
    assert_eq!(plc.width(), 50.0);
}

#[test]
fn coils_and_registers_are_two_views_of_one_image() {
    let mut plc = Plc::homed(None);
    // FC 5: coil 0 is MOVE.
    assert_eq!(plc.ask(&[5, 0, 0, 0xFF, 0]), [5, 0, 0, 0xFF, 0]);
    assert_eq!(plc.shows().0, Shown::POSITIONING);
    assert_eq!(plc.ask(&[3, 0, 0, 0, 1]), [3, 2, 1, 0], "bit 8 of register 0");
    // FC 2: discrete input 6 is POSITIONING, 16 is REFERENCED, 17 is MOVING.
    assert_eq!(plc.ask(&[2, 0, 0, 0, 8]), [2, 1, 1 << 6]);
    plc.wait(50);
    assert_eq!(plc.ask(&[2, 0, 16, 0, 2]), [2, 1, 0b11]);
    // FC 22 clears the flag and leaves the rest. No parameter changes, so nothing stops.
    assert_eq!(plc.ask(&[22, 0, 0, 0, 0xFF, 0, 0]), [22, 0, 0, 0, 0xFF, 0, 0]);
    assert_eq!(plc.shows().0, Shown::POSITIONING);
    // FC 23 writes before it reads: IF6.
    assert_eq!(plc.ask(&[23, 0, 0, 0, 1, 0, 0, 0, 1, 2, 0, 0x20]), [23, 2, 0, 0x20]);
    plc.wait(2_000);
    assert_eq!(plc.shows(), (Shown::IDLE, Status::Success));
}

#[test]
fn clients_share_one_output_image_and_see_one_state() {
    let mut plc = Plc::homed(None);
    let other = plc.gripper.connect(PortKind::ModbusTcp).unwrap();
    plc.raise(Flag::MOVE);
    assert_eq!(plc.ask_from(other, &[3, 0, 0, 0, 2]), [3, 4, 1, 0, 0x07, 0xD0]);
    // The other client stops the motion of the first.
    plc.wait(100);
    assert_eq!(plc.ask_from(other, &[5, 0, 4, 0xFF, 0]), [5, 0, 4, 0xFF, 0]);
    assert_eq!(plc.shows(), (Shown::IDLE, Status::Success));
    plc.assert_stands();
}

#[test]
fn many_identifications_at_once_are_all_answered() {
    // The longest answer to the shortest request, as many as a server reads at once.
    let mut plc = Plc::new(Config::default());
    let request = [0, 1, 0, 0, 0, 5, 1, 0x2B, 0x0E, 1, 0];
    let count = 256 / request.len() + 1;
    plc.gripper.receive(plc.port, plc.now, &request.repeat(count));
    let mut buffer = [0; MAX_FRAME_LEN];
    let answers = std::iter::from_fn(|| plc.gripper.transmit(plc.port, &mut buffer).map(<[u8]>::len));
    assert_eq!(answers.count(), count);
    assert_eq!(plc.gripper.counters(plc.port).unwrap().replies_lost, 0);
}

#[test]
fn stream_without_a_way_to_its_next_frame_is_over() {
    let mut plc = Plc::homed(None);
    // A frame of another protocol is skipped. After a length of 0 nothing is accepted, not even a MOVE.
    let foreign = [0, 1, 0, 9, 0, 6, 1, 5, 0, 0, 0xFF, 0];
    let read = [0, 2, 0, 0, 0, 6, 1, 3, 0, 0, 0, 1];
    let none = [0, 3, 0, 0, 0, 0];
    let motion = [0, 4, 0, 0, 0, 6, 1, 5, 0, 0, 0xFF, 0];
    plc.gripper.receive(plc.port, plc.now, &[&foreign, &read].map(|frame| &frame[..]).concat());
    assert!(!plc.gripper.is_lost(plc.port));
    plc.gripper.receive(plc.port, plc.now, &[&none[..], &motion].concat());
    let mut buffer = [0; MAX_FRAME_LEN];
    assert_eq!(plc.gripper.transmit(plc.port, &mut buffer), Some(&[0, 2, 0, 0, 0, 5, 1, 3, 2, 0, 0][..]));
    assert_eq!(plc.gripper.transmit(plc.port, &mut buffer), None);
    assert!(plc.gripper.is_lost(plc.port));
    let counters = plc.gripper.counters(plc.port).unwrap().parser;
    assert_eq!((counters.dropped, counters.oversize), (12, 1));
    plc.assert_stands();
}
