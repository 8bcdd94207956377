//! Cost of one Data_Exchange in the interrupt handler of the line: from the last character of the request to the
//! first byte of the answer, and of one earlier character.

use core::hint::black_box;

use bus_profibus::Character;
use cortex_m_semihosting::hprintln;
use wsg_bridge_fw::plc::{DpBuffers, DpResponder, Profibus, UartStatus};
use wsg_bridge_fw::{Config, ProfibusConfig};

use crate::counting::Counter;

static BUFFERS: DpBuffers = DpBuffers::new();

/// Set_Prm without a watchdog, Chk_Cfg, and Data_Exchange twice, the second with another frame count bit and another image.
const REQUESTS: [&[u8]; 4] = [
    &[0x68, 12, 12, 0x68, 0x87, 0x82, 0x6D, 61, 62, 0x80, 0, 0, 11, 0x55, 0x55, 0, 0x26, 0x16],
    &[0x68, 7, 7, 0x68, 0x87, 0x82, 0x5D, 62, 62, 0xA7, 0x9B, 0x24, 0x16],
    &[0xA2, 0x07, 0x02, 0x7D, 0, 0, 0, 0, 0, 0, 0, 0, 0x86, 0x16],
    &[0xA2, 0x07, 0x02, 0x5D, 2, 0, 0, 0, 0, 0, 0, 0, 0x68, 0x16],
];

/// Microseconds between two requests, long enough as idle time.
const PAUSE_US: u32 = 5_000;

// Not inlined, so that register allocation is independent of the other measurements.
#[inline(never)]
pub(crate) fn count(counter: &Counter) {
    Profibus::new(&BUFFERS)
        .start(ProfibusConfig { rate: Some(ProfibusConfig::RATES[6]), ..Config::DEFAULT.profibus });
    let mut responder = DpResponder::new(&BUFFERS);
    let responder = black_box(&mut responder);
    let idle = UartStatus { received: None, has_room: true, is_complete: true };
    let _ = responder.step(idle, 0, 0);
    let (mut now_us, mut exchange, mut character) = (0, 0, 0);
    for request in REQUESTS {
        now_us += PAUSE_US;
        let mut wait_us = None;
        for &byte in request {
            now_us += 7;
            let status = UartStatus { received: Some(Character::Byte(byte)), ..idle };
            let instructions = counter.of(|| wait_us = responder.step(status, 0, now_us).wait_us);
            if wait_us.is_none() {
                character = instructions.max(character);
            } else {
                exchange = instructions;
            }
        }
        now_us += wait_us.unwrap_or_default();
        let mut sent = 0;
        exchange += counter.of(|| sent += u32::from(responder.step(idle, 0, now_us).send.is_some()));
        assert!(sent == 1, "one answer");
        while responder.step(idle, 0, now_us).send.is_some() {}
    }
    hprintln!("profibus-data-exchange {} 1", exchange);
    hprintln!("profibus-character {} 1", character);
}
