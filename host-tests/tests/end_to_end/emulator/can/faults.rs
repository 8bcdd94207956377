//! Faults of a CAN bus: bus-off, missing acknowledgement, full mailboxes, overrun, foreign frames.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use embedded_can::Id;
use host_tests::bxcan::Bxcan;
use host_tests::can_bus::{CanBus, Fault};
use host_tests::can_controller::{BusController, MappedController};
use host_tests::can_wire::WireFrame;
use host_tests::fdcan::Fdcan;
use host_tests::mcp2515::Mcp2515;
use host_tests::modbus_master::Master;
use host_tests::rig::{PATIENCE, motions};
use host_tests::trace::Entry;
use host_tests::world::with_part;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::CommandId;
use wsg_sim::Config;

use super::super::wait_until;
use super::{BOTH_ON_CAN, CanBoard, GRIPPER_ON_CAN, Plant, READY, assert_one_cycle};

/// Identifiers with default settings: the gripper's messages, and the bridge's TPDO1.
const FROM_GRIPPER: u16 = 0x121;
const TPDO1: u16 = 0x190;

impl<C: CanBoard> Plant<C> {
    /// Returns a Modbus master on the bridge's bus.
    fn master(&mut self) -> Master {
        let mut master = self.rig.master(1).unwrap();
        master.allow_pauses().unwrap();
        master
    }

    /// Waits until LINK_OK has this level.
    fn await_link(&self, level: bool) {
        self.rig.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::LINK_OK) == level).unwrap();
    }

    /// Returns the motions that the bridge has sent since the mark.
    fn motions_since(&self, mark: usize) -> Vec<CommandId> {
        motions(&self.rig.trace().since(mark))
    }

    /// Waits until the bridge has sent this command since the mark.
    fn await_command(&self, mark: usize, command: CommandId) {
        let is_sent = self.rig.trace().wait(mark, PATIENCE, |entry| entry.command() == Some(command));
        assert!(is_sent, "{command}: {:?}", self.received_since(mark));
    }

    fn faults(&self) -> (bool, bool, bool) {
        self.bus.controller().faults()
    }

    /// Returns the commands that the gripper has received since the mark.
    fn received_since(&self, mark: usize) -> Vec<CommandId> {
        self.rig.trace().since(mark).iter().filter_map(Entry::command).collect()
    }
}

/// A controller of an STM32, whose transmit buffers the test sees: buffer 0 is for the gripper.
trait Buffers: CanBoard {
    /// Returns the empty buffers as bits.
    fn empty_buffers(&mut self) -> u32;
}

impl Buffers for Bxcan {
    fn empty_buffers(&mut self) -> u32 {
        const TSR: u32 = 0x08;
        self.load(TSR).unwrap() >> 26 & 0b111
    }
}

impl Buffers for Fdcan {
    fn empty_buffers(&mut self) -> u32 {
        const TXBRP: u32 = 0xC8;
        !self.load(TXBRP).unwrap() & 0b111
    }
}

/// A node that keeps the bus busy with these frames, in turn, until it is dropped.
struct Storm {
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Number of frames that wait for the bus at any time.
const STORM_QUEUE: usize = 200;

impl Storm {
    fn on<C: CanBoard>(bus: &CanBus<C>, frames: &'static [WireFrame]) -> Self {
        let is_over = Arc::new(AtomicBool::new(false));
        let (station, over) = (bus.join(), Arc::clone(&is_over));
        let thread = thread::spawn(move || {
            let mut frames = frames.iter().cycle();
            while !over.load(Ordering::Relaxed) {
                let missing = STORM_QUEUE.saturating_sub(station.waiting());
                frames.by_ref().take(missing).for_each(|frame| station.send(*frame));
                // The content of received frames is irrelevant. They set the pace.
                let _ = station.received.recv_timeout(Duration::from_millis(1));
            }
        });
        Self { is_over, thread: Some(thread) }
    }
}

impl Drop for Storm {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn bus_off_in_a_motion_is_shown_and_fast_stop_comes_first<C: CanBoard>() {
    // At the real gripper's speed, homing takes longer than bus-off.
    let mut plant = Plant::<C>::ready(GRIPPER_ON_CAN, Config::default());
    let mut master = plant.master();
    plant.rig.set(Inputs::HOME, true).unwrap();
    plant.rig.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::BUSY)).unwrap();
    plant.rig.set(Inputs::HOME, false).unwrap();

    plant.bus.set_fault(Fault::ShortCircuit);
    let lost = |outputs: Outputs| outputs.contains(Outputs::ERROR) && !outputs.contains(Outputs::LINK_OK);
    plant.rig.await_outputs(PATIENCE, lost).unwrap();
    // On a busy host the gripper may have stopped responding shortly before.
    wait_until("bus-off or recovering", || master.report("CAN_STATE").unwrap(), |state| state & 0x7F != 0);
    plant.rig.set(Inputs::FAST_STOP_OK, false).unwrap();
    plant.rig.pass(20).unwrap();
    let mark = plant.rig.trace().mark();
    plant.bus.set_fault(Fault::None);
    plant.await_link(true);

    let received = plant.received_since(mark);
    assert_eq!(received.first(), Some(&CommandId::FastStop), "{received:?}");
    plant.rig.set(Inputs::FAST_STOP_OK, true).unwrap();
    plant.rig.release_fast_stop().unwrap();
    assert_eq!(plant.motions_since(mark), [], "the motion must not continue");
    assert_eq!(plant.faults(), (false, false, false), "the bus must have recovered");
    assert_eq!(["CAN_STATE", "CAN_BUS_OFFS"].map(|name| master.report(name).unwrap()), [0, 1]);
    assert!(plant.rig.gripper().state().speed.abs() < 0.001);
    C::assert_set_up(plant.rig.board(), &plant.bus, GRIPPER_ON_CAN.1);
}

fn a_command_without_an_acknowledgement_is_not_sent_later<C: CanBoard>() {
    let mut plant = Plant::<C>::ready(GRIPPER_ON_CAN, with_part(20.0));
    let mut master = plant.master();

    plant.bus.set_fault(Fault::Cut);
    let mark = plant.rig.trace().mark();
    plant.rig.set(Inputs::HOME, true).unwrap();
    plant.await_link(false);
    plant.rig.set(Inputs::HOME, false).unwrap();
    assert_eq!(master.report("CAN_STATE").unwrap(), 0x80, "must be error passive, not bus-off");
    assert_eq!(plant.faults(), (false, true, true));
    plant.bus.set_fault(Fault::None);
    plant.await_link(true);

    plant.rig.release_fast_stop().unwrap();
    assert_eq!(plant.motions_since(mark), []);
    assert_eq!(master.report("CAN_BUS_OFFS").unwrap(), 0);
    plant.command(Inputs::HOME, READY | Outputs::REFERENCED);
    assert_eq!(plant.motions_since(mark), [CommandId::Homing]);
}

/// Without an acknowledgement, the motion waits in a mailbox until it is withdrawn. The bus recovers before LINK_OK falls.
fn motion_that_waits_for_the_bus_is_withdrawn_by_any_stop<C: CanBoard>() {
    for (wire, high, command) in
        [(Inputs::STOP_ACK, true, CommandId::Stop), (Inputs::FAST_STOP_OK, false, CommandId::FastStop)]
    {
        let plant = Plant::<C>::ready(GRIPPER_ON_CAN, with_part(20.0));
        let (mark, sent) = (plant.rig.trace().mark(), plant.bus.sent().len());
        plant.bus.set_fault(Fault::Cut);
        plant.rig.set(Inputs::HOME, true).unwrap();
        plant.rig.pass(20).unwrap();
        plant.rig.set(wire, high).unwrap();
        plant.rig.pass(20).unwrap();
        assert_eq!(plant.motions_since(mark), [], "nothing is sent over the cut bus");
        plant.bus.set_fault(Fault::None);
        plant.await_command(mark, command);
        plant.rig.pass(300).unwrap();
        assert_eq!(plant.motions_since(mark), [], "{command}: {:?}", plant.received_since(mark));
        // The gripper would discard a message without its end, so the frames count.
        let begins_to_home = |frame: &&WireFrame| frame.data.starts_with(&[0xAA, 0xAA, 0xAA, 0x20]);
        assert_eq!(plant.bus.sent()[sent..].iter().find(begins_to_home), None, "{command}");
    }
}

fn fast_stop_does_not_wait_for_mailboxes_that_are_full<C: Buffers>() {
    let plant = Plant::<C>::ready(BOTH_ON_CAN, with_part(20.0));
    let master = plant.bus.join();
    // Lower priority than messages to the gripper, higher than frames to the PLC.
    static BETWEEN: [WireFrame; 1] = [WireFrame { id: id(0x150), is_remote: false, dlc: 8, data: [0; 8] }];
    let empty_mailboxes = || plant.bus.controller().empty_buffers();
    let await_heartbeat =
        || wait_until("a heartbeat in mailbox 1", empty_mailboxes, |empty| empty & 0b010 == 0);
    // A second heartbeat, half a second after the first, could be sent first from another mailbox.
    let storm = Storm::on(&plant.bus, &BETWEEN);
    await_heartbeat();
    plant.rig.pass(1_100).unwrap();
    assert_eq!(empty_mailboxes() & 0b100, 0b100, "at most one frame per identifier in the mailboxes");
    drop(storm);
    // The queued frames are sent, and the next heartbeat is alone.
    plant.rig.pass(600).unwrap();
    let storm = Storm::on(&plant.bus, &BETWEEN);
    await_heartbeat();
    // Start the node by NMT before the next heartbeat, so that it sends PDOs.
    master.send(WireFrame::standard(0, &[1, 0x10]));
    wait_until("full mailboxes", empty_mailboxes, |empty| empty & 0b110 == 0);

    let (mark, sent) = (plant.rig.trace().mark(), plant.bus.sent().len());
    plant.rig.set(Inputs::FAST_STOP_OK, false).unwrap();
    plant.await_command(mark, CommandId::FastStop);

    assert_eq!(empty_mailboxes() & 0b110, 0, "the earlier frames must still be in the mailboxes");
    let pdos = || plant.bus.sent().iter().skip(sent).filter(|frame| frame.id == id(TPDO1)).count();
    assert_eq!(pdos(), 0);
    drop(storm);
    wait_until("a PDO on the free bus", pdos, |count| *count > 0);
}

fn an_overrun_is_counted_and_moves_nothing<C: CanBoard>() {
    let mut plant = Plant::<C>::ready(GRIPPER_ON_CAN, with_part(20.0));
    let mut master = plant.master();
    assert_eq!(master.report("CAN_OVERRUNS").unwrap(), 0);
    let mark = plant.rig.trace().mark();

    // Heartbeats of another node, which pass the filters.
    plant.bus.burst(&[WireFrame::standard(0x701, &[5]); 5]);

    wait_until("an overrun", || master.report("CAN_OVERRUNS").unwrap(), |count| *count > 0);
    assert_eq!(master.report("CAN_OVERRUNS").unwrap(), 1);
    assert_eq!(plant.motions_since(mark), []);
    plant.command(Inputs::HOME, READY | Outputs::REFERENCED);
}

#[test]
#[ignore = "needs rp2040js and the firmware image with the gripper on CAN: run `cargo xtask test`"]
fn frames_without_pauses_are_all_received_in_rp2040js() {
    const FRAMES: usize = 200;
    let plant = Plant::<Mcp2515>::ready(GRIPPER_ON_CAN, with_part(20.0));
    // The shortest frames, with the identifier of another node's heartbeat, which passes the filters.
    static HEARTBEAT: WireFrame = WireFrame { id: id(0x701), is_remote: false, dlc: 0, data: [0; 8] };
    let node = plant.bus.join();
    let is_heartbeat = |frame: &&WireFrame| frame.id == HEARTBEAT.id;
    (0..FRAMES).for_each(|_| node.send(HEARTBEAT));
    let received = || plant.bus.controller().accepted().iter().filter(is_heartbeat).count();
    wait_until("all frames", received, |count| *count >= FRAMES);
    plant.command(Inputs::HOME, READY | Outputs::REFERENCED);
    assert_eq!(plant.bus.controller().lost(), []);
}

fn a_full_bus_of_foreign_frames_disturbs_nothing<C: CanBoard>() {
    let wanted = [0x000, FROM_GRIPPER, 0x210, 0x610, 0x701];
    // Unused identifiers, 29-bit identifiers that begin with used ones, and remote frames of used ones.
    let foreign = [0x122, 0x300, 0x7FF].map(|id| WireFrame::standard(id, &[0xAA; 8]));
    let extended = wanted.map(|id| WireFrame::extended(u32::from(id) << 18 | 0x2AAAA, &[0xAA; 8]));
    let remote = wanted.map(|id| WireFrame::standard(id, &[0; 8]).remote());
    // NMT identifiers and the like are excluded, because they would starve the gripper's frames.
    let frames: Vec<_> = foreign.into_iter().chain(extended).chain(remote).collect();
    let (urgent, others): (Vec<_>, Vec<_>) = frames
        .into_iter()
        .partition(|frame| frame.arbitration() < WireFrame::standard(0x120, &[]).arbitration());
    let others: &[WireFrame] = others.leak();
    let plant = Plant::<C>::ready(GRIPPER_ON_CAN, with_part(20.0));
    let once = plant.bus.join();
    urgent.iter().for_each(|frame| once.send(*frame));
    let storm = Storm::on(&plant.bus, others);
    plant.command(Inputs::HOME, READY | Outputs::REFERENCED);
    plant.command(Inputs::GRIP, READY | Outputs::REFERENCED | Outputs::HOLDING);
    plant.command(Inputs::RELEASE, READY | Outputs::REFERENCED);
    drop(storm);

    assert_one_cycle(&plant.rig);
    assert_eq!(once.waiting(), 0);
    let wanted = id(FROM_GRIPPER);
    assert!(plant.bus.controller().filters_hold(|frame| frame.id == wanted && !frame.is_remote));
    assert_eq!(plant.rig.board().outputs(), READY | Outputs::REFERENCED);
}

const fn id(raw: u16) -> Id {
    match embedded_can::StandardId::new(raw) {
        Some(id) => Id::Standard(id),
        None => panic!("11 bits"),
    }
}

on_every_board!(controller =>
    bus_off_in_a_motion_is_shown_and_fast_stop_comes_first,
    a_command_without_an_acknowledgement_is_not_sent_later,
    motion_that_waits_for_the_bus_is_withdrawn_by_any_stop,
    an_overrun_is_counted_and_moves_nothing,
    a_full_bus_of_foreign_frames_disturbs_nothing,
);

mod mailboxes {
    use super::*;

    on_every_board!(controller_in_qemu => fast_stop_does_not_wait_for_mailboxes_that_are_full);
}
