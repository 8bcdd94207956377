//! The grip cycle over CANopen.

use document::{hold, table};
use host_tests::world::World;
use host_tests::world::canopen::{Master, NODE};
use wsg_bridge_fw::io::Inputs;
use wsg_fieldbus::{InputImage, OutputImage};
use wsg_protocol::{Status, SystemFlags};
use wsg_sim::Part;

use super::DOCUMENT;
use super::image::{Then, code, force, hex, joined, state, steps, system, value, width};

const NMT: u16 = 0;
const TPDO1: u16 = 0x180 | NODE.node as u16;
const RPDO1: u16 = 0x200 | NODE.node as u16;
const TPDO2: u16 = 0x280 | NODE.node as u16;
const HEARTBEAT: u16 = 0x700 | NODE.node as u16;
const MASTER_HEARTBEAT: u16 = 0x700 | NODE.master as u16;

/// A recorded frame with its step and meaning.
struct Row {
    step: String,
    id: u16,
    data: Vec<u8>,
    meaning: String,
}

struct Recording {
    master: Master,
    rows: Vec<Row>,
}

impl Recording {
    fn note(&mut self, step: &str, id: u16, data: &[u8], meaning: impl Into<String>) {
        self.rows.push(Row { step: step.to_owned(), id, data: data.to_vec(), meaning: meaning.into() });
    }

    /// Sends a frame as the master and records it.
    fn send(&mut self, step: &str, id: u16, data: &[u8], meaning: impl Into<String>) {
        self.master.send(id, data);
        self.note(step, id, data, meaning);
    }

    /// Waits for a TPDO1 that meets a condition, and records it.
    fn note_tpdo1(&mut self, step: &str, wanted: fn(&InputImage) -> bool) {
        for _ in 0..20_000 {
            self.master.pass(1);
            let tpdos = self.master.take(0x180);
            if let Some((_, data)) = tpdos.into_iter().find(|(_, data)| wanted(&tpdo1(data))) {
                let image = tpdo1(&data);
                let meaning = [state, code, system].map(|part| value(&part(&image)).to_owned()).join("; ");
                return self.note(step, TPDO1, &data, meaning);
            }
        }
        panic!("{step}: no such TPDO1 within 20 s");
    }
}

/// Returns the part of the input image in TPDO1.
fn tpdo1(data: &[u8]) -> InputImage {
    let [state, user, s0, s1, s2, s3, c0, c1] = data.try_into().unwrap();
    InputImage::from_bytes([state, user, s0, s1, s2, s3, 0, 0, 0, 0, c1, c0])
}

/// Returns the part of the input image in TPDO2.
fn tpdo2(data: &[u8]) -> InputImage {
    let [w0, w1, f0, f1] = data.try_into().unwrap();
    InputImage::from_bytes([0, 0, 0, 0, 0, 0, w1, w0, f1, f0, 0, 0])
}

fn rpdo1(image: &OutputImage) -> [u8; 8] {
    let [flags, user, w1, w0, s1, s0, f1, f0] = image.to_bytes();
    [flags, user, w0, w1, s0, s1, f0, f1]
}

/// Records the cycle from power-up, with the wire of FAST STOP low until the plant is ready.
fn record() -> Vec<Row> {
    let gripper = wsg_sim::Config { part: Part::of_width(20.0), ..wsg_sim::Config::default() };
    let mut recording = Recording { master: Master::of(World::with_node(gripper, NODE)), rows: Vec::new() };
    recording.master.world.can.beats = true;
    recording.master.world.set(Inputs::FAST_STOP_OK, false);
    recording.master.pass(1_000);
    recording.master.world.set(Inputs::FAST_STOP_OK, true);
    recording.master.pass(500);
    let states = |recording: &mut Recording| -> Vec<u8> {
        recording.master.take(0x700).into_iter().map(|(_, data)| data[0]).collect()
    };
    assert!(states(&mut recording).starts_with(&[0, 0x7F]));
    recording.note("power-up", HEARTBEAT, &[0], "boot-up");
    recording.note("", HEARTBEAT, &[0x7F], "heartbeat: pre-operational");
    recording.note("", MASTER_HEARTBEAT, &[5], "heartbeat, repeated");
    recording.send("NMT start", NMT, &[1, NODE.node], format!("node {} becomes operational", NODE.node));
    recording.master.pass(1_000);
    assert!(states(&mut recording).contains(&5));
    recording.note("", HEARTBEAT, &[5], "heartbeat: operational");
    for step in steps() {
        recording.master.take(0x180);
        recording.send(step.name, RPDO1, &rpdo1(&step.image), "");
        match step.then {
            Then::Nothing => {
                recording.master.pass(20);
                continue;
            }
            Then::Begin => {
                recording.note_tpdo1(step.then.name(), |image| image.status == Status::CmdPending);
                continue;
            }
            Then::Look | Then::End => {}
        }
        // Wait until the fingers stand and the measured values are current.
        let ended = |image: &InputImage| {
            image.status != Status::CmdPending && !image.system.contains(SystemFlags::MOVING)
        };
        for _ in 0..200 {
            recording.master.pass(100);
            if ended(&recording.master.input()) {
                break;
            }
        }
        recording.master.pass(400);
        recording.master.take(0x180);
        recording.note_tpdo1(step.then.name(), |image| image.status != Status::CmdPending);
        recording.master.pass(200);
        let data = recording.master.tpdo(0x280).expect("a cyclic TPDO2").to_vec();
        let last = recording.rows.iter().rfind(|row| row.id == TPDO2);
        if last.is_none_or(|row| row.data != data) {
            let image = tpdo2(&data);
            let meaning = [width, force].map(|part| value(&part(&image)).to_owned()).join("; ");
            recording.note("", TPDO2, &data, meaning);
        }
    }
    recording.rows
}

#[test]
fn canopen_cycle_in_the_document_is_the_recorded_one() {
    let rows = record().into_iter().map(|row| {
        let id = format!("{:03X}h", row.id);
        [id, format!("`{}`", hex(&row.data)), joined(&row.step, &row.meaning)]
    });
    hold(DOCUMENT, "canopen-cycle", &table(["identifier", "bytes", "step: meaning"], rows));
}
