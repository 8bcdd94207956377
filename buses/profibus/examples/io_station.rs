//! Eight digital inputs and outputs on a simulated bus. The master polls the station, sends parameters and
//! configuration, exchanges data, reads a diagnosis and then stops sending. `cargo run -p bus-profibus --example
//! io_station` prints the telegrams; add `-- --gsd` to print the GSD file.

use bus_profibus::{
    Address, Baud, Character, Event, Gsd, GsdFacts, Profile, SYNC_BITS, Slave, identifiers_fit,
};

static PROFILE: Profile = Profile {
    ident: 0x1234,
    config: &[0x20, 0x10],
    sync: false,
    freeze: false,
    fail_safe: true,
    set_address: false,
};
const _: () = assert!(identifiers_fit(PROFILE.config, 1, 1));

/// A station with two bytes of diagnosis: header and flags.
type Station = Slave<1, 1, 2>;
const SHORT_CIRCUIT: u8 = 1 << 0;

const FACTS: GsdFacts<'_> = GsdFacts {
    vendor: "example",
    model: "IO-8-8",
    revision: "1.0",
    hardware_release: "1.0",
    software_release: "1.0",
    family: 3,
    rates: &[Baud::K9_6, Baud::K19_2, Baud::K93_75, Baud::K187_5, Baud::K500],
    auto_baud: true,
    min_slave_interval: 10,
    module: "8 outputs, 8 inputs",
    max_diagnosis_len: 8,
    bitmaps: None,
    diagnosis_bits: &[(0, "short circuit of an output")],
};

/// Telegrams from the master: time in milliseconds, and the body from the destination to the data.
const SCRIPT: [(u32, &[u8]); 7] = [
    // FDL_Status, Slave_Diag, Set_Prm with a watchdog of 100 ms, Chk_Cfg.
    (10, &[0x07, 0x02, 0x49]),
    (11, &[0x87, 0x82, 0x6D, 60, 62]),
    (12, &[0x87, 0x82, 0x5D, 61, 62, 0x88, 1, 10, 11, 0x12, 0x34, 0]),
    (13, &[0x87, 0x82, 0x7D, 62, 62, 0x20, 0x10]),
    // Data_Exchange twice; the last output has a short circuit. Slave_Diag, requested by the answer.
    (14, &[0x07, 0x02, 0x5D, 0x0F]),
    (15, &[0x07, 0x02, 0x7D, 0x80]),
    (16, &[0x87, 0x82, 0x5D, 60, 62]),
];

fn main() {
    if std::env::args().any(|argument| argument == "--gsd") {
        print!("{}", Gsd { facts: FACTS, profile: &PROFILE });
        return;
    }
    let mut station = Station::new(&PROFILE, Address::new(7));
    for now_ms in 0..200 {
        let mut event = station.poll(now_ms);
        for (_, body) in SCRIPT.iter().filter(|(at, _)| *at == now_ms) {
            let telegram = telegram(body);
            print(now_ms, "master ", &telegram);
            for (at, byte) in telegram.into_iter().enumerate() {
                let silence_bits = if at == 0 { SYNC_BITS } else { 0 };
                let Some(outcome) = station.push(Character::Byte(byte), silence_bits, now_ms) else {
                    continue;
                };
                event = outcome.event;
                // A real line waits for `not_before_bits` here.
                if let Some(answer) = outcome.answer {
                    print(now_ms, "station", answer.bytes);
                }
            }
        }
        match event {
            Some(Event::Outputs) => {
                // Each input is wired to the output of the same number.
                let outputs = *station.outputs();
                station.show_inputs(&outputs);
                let [outputs] = outputs;
                let flags = if outputs & 0x80 != 0 { SHORT_CIRCUIT } else { 0 };
                station.show_diagnosis(&[2, flags], flags != 0);
                if flags != 0 {
                    station.announce_diagnosis();
                }
            }
            Some(event @ (Event::Cleared | Event::Left(_) | Event::Address(_))) => {
                println!("{now_ms:>4} ms  outputs {:02X?}: {event:?}", station.outputs());
            }
            None => {}
        }
    }
}

/// Adds delimiters and check sum to a body.
fn telegram(body: &[u8]) -> Vec<u8> {
    let sum = body.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte));
    let len = body.len() as u8;
    let head = if body.len() == 3 { vec![0x10] } else { vec![0x68, len, len, 0x68] };
    [&head, body, &[sum, 0x16]].concat()
}

fn print(now_ms: u32, whose: &str, bytes: &[u8]) {
    println!("{now_ms:>4} ms  {whose}  {bytes:02X?}");
}
