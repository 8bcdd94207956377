//! Updates in the field, over each transport: the transfer, its refusals, and what the gripper notices of them.

use host_tests::addresses::report;
use host_tests::flash_model::FlashModel;
use host_tests::slot_model::{self, SECTOR_LEN, SlotModel};
use host_tests::world::canopen::NODE;
use host_tests::world::modbus::UNIT;
use host_tests::world::{BOARD, World, quick, with_part};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::registers::{COMMAND_KEY, COMMANDS, EventCode, FIRST_COMMAND, UpdateRefusal};
use wsg_bridge_fw::{Config, PlcBus, ResetCause};
use wsg_protocol::{CommandId, SystemFlags};

/// Connection of a master.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Over {
    Service,
    Bus,
    Canopen,
}

const ALL: [Over; 3] = [Over::Service, Over::Bus, Over::Canopen];

/// Bytes of a block: the most of a request with file records.
const BLOCK_LEN: usize = 244;

/// Values of UPDATE_STATE.
const NONE: u16 = 0;
const RECEIVES: u16 = 1;
const RECEIVED: u16 = 3;
const REFUSED: u16 = 4;

const BUSY: Result<(), u32> = Err(6);
const DEVICE_STATE: Result<(), u32> = Err(0x0800_0022);

/// Returns an image of about this length with its signature.
fn signed(len: usize) -> Vec<u8> {
    slot_model::signed(len, BOARD.name, [1, 2, 3])
}

/// A bridge with a boot loader, whose master is on one of its connections.
struct Rig {
    world: World,
    over: Over,
    toggle: bool,
}

impl Rig {
    /// Returns a bridge with referenced fingers.
    fn homed(over: Over) -> Self {
        Self::of(over, World::homed(Self::config(over), quick()))
    }

    fn config(over: Over) -> Config {
        let plc_bus = if over == Over::Canopen { PlcBus::Canopen } else { PlcBus::Modbus };
        Config { plc_bus, ..Config::DEFAULT }
    }

    fn of(over: Over, mut world: World) -> Self {
        let slot = SlotModel::new();
        slot.flash.set_busy_polls(2);
        world.flash.slot = Some(slot);
        world.pass(2);
        world.take_sent();
        Self { world, over, toggle: false }
    }

    fn slot(&mut self) -> &mut SlotModel {
        self.world.flash.slot.as_mut().expect("there is a boot loader")
    }

    /// Resets the bridge, whose boot loader exchanges the slots if that was requested.
    fn reset(&mut self) {
        let flash = self.slot().flash.clone();
        self.world.flash.slot = Some(SlotModel::started(flash).expect("slot A has a signed image"));
        self.world.restart_bridge(ResetCause::Firmware);
        self.world.pass(200);
    }

    /// Sends a request, and waits for the response as long as a patient master. Fails with the exception.
    fn modbus(&mut self, over: Over, pdu: &[u8]) -> Result<Vec<u8>, u32> {
        let request = [&[UNIT][..], pdu].concat();
        let line = |world: &mut World| match over {
            Over::Service => std::mem::take(&mut world.service),
            _ => std::mem::take(&mut world.modbus),
        };
        let put = |world: &mut World, line| match over {
            Over::Service => world.service = line,
            _ => world.modbus = line,
        };
        let mut asked = line(&mut self.world);
        asked.ask(&request);
        put(&mut self.world, asked);
        for _ in 0..1_500 {
            self.world.step();
            let mut asked = line(&mut self.world);
            let answer = asked.answer();
            put(&mut self.world, asked);
            if let Some(answer) = answer {
                let data = &answer[2..answer.len() - 2];
                return if answer[1] & 0x80 == 0 { Ok(data.to_vec()) } else { Err(data[0].into()) };
            }
        }
        panic!("no response to {request:02X?}");
    }

    fn sdo(&mut self, request: [u8; 8]) -> Result<(), u32> {
        self.world.can.take_frames();
        self.world.can.send(0x600 | u16::from(NODE.node), &request);
        for _ in 0..1_500 {
            self.world.step();
            let frames = self.world.can.take_frames();
            let answer = frames.into_iter().find(|(_, id, _)| *id == 0x580 | u16::from(NODE.node));
            if let Some((_, _, data)) = answer {
                let code = u32::from_le_bytes(data[4..].try_into().unwrap());
                return if data[0] == 0x80 { Err(code) } else { Ok(()) };
            }
        }
        panic!("no response to {request:02X?}");
    }

    /// Sends the first bytes, or the next ones at this offset.
    fn block(&mut self, at: usize, bytes: &[u8]) -> Result<(), u32> {
        if self.over == Over::Canopen {
            if at == 0 {
                self.toggle = false;
                self.sdo([0x20, 0x50, 0x1F, 1, 0, 0, 0, 0])?;
            }
            return bytes.chunks(7).try_for_each(|segment| self.segment(segment, false));
        }
        self.record(self.over, at, bytes)
    }

    fn record(&mut self, over: Over, at: usize, bytes: &[u8]) -> Result<(), u32> {
        let [f1, f0] = (1 + at / 20_000).to_be_bytes().last_chunk().copied().unwrap();
        let [r1, r0] = (at % 20_000 / 2).to_be_bytes().last_chunk().copied().unwrap();
        let pdu = [&[21, 7 + bytes.len() as u8, 6, f1, f0, r1, r0, 0, bytes.len() as u8 / 2], bytes].concat();
        self.modbus(over, &pdu).map(|echo| assert_eq!(echo, pdu[1..]))
    }

    fn segment(&mut self, bytes: &[u8], is_last: bool) -> Result<(), u32> {
        let mut frame = [0; 8];
        frame[0] = u8::from(self.toggle) << 4 | (7 - bytes.len() as u8) << 1 | u8::from(is_last);
        frame[1..=bytes.len()].copy_from_slice(bytes);
        self.toggle = !self.toggle;
        self.sdo(frame)
    }

    fn command(&mut self, over: Over, name: &str) -> Result<(), u32> {
        let place = COMMANDS.iter().position(|it| it.name == name).expect("a command");
        let ([a1, a0], [k1, k0]) = ((FIRST_COMMAND + place as u16).to_be_bytes(), COMMAND_KEY.to_be_bytes());
        self.modbus(over, &[6, a1, a0, k1, k0]).map(drop)
    }

    /// Ends the transfer, and waits for the end of the check.
    fn check(&mut self) -> u16 {
        let _ = match self.over {
            Over::Canopen => self.segment(&[], true),
            over => self.command(over, "UPDATE_CHECK"),
        };
        for _ in 0..1_000 {
            let state = self.report("UPDATE_STATE");
            if state != 2 {
                return state;
            }
        }
        panic!("the check does not end");
    }

    fn restart(&mut self) -> Result<(), u32> {
        match self.over {
            Over::Canopen => self.sdo([0x2F, 0x51, 0x1F, 1, 1, 0, 0, 0]),
            over => self.command(over, "UPDATE_RESTART"),
        }
    }

    /// Sends a file in blocks, and returns the state after the check.
    fn send(&mut self, file: &[u8]) -> u16 {
        for (number, block) in file.chunks(BLOCK_LEN).enumerate() {
            assert_eq!(self.block(number * BLOCK_LEN, block), Ok(()), "{:?} {number}", self.over);
        }
        self.check()
    }

    /// Reads a report at the service port, which any other master leaves undisturbed.
    fn report(&mut self, name: &str) -> u16 {
        let [a1, a0] = report(name).to_be_bytes();
        let data = self.modbus(Over::Service, &[4, a1, a0, 0, 1]).expect("the report exists");
        u16::from_be_bytes([data[1], data[2]])
    }

    fn refusal(&mut self) -> Option<UpdateRefusal> {
        UpdateRefusal::from_code(self.report("UPDATE_REFUSAL"))
    }

    /// Gives an edge of each command wire. Returns whether a motion was sent.
    fn moves(&mut self) -> bool {
        for wire in [Inputs::MOVE, Inputs::GRIP, Inputs::RELEASE, Inputs::HOME] {
            self.world.set(wire, true);
            self.world.pass(20);
            self.world.set(wire, false);
            self.world.pass(20);
        }
        !self.world.take_motions().is_empty()
    }

    fn outputs(&mut self) -> Outputs {
        self.world.pass(2);
        self.world.outputs()
    }
}

#[test]
fn image_is_received_checked_and_started_after_a_fast_stop() {
    let file = signed(3 * SECTOR_LEN - 200);
    for over in ALL {
        let mut rig = Rig::homed(over);
        assert!(rig.outputs().contains(Outputs::READY));
        assert_eq!(rig.block(0, &file[..BLOCK_LEN]), Ok(()));
        assert_eq!(rig.report("UPDATE_STATE"), RECEIVES);
        assert!(rig.outputs().contains(Outputs::ERROR) && !rig.outputs().contains(Outputs::READY));
        assert_eq!(rig.report("ERROR_CAUSE"), EventCode::UpdateRuns as u16);
        assert!(!rig.moves(), "{over:?}");

        assert_eq!(rig.send(&file), RECEIVED, "{over:?}: {:?}", rig.refusal());
        assert_eq!(rig.slot().bytes(file.len()), file, "{over:?}");
        let at = |rig: &mut Rig, name: &str| {
            let [high, low] = ["HIGH", "LOW"].map(|half| u32::from(rig.report(&format!("{name}_{half}"))));
            high << 16 | low
        };
        assert_eq!(at(&mut rig, "UPDATE_BYTES"), file.len() as u32);
        assert_eq!((rig.report("SLOT_B_VERSION"), rig.report("SLOT_B_PATCH")), (0x0102, 3));
        assert!(!rig.moves(), "{over:?}");
        rig.world.take_sent();
        assert_eq!((rig.slot().marks, rig.slot().restarts), (0, 0));
        assert_eq!(rig.restart(), Ok(()));
        for _ in 0..200 {
            if rig.slot().restarts > 0 {
                break;
            }
            assert_eq!(rig.slot().marks, 0);
            rig.world.step();
        }
        assert_eq!((rig.slot().marks, rig.slot().restarts), (1, 1), "{over:?}");
        assert!(rig.world.take_sent().contains(&CommandId::FastStop));
        let flags = rig.world.bridge().session().known().flags.expect("the gripper is connected");
        assert!(flags.contains(SystemFlags::FAST_STOP), "{over:?}: {flags:?}");
        assert_eq!(rig.report("FAST_STOP_CAUSE"), EventCode::UpdateRestart as u16);
        assert!(!rig.moves());
    }
}

#[test]
fn damaged_shorter_longer_or_reordered_image_is_never_started() {
    let file = signed(3 * SECTOR_LEN - 200);
    let blocks = file.len().div_ceil(BLOCK_LEN);
    for over in ALL {
        let mut damaged: Vec<Vec<u8>> = Vec::new();
        for number in 0..blocks {
            let block = number * BLOCK_LEN..file.len().min((number + 1) * BLOCK_LEN);
            let mut flipped = file.clone();
            flipped[block.start + number * 11 % block.len()] ^= 1 << (number % 8);
            let swapped = [&file[..block.start], &file[block.end..], &file[block.clone()]].concat();
            damaged.extend([flipped, file[..block.start].to_vec(), swapped]);
        }
        damaged.extend([[&file[..], &[0; 2]].concat(), [&file[..], &file[..BLOCK_LEN]].concat()]);
        let mut rig = Rig::homed(over);
        // Its end is in the flash before each truncated transfer.
        assert_eq!(rig.send(&file), RECEIVED);
        for wrong in damaged.iter().filter(|wrong| **wrong != file && !wrong.is_empty()) {
            assert_eq!(rig.send(wrong), REFUSED, "{over:?}");
            assert!(rig.refusal().is_some_and(|why| why as u16 > 10), "{over:?}: {:?}", rig.refusal());
            assert!(rig.outputs().contains(Outputs::READY), "motions are possible again");
            assert!(rig.restart().is_err());
        }
        assert_eq!((rig.slot().marks, rig.slot().restarts), (0, 0));
        assert_eq!(rig.send(&file), RECEIVED);
    }
}

#[test]
fn blocks_are_accepted_in_order_and_the_last_one_again() {
    let file = signed(2_000);
    let block = |number: usize| &file[number * BLOCK_LEN..][..BLOCK_LEN];
    for over in [Over::Service, Over::Bus] {
        let mut rig = Rig::homed(over);
        assert_eq!(rig.block(BLOCK_LEN, block(1)), Err(2), "none is the first");
        for number in 0..3 {
            for _ in 0..3 {
                assert_eq!(rig.block(number * BLOCK_LEN, block(number)), Ok(()));
            }
            for wrong in [number + 2, number.saturating_sub(1)] {
                let is_first = wrong == 0;
                if !is_first {
                    assert_eq!(rig.block(wrong * BLOCK_LEN, block(wrong)), Err(2), "{wrong} after {number}");
                    assert_eq!(rig.refusal(), Some(UpdateRefusal::OutOfOrder));
                }
            }
            if number > 0 {
                assert_eq!(rig.block(number * BLOCK_LEN, block(4)), Err(2), "other bytes");
            }
        }
        assert_eq!(
            rig.modbus(over, &[21, 18, 6, 0, 1, 2, 0, 0, 1, 0, 0, 6, 0, 1, 2, 1, 0, 1, 0, 0]),
            Err(3),
            "two groups"
        );
        for (number, block) in file.chunks(BLOCK_LEN).enumerate().skip(3) {
            assert_eq!(rig.block(number * BLOCK_LEN, block), Ok(()));
        }
        assert_eq!(rig.check(), RECEIVED);
        assert_eq!(rig.command(over, "UPDATE_CHECK"), Ok(()), "its answer was lost");
        assert_eq!(rig.block(20_000 * 9, block(0)), Err(2));
    }
}

#[test]
fn second_master_is_refused_until_the_first_has_ended() {
    let file = signed(1_000);
    for (over, other) in [(Over::Service, Over::Bus), (Over::Bus, Over::Service)] {
        let mut rig = Rig::homed(over);
        rig.block(0, &file[..BLOCK_LEN]).unwrap();
        assert_eq!(rig.record(other, 0, &file[..BLOCK_LEN]), BUSY);
        assert_eq!(rig.refusal(), Some(UpdateRefusal::OtherMaster));
        assert_eq!(rig.command(other, "UPDATE_CHECK"), BUSY);
        assert_eq!(rig.command(other, "SAVE"), BUSY, "the flash is in use");
        assert_eq!(rig.send(&file), RECEIVED);
        assert_eq!(rig.command(other, "UPDATE_RESTART"), BUSY);
        rig.world.pass(5_000);
        assert_eq!(rig.command(other, "SAVE"), Ok(()));
        assert_eq!(rig.command(other, "UPDATE_RESTART"), BUSY, "the settings are being stored");
        rig.world.pass(500);
        assert_eq!(rig.command(other, "UPDATE_RESTART"), Ok(()));
    }
    let mut rig = Rig::homed(Over::Canopen);
    rig.record(Over::Service, 0, &file[..BLOCK_LEN]).unwrap();
    assert_eq!(rig.block(0, &file), DEVICE_STATE);
    assert_eq!(rig.refusal(), Some(UpdateRefusal::OtherMaster));
}

#[test]
fn update_of_a_master_that_disappears_ends_and_can_be_continued() {
    let file = signed(2 * SECTOR_LEN);
    for cut in [BLOCK_LEN, 5 * BLOCK_LEN, 9 * BLOCK_LEN] {
        let mut rig = Rig::homed(Over::Bus);
        for at in (0..cut).step_by(BLOCK_LEN) {
            rig.block(at, &file[at..at + BLOCK_LEN]).unwrap();
        }
        rig.world.pass(4_700);
        assert!(!rig.moves() && rig.report("UPDATE_STATE") == RECEIVES);
        rig.world.pass(300);
        assert_eq!(rig.report("UPDATE_STATE"), NONE);
        assert!(rig.outputs().contains(Outputs::READY) && rig.moves());
        rig.world.pass(3_000);
        assert_eq!(rig.slot().marks, 0);
        assert_eq!(rig.report("UPDATE_BYTES_LOW"), cut as u16);
        rig.over = Over::Service;
        for (number, block) in file.chunks(BLOCK_LEN).enumerate().skip(cut / BLOCK_LEN) {
            assert_eq!(rig.block(number * BLOCK_LEN, block), Ok(()));
        }
        assert_eq!(rig.check(), RECEIVED);
    }
}

/// A state of gripper and bridge, in which an update may begin or not.
type State = (&'static str, bool, fn(&mut World));

const STATES: [State; 8] = [
    ("unconnected", true, |world| {
        world.set_cut(true);
        world.set(Inputs::FAST_STOP_OK, true);
        world.pass(500);
    }),
    ("fast stop", true, |world| world.pass(500)),
    ("ready", true, World::get_ready),
    ("referenced", true, World::get_homed),
    ("moving", false, |world| {
        world.get_homed();
        world.set(Inputs::MOVE, true);
        assert!(world.until(100, |outputs| outputs.contains(Outputs::BUSY)));
        world.set(Inputs::MOVE, false);
    }),
    ("referencing", false, |world| {
        world.get_ready();
        world.set(Inputs::HOME, true);
        assert!(world.until(100, |outputs| outputs.contains(Outputs::BUSY)));
        world.set(Inputs::HOME, false);
    }),
    ("holding", true, |world| {
        world.get_homed();
        assert!(world.command(Inputs::GRIP).contains(Outputs::HOLDING));
    }),
    ("lost while moving", false, |world| {
        world.get_homed();
        world.set(Inputs::MOVE, true);
        assert!(world.until(100, |outputs| outputs.contains(Outputs::BUSY)));
        world.set_cut(true);
        assert!(world.until(3_000, |outputs| !outputs.contains(Outputs::LINK_OK)));
        world.set(Inputs::MOVE, false);
    }),
];

#[test]
fn update_in_any_state_moves_nothing_and_delays_no_fast_stop() {
    let file = signed(5 * BLOCK_LEN);
    for over in ALL {
        for (name, may_begin, reach) in STATES {
            let mut world =
                World::new(Rig::config(over), wsg_sim::Config { time_scale: 1.0, ..with_part(20.0) });
            reach(&mut world);
            let mut rig = Rig::of(over, world);
            let begun = rig.block(0, &file[..BLOCK_LEN]);
            if !may_begin {
                assert_eq!(begun, if over == Over::Canopen { DEVICE_STATE } else { BUSY }, "{over:?} {name}");
                assert_eq!((rig.refusal(), rig.slot().flash.operations()), (Some(UpdateRefusal::Moving), 0));
                continue;
            }
            assert_eq!(begun, Ok(()), "{over:?} {name}");
            rig.world.take_sent();
            assert!(!rig.moves(), "{over:?} {name}");
            let is_connected = rig.outputs().contains(Outputs::LINK_OK);
            for at in (BLOCK_LEN..file.len() - BLOCK_LEN).step_by(BLOCK_LEN) {
                let was_stopped = !rig.world.inputs.contains(Inputs::FAST_STOP_OK) || !is_connected;
                rig.world.set(Inputs::FAST_STOP_OK, false);
                rig.world.pass(3);
                let sent = rig.world.take_sent();
                assert!(was_stopped || sent.contains(&CommandId::FastStop), "{over:?} {name}: {sent:?}");
                assert_eq!(rig.block(at, &file[at..at + BLOCK_LEN]), Ok(()), "{over:?} {name}");
                rig.world.set(Inputs::FAST_STOP_OK, true);
                rig.world.pass(20);
                rig.world.pulse(Inputs::STOP_ACK);
                rig.world.pass(100);
                assert!(!rig.moves(), "{over:?} {name}");
            }
        }
    }
}

#[test]
fn no_flash_operation_starts_while_a_fast_stop_is_unconfirmed() {
    let file = signed(2_000);
    let mut rig = Rig::homed(Over::Service);
    rig.block(0, &file[..BLOCK_LEN]).unwrap();
    // The gripper does not hear the FAST STOP, but remains connected for a while.
    rig.world.set_cut(true);
    rig.world.set(Inputs::FAST_STOP_OK, false);
    rig.world.pass(3);
    let before = rig.slot().flash.operations();
    let [a, b] = [BLOCK_LEN, 2 * BLOCK_LEN];
    let pdu = [&[21, 251, 6, 0, 1, 0, 122, 0, 122], &file[a..b]].concat();
    rig.world.service.ask(&[&[UNIT][..], &pdu].concat());
    let mut waited = 0;
    while rig.world.bridge().is_connected() {
        assert_eq!(rig.slot().flash.operations(), before);
        rig.world.step();
        waited += 1;
    }
    assert!(waited > 50, "{waited}");
    rig.world.set_cut(false);
    rig.world.pass(1_000);
    assert_eq!(rig.block(a, &file[a..b]), Ok(()), "repeated after the master's time-out");
    assert!(rig.slot().flash.operations() > before);
}

#[test]
fn failing_flash_refuses_the_image_in_bounded_time() {
    let file = signed(3_000);
    let breaks: [fn(&SlotModel); 2] =
        [|slot| slot.flash.set_busy_polls(u32::MAX), |slot| slot.flash.fail_after(20)];
    for breaks in breaks {
        let mut rig = Rig::homed(Over::Service);
        rig.block(0, &file[..BLOCK_LEN]).unwrap();
        breaks(rig.slot());
        assert_eq!(rig.block(BLOCK_LEN, &file[BLOCK_LEN..2 * BLOCK_LEN]), Err(4));
        assert_eq!((rig.report("UPDATE_STATE"), rig.refusal()), (REFUSED, Some(UpdateRefusal::Flash)));
        assert!(rig.outputs().contains(Outputs::READY));
    }
}

/// Course of the time after the first start of a new image.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Trial {
    Passed,
    EndedEarly,
    WithRefusedSettings,
}

#[test]
fn new_image_confirms_itself_after_ten_seconds_or_the_previous_one_returns() {
    let file = signed(3 * SECTOR_LEN);
    for trial in [Trial::Passed, Trial::EndedEarly, Trial::WithRefusedSettings] {
        let mut rig = Rig::homed(Over::Service);
        if trial == Trial::WithRefusedSettings {
            let slot = rig.world.flash.slot.take();
            rig.world.flash = FlashModel::with_record(99, &[0; 20]);
            rig.world.flash.slot = slot;
        }
        assert_eq!(rig.send(&file), RECEIVED);
        assert_eq!(rig.restart(), Ok(()));
        rig.world.pass(1_100);
        assert_eq!(rig.slot().restarts, 1);
        let settings = rig.world.flash.operations;
        rig.reset();
        assert_eq!(rig.slot().running(), [1, 2, 3]);
        assert_eq!(rig.report("SLOT_B_VERSION"), 0, "the previous image is a page further");

        let (duration, is_confirmed) = match trial {
            Trial::Passed => (10_200, true),
            Trial::EndedEarly => (9_000, false),
            Trial::WithRefusedSettings => (30_000, false),
        };
        for elapsed in 0..duration {
            if elapsed % 1_000 == 500 && elapsed < 10_000 {
                assert_eq!(rig.command(Over::Bus, "SAVE"), BUSY, "{trial:?} {elapsed}");
                assert_eq!(rig.block(0, &file[..BLOCK_LEN]), BUSY, "{trial:?} {elapsed}");
                assert_eq!(rig.refusal(), Some(UpdateRefusal::OnTrial));
            }
            rig.world.step();
        }
        assert_eq!(rig.world.flash.operations, settings, "{trial:?}: no settings were stored");
        let accepted = if is_confirmed { Ok(()) } else { BUSY };
        assert_eq!(rig.command(Over::Bus, "SAVE"), accepted, "{trial:?}");
        rig.world.pass(500);
        assert_eq!(rig.world.flash.operations > settings, is_confirmed);
        for _ in 0..2 {
            rig.reset();
            assert_eq!(rig.slot().running() == [1, 2, 3], is_confirmed, "{trial:?}");
        }
        // The next update is accepted in every case.
        rig.world.pass(10_100);
        assert_eq!(rig.send(&slot_model::signed(2_000, BOARD.name, [1, 2, 4])), RECEIVED, "{trial:?}");
    }
}

#[test]
fn confirmation_waits_for_moving_fingers() {
    let mut rig =
        Rig::of(Over::Service, World::homed(Rig::config(Over::Service), wsg_sim::Config::default()));
    assert_eq!(rig.send(&signed(3 * SECTOR_LEN)), RECEIVED);
    assert_eq!(rig.restart(), Ok(()));
    rig.world.pass(1_100);
    rig.reset();
    rig.world.pass(9_000);
    rig.world.pulse(Inputs::STOP_ACK);
    assert!(rig.world.until(300, |outputs| outputs.contains(Outputs::READY)));
    rig.world.set(Inputs::MOVE, true);
    assert!(rig.world.until(100, |outputs| outputs.contains(Outputs::BUSY)));
    rig.world.set(Inputs::MOVE, false);
    let (before, mut moving_ms) = (rig.slot().flash.operations(), 0);
    // Each look takes 2 ms.
    while rig.outputs().contains(Outputs::BUSY) {
        assert_eq!(rig.slot().flash.operations(), before);
        moving_ms += 2;
    }
    assert!(moving_ms > 1_500, "the trial ends during the motion");
    rig.world.pass(500);
    assert!(rig.slot().flash.operations() > before);
    rig.reset();
    assert_eq!(rig.slot().running(), [1, 2, 3]);
}

#[test]
fn missing_gripper_delays_the_restart_for_a_second() {
    let mut rig = Rig::of(Over::Service, World::new(Config::DEFAULT, quick()));
    rig.world.set_cut(true);
    assert_eq!(rig.send(&signed(1_000)), RECEIVED);
    assert_eq!(rig.restart(), Ok(()));
    rig.world.pass(900);
    assert_eq!(rig.slot().restarts, 0);
    rig.world.pass(200);
    assert_eq!((rig.slot().marks, rig.slot().restarts), (1, 1));
}

#[test]
fn image_without_a_boot_loader_refuses_updates_by_name() {
    for over in ALL {
        let mut rig = Rig::homed(over);
        let mut world = World::homed(Rig::config(over), quick());
        std::mem::swap(&mut rig.world, &mut world);
        let missing = if over == Over::Canopen { 0x0800_0021 } else { 1 };
        assert_eq!(rig.block(0, &[0; BLOCK_LEN]), Err(missing));
        assert_eq!(rig.restart(), Err(missing));
        assert_eq!(rig.refusal(), Some(UpdateRefusal::NoBootLoader));
        assert!(rig.outputs().contains(Outputs::READY) && rig.moves());
    }
}
