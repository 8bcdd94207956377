//! The grip cycle over Modbus RTU.

use document::{hold, table};
use host_tests::world::modbus::{Master, UNIT};
use wsg_bridge_fw::io::Inputs;
use wsg_fieldbus::{InputImage, OutputImage};
use wsg_protocol::{Status, SystemFlags};
use wsg_sim::Part;

use super::DOCUMENT;
use super::image::{
    Then, code, explain, force, hex, input_parts, joined, output_parts, state, steps, system, value, width,
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
    hold_bytes("modbus-write", &grip.request, vec![head, bytes, output_parts(&image), vec![checksum()]]);
    let image = input(&read.answer[3..15]);
    let head = vec![unit(), part(1, "FC 4, Read Input Registers"), part(1, "bytes that follow: 12")];
    hold_bytes("modbus-answer", &read.answer, vec![head, input_parts(&image), vec![checksum()]]);
    // The document shows the messages that are the same in every exchange once.
    let page = document::read(DOCUMENT);
    for message in [&grip.answer, &read.request] {
        let message = format!("`{}`", hex(message));
        assert!(page.contains(&message), "{DOCUMENT} does not show {message}");
    }
}

#[test]
fn modbus_cycle_in_the_document_is_the_recorded_one() {
    let rows = record().into_iter().map(|exchange| {
        let (message, meaning) = if exchange.request[1] == 4 {
            let image = input(&exchange.answer[3..15]);
            let parts = [state, code, system, width, force].map(|part| value(&part(&image)).to_owned());
            (exchange.answer, parts.join("; "))
        } else {
            (exchange.request, String::new())
        };
        [format!("`{}`", hex(&message)), joined(&exchange.step, &meaning)]
    });
    let head = ["message", "step: GSTATE; Status Code; SYSSTATE; WIDTH; Gripping Force"];
    hold(DOCUMENT, "modbus-cycle", &table(head, rows));
}
