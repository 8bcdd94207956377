//! The grip cycle over CANopen.

use document::{hold, table};
use host_tests::world::World;
use host_tests::world::canopen::{Master, NODE};
use wsg_bridge_fw::io::Inputs;
use wsg_fieldbus::{GripperFlags, InputImage, OutputImage};
use wsg_protocol::{Status, SystemFlags};
use wsg_sim::Part;

use super::DOCUMENT;
use super::image::{Then, explain, force, hex, output_parts, state, status, steps, system, width};

const NMT: u16 = 0;
const TPDO1: u16 = 0x180 | NODE.node as u16;
const RPDO1: u16 = 0x200 | NODE.node as u16;
const TPDO2: u16 = 0x280 | NODE.node as u16;
const HEARTBEAT: u16 = 0x700 | NODE.node as u16;
const MASTER_HEARTBEAT: u16 = 0x700 | NODE.master as u16;

/// A recorded frame with its step, sender and meaning.
struct Row {
    step: String,
    from: &'static str,
    id: u16,
    data: Vec<u8>,
    meaning: String,
}

struct Recording {
    master: Master,
    rows: Vec<Row>,
}

impl Recording {
    fn note(&mut self, step: &str, from: &'static str, id: u16, data: &[u8], meaning: impl Into<String>) {
        self.rows.push(Row { step: step.to_owned(), from, id, data: data.to_vec(), meaning: meaning.into() });
    }

    /// Sends a frame as the master and records it.
    fn send(&mut self, step: &str, id: u16, data: &[u8], meaning: impl Into<String>) {
        self.master.send(id, data);
        self.note(step, "master", id, data, meaning);
    }

    /// Waits for a TPDO1 that meets a condition, and records it.
    fn note_tpdo1(&mut self, step: &str, wanted: fn(&InputImage) -> bool) {
        for _ in 0..20_000 {
            self.master.pass(1);
            let tpdos = self.master.take(0x180);
            if let Some((_, data)) = tpdos.into_iter().find(|(_, data)| wanted(&tpdo1(data))) {
                let image = tpdo1(&data);
                let meaning = [state, status, system].map(|part| part(&image)).join("; ");
                return self.note(step, "bridge", TPDO1, &data, meaning);
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
    recording.note("power-up", "bridge", HEARTBEAT, &[0], "boot-up");
    recording.note("", "bridge", HEARTBEAT, &[0x7F], "heartbeat: pre-operational");
    recording.note("", "master", MASTER_HEARTBEAT, &[5], "heartbeat, repeated");
    recording.send("NMT start", NMT, &[1, NODE.node], format!("node {} becomes operational", NODE.node));
    recording.master.pass(1_000);
    assert!(states(&mut recording).contains(&5));
    recording.note("", "bridge", HEARTBEAT, &[5], "heartbeat: operational");
    for step in steps() {
        let data = rpdo1(&step.image);
        let meaning: Vec<String> =
            output_parts(&step.image).into_iter().map(|(_, meaning)| meaning).collect();
        recording.master.take(0x180);
        recording.send(step.name, RPDO1, &data, format!("{}; {}", meaning[0], meaning[2..].join("; ")));
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
        let image = tpdo2(&data);
        recording.note("", "bridge", TPDO2, &data, [width, force].map(|part| part(&image)).join("; "));
    }
    recording.rows
}

#[test]
fn canopen_cycle_in_the_document_is_the_recorded_one() {
    let rows = record();
    let grip = rows.iter().find(|row| row.step == "GRIP").unwrap();
    let image = steps().into_iter().find(|step| step.name == "GRIP").unwrap().image;
    let head = ["bytes", "value", "meaning"];
    hold(DOCUMENT, "canopen-rpdo", &table(head, explain(&grip.data, &output_parts(&image))));

    let is_held = |row: &Row| row.id == TPDO1 && tpdo1(&row.data).state == GripperFlags::HOLDING;
    let at = rows.iter().position(is_held).expect("a TPDO1 that reports a held part");
    let (first, second) = (&rows[at].data, &rows[at + 1].data);
    let image = tpdo1(first);
    let parts = [
        (1, state(&image)),
        (1, "OF: user flags, none".to_owned()),
        (4, system(&image)),
        (2, status(&image)),
    ];
    let in_first = explain(first, &parts);
    let image = tpdo2(second);
    let in_second = explain(second, &[(2, width(&image)), (2, force(&image))]);
    let with_name = |name: &str, rows: Vec<[String; 3]>| -> Vec<[String; 4]> {
        rows.into_iter().map(|[at, value, meaning]| [name.to_owned(), at, value, meaning]).collect()
    };
    let all = [with_name("TPDO1", in_first), with_name("TPDO2", in_second)].concat();
    hold(DOCUMENT, "canopen-tpdo", &table(["PDO", "bytes", "value", "meaning"], all));

    let all = rows.into_iter().enumerate().map(|(number, row)| {
        [
            (number + 1).to_string(),
            row.step,
            row.from.to_owned(),
            format!("{:03X}h", row.id),
            format!("`{}`", hex(&row.data)),
            row.meaning,
        ]
    });
    hold(DOCUMENT, "canopen-cycle", &table(["", "step", "from", "identifier", "bytes", "meaning"], all));
}
