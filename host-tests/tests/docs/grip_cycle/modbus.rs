//! The grip cycle over Modbus RTU.

use document::{hold, table};
use host_tests::world::modbus::{Master, UNIT};
use wsg_bridge_fw::io::Inputs;
use wsg_fieldbus::{InputImage, OutputImage};
use wsg_protocol::{Status, SystemFlags};
use wsg_sim::Part;

use super::DOCUMENT;
use super::image::{
    Then, explain, force, hex, input_parts, output_parts, state, status, steps, system, width,
};

/// A request and its answer, as complete frames.
struct Exchange {
    step: String,
    request: Vec<u8>,
    answer: Vec<u8>,
}

struct Recording {
    rig: Master,
    exchanges: Vec<Exchange>,
}

impl Recording {
    fn note(&mut self, step: impl Into<String>, request: &[u8], answer: &[u8]) {
        // The rig has already checked the answer's unit and checksum.
        let [request, answer] = [request, answer].map(|pdu| Master::frame(UNIT, pdu));
        self.exchanges.push(Exchange { step: step.into(), request, answer });
    }

    fn write(&mut self, step: &str, image: &OutputImage) {
        let pdu = [&[16, 0, 0, 0, 4, 8], &image.to_bytes()[..]].concat();
        let answer = self.rig.ask(&pdu);
        assert_eq!(answer, pdu[..5]);
        self.note(step, &pdu, &answer);
    }

    fn read(&mut self, step: Option<&str>) -> InputImage {
        let pdu = [4, 0, 0, 0, 6];
        let answer = self.rig.ask(&pdu);
        assert_eq!(answer[..2], [4, 12]);
        if let Some(step) = step {
            self.note(step, &pdu, &answer);
        }
        input(&answer[2..])
    }

    /// Polls until the fingers stand still.
    fn settle(&mut self) {
        for _ in 0..500 {
            let image = self.read(None);
            self.rig.pass(20);
            let moves = image.system.contains(SystemFlags::MOVING) || image.status == Status::CmdPending;
            if !moves {
                for _ in 0..20 {
                    self.read(None);
                    self.rig.pass(20);
                }
                return;
            }
        }
        panic!("the motion does not end");
    }
}

fn input(bytes: &[u8]) -> InputImage {
    InputImage::from_bytes(bytes.try_into().unwrap())
}

/// Records the cycle from power-up, with the wire of FAST STOP low until the plant is ready.
fn record() -> Vec<Exchange> {
    let gripper = wsg_sim::Config { part: Part::of_width(20.0), ..wsg_sim::Config::default() };
    let rig = Master::new(wsg_bridge_fw::Config::DEFAULT, gripper);
    let mut recording = Recording { rig, exchanges: Vec::new() };
    recording.rig.set(Inputs::FAST_STOP_OK, false);
    recording.rig.pass(500);
    recording.rig.set(Inputs::FAST_STOP_OK, true);
    recording.rig.pass(500);
    for step in steps() {
        recording.write(step.name, &step.image);
        match step.then {
            Then::Nothing => recording.rig.pass(20),
            Then::Look | Then::Begin => {
                recording.read(Some(step.then.name()));
            }
            Then::End => {
                recording.settle();
                recording.read(Some(step.then.name()));
            }
        }
    }
    recording.exchanges
}

fn checksum() -> (usize, String) {
    (2, "CRC, low byte first".to_owned())
}

fn part(len: usize, meaning: &str) -> (usize, String) {
    (len, meaning.to_owned())
}

fn held(exchange: &Exchange) -> bool {
    exchange.request[1] == 4 && input(&exchange.answer[3..15]).state.bits() == 1 << 4
}

#[test]
fn modbus_messages_in_the_document_are_those_that_were_recorded() {
    let exchanges = record();
    let grip = exchanges.iter().find(|exchange| exchange.step == "GRIP").unwrap();
    let read =
        exchanges.iter().find(|exchange| held(exchange)).expect("an exchange that reports a held part");
    let hold_bytes = |name, message: &[u8], parts: Vec<Vec<(usize, String)>>| {
        hold(DOCUMENT, name, &table(["bytes", "value", "meaning"], explain(message, &parts.concat())));
    };
    let image = OutputImage::from_bytes(grip.request[7..15].try_into().unwrap());
    let unit = || part(1, "unit");
    let head = vec![
        unit(),
        part(1, "FC 16, Write Multiple Registers"),
        part(2, "first register: 0 (40001)"),
        part(2, "registers: 4"),
    ];
    let bytes = vec![part(1, "bytes that follow: 8")];
    hold_bytes(
        "modbus-write",
        &grip.request,
        vec![head.clone(), bytes, output_parts(&image), vec![checksum()]],
    );
    hold_bytes("modbus-written", &grip.answer, vec![head, vec![checksum()]]);
    let function = || part(1, "FC 4, Read Input Registers");
    let asked =
        vec![unit(), function(), part(2, "first register: 0 (30001)"), part(2, "registers: 6"), checksum()];
    hold_bytes("modbus-read", &read.request, vec![asked]);
    let image = input(&read.answer[3..15]);
    let head = vec![unit(), function(), part(1, "bytes that follow: 12")];
    hold_bytes("modbus-answer", &read.answer, vec![head, input_parts(&image), vec![checksum()]]);
}

#[test]
fn modbus_cycle_in_the_document_is_the_recorded_one() {
    let rows = record().into_iter().enumerate().map(|(number, exchange)| {
        let meaning = if exchange.request[1] == 4 {
            let image = input(&exchange.answer[3..15]);
            [state, status, system, width, force].map(|part| part(&image)).join("; ")
        } else {
            "accepted".to_owned()
        };
        [
            (number + 1).to_string(),
            exchange.step,
            format!("`{}`", hex(&exchange.request)),
            format!("`{}`", hex(&exchange.answer)),
            meaning,
        ]
    });
    hold(DOCUMENT, "modbus-cycle", &table(["", "step", "request", "answer", "meaning of the answer"], rows));
}
