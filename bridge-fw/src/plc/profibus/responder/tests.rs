use std::boxed::Box;
use std::vec::Vec;

use super::*;

const IDLE: UartStatus = UartStatus { received: None, has_room: true, is_complete: true };
/// FDL_Status from master 2 to station 7, and the response.
const REQUEST: [u8; 6] = [0x10, 0x07, 0x02, 0x49, 0x52, 0x16];
const ANSWER: [u8; 6] = [0x10, 0x02, 0x07, 0x00, 0x09, 0x16];

fn at(rate: Baud) -> (DpResponder, &'static DpBuffers) {
    let buffers: &'static DpBuffers = Box::leak(Box::default());
    buffers.set_address(ADDRESS.station);
    buffers.set_rate(rate);
    let mut responder = DpResponder::new(buffers);
    assert_eq!(responder.step(IDLE, 0, 0).rate, Some(rate));
    (responder, buffers)
}

fn receive(responder: &mut DpResponder, character: Character, now_us: u32) -> Action {
    responder.step(UartStatus { received: Some(character), ..IDLE }, now_us / 1_000, now_us)
}

/// Passes a telegram whose last character ends at `end_us`. Returns the time until a response is due, in microseconds.
fn deliver(responder: &mut DpResponder, bytes: &[u8], character_us: u32, end_us: u32) -> Option<u32> {
    let begin_us = end_us - character_us * (bytes.len() as u32 - 1);
    let times = (begin_us..).step_by(character_us as usize);
    let mut wait_us = None;
    for (byte, now_us) in bytes.iter().zip(times) {
        wait_us = receive(responder, Character::Byte(*byte), now_us).wait_us;
    }
    wait_us
}

#[test]
fn response_starts_11_bit_times_after_the_stop_bit() {
    for rate in ProfibusConfig::RATES {
        let (mut responder, _) = at(rate);
        let us = |bits: u32| (bits * 1_000_000).div_ceil(rate.bit_s());
        let wait_us = deliver(&mut responder, &REQUEST, us(11), 1_000_000).unwrap();
        assert!((us(12)..=us(12) + 3).contains(&wait_us), "{rate:?}: {wait_us} us");
        assert!(wait_us < us(u32::from(rate.max_tsdr_bits())));
        assert_eq!(responder.step(IDLE, 1_000, 1_000_000 + wait_us - 1).send, None, "{rate:?}: too early");
        assert_eq!(responder.step(IDLE, 1_000, 1_000_000 + wait_us).send, Some(0x10));
    }
}

#[test]
fn response_is_sent_as_there_is_room_and_its_echo_is_ignored() {
    let (mut responder, _) = at(Baud::K500);
    let mut now_us = 1_000_000;
    now_us += deliver(&mut responder, &REQUEST, 22, now_us).unwrap();
    let mut sent = Vec::new();
    let mut action = responder.step(IDLE, 0, now_us);
    while let Some(byte) = action.send {
        sent.push(byte);
        assert_eq!(action.interrupts.transmit_empty, sent.len() < ANSWER.len());
        assert_eq!(action.interrupts.transmission_complete, sent.len() == ANSWER.len());
        let full = UartStatus { has_room: false, is_complete: false, ..IDLE };
        let meanwhile = responder.step(full, 0, now_us);
        assert_eq!(
            (meanwhile.send, meanwhile.interrupts),
            (None, action.interrupts),
            "transmission in progress"
        );
        now_us += 22;
        let echo = UartStatus { received: Some(Character::Byte(byte)), is_complete: false, ..IDLE };
        action = responder.step(echo, 0, now_us);
    }
    assert_eq!(sent, ANSWER);
    let quiet = Interrupts { transmit_empty: false, transmission_complete: false };
    assert_eq!(responder.step(IDLE, 0, now_us).interrupts, quiet, "sent");
    // The echo was no telegram, but the next request is.
    assert!(deliver(&mut responder, &REQUEST, 22, now_us + 1_000).is_some());
}

#[test]
fn pending_response_is_cancelled_when_another_station_sends() {
    let (mut responder, _) = at(Baud::K500);
    assert!(deliver(&mut responder, &REQUEST, 22, 1_000_000).is_some());
    receive(&mut responder, Character::Byte(0x10), 1_000_010);
    assert_eq!(responder.step(IDLE, 1_001, 1_001_000).send, None);
}

/// A master's transceiver that switches off after the request adds a character.
#[test]
fn stray_after_a_request_does_not_cancel_or_delay_the_response() {
    for stray in [Character::Byte(0x00), Character::Byte(0xFF), Character::Damaged] {
        let (mut responder, _) = at(Baud::K500);
        let wait_us = deliver(&mut responder, &REQUEST, 22, 1_000_000).unwrap();
        assert_eq!(receive(&mut responder, stray, 1_000_022).send, None);
        assert_eq!(responder.step(IDLE, 1_000, 1_000_000 + wait_us - 1).send, None, "{stray:?}: too early");
        assert_eq!(responder.step(IDLE, 1_000, 1_000_000 + wait_us).send, Some(0x10), "{stray:?}");
    }
}

#[test]
fn telegram_needs_a_preceding_silence_and_no_pauses() {
    let (mut responder, _) = at(Baud::K500);
    receive(&mut responder, Character::Byte(0x55), 990_000);
    // A gap of 32 bit times is 43 bit times or 86 us from end to end. With 33 it is 88 us.
    assert_eq!(deliver(&mut responder, &REQUEST, 22, 990_000 + 5 * 22 + 86), None, "no silence");
    let end_us = 990_000 + 2 * (5 * 22) + 86 + 91;
    assert!(deliver(&mut responder, &REQUEST, 22, end_us).is_some());
    assert_eq!(deliver(&mut responder, &REQUEST, 91, 2_000_000), None, "pauses inside");
}

#[test]
fn new_rate_cancels_a_response_and_is_reported_once() {
    let (mut responder, buffers) = at(Baud::K500);
    assert!(deliver(&mut responder, &REQUEST, 22, 1_000_000).is_some());
    buffers.set_rate(Baud::M1_5);
    let action = responder.step(IDLE, 1_001, 1_001_000);
    assert_eq!((action.rate, action.send), (Some(Baud::M1_5), None));
    assert_eq!(responder.step(IDLE, 1_002, 1_002_000).rate, None);
    assert_eq!(
        deliver(&mut responder, &REQUEST, 8, 1_100_000),
        Some(10),
        "12 bits at 1.5 Mbit/s, and a clock"
    );
}

/// Puts a responder into data exchange. Returns a function that writes an image to it.
fn exchanging(responder: &mut DpResponder) -> impl FnMut(&mut DpResponder, u8) + use<> {
    let sum = |body: &[u8]| body.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte));
    let mut now_us = 0;
    let mut send = move |responder: &mut DpResponder, body: &[u8]| {
        now_us += 10_000;
        let len = body.len() as u8;
        let telegram = [&[0x68, len, len, 0x68], body, &[sum(body), 0x16]].concat();
        let begin_us = now_us;
        let wait_us = deliver(responder, &telegram, 22, begin_us).unwrap();
        // Until the response has been sent.
        let mut at_us = begin_us + wait_us;
        while responder.step(IDLE, now_us / 1_000, at_us).send.is_some() {
            at_us += 22;
        }
    };
    send(responder, &[0x87, 0x82, 0x6C, 61, 62, 0x80, 0, 0, 11, 0x55, 0x55, 0]);
    send(responder, &[0x87, 0x82, 0x5C, 62, 62, 0xA7, 0x9B]);
    move |responder, byte| send(responder, &[0x07, 0x02, 0x6C, byte, 0, 0, 0, 0, 0, 0, 0])
}

fn taken(buffers: &DpBuffers) -> Vec<Option<u8>> {
    let event = |event| match event {
        FromMaster::Output([first, ..]) => Some(first),
        FromMaster::Left { .. } => None,
    };
    core::iter::from_fn(|| buffers.take()).map(event).collect()
}

#[test]
fn changed_images_are_queued_in_order_and_repeated_ones_counted() {
    let (mut responder, buffers) = at(Baud::K500);
    let mut write = exchanging(&mut responder);
    for byte in [0, 0, 1, 1, 1, 0, 2] {
        write(&mut responder, byte);
    }
    assert_eq!(taken(buffers), [Some(0), Some(1), Some(0), Some(2)]);
    assert_eq!(buffers.exchanges(), 7);
}

#[test]
fn full_queue_keeps_the_last_image_and_the_loss_of_the_master() {
    let (mut responder, buffers) = at(Baud::K500);
    let mut write = exchanging(&mut responder);
    for byte in 0..100 {
        write(&mut responder, byte);
    }
    let first: Vec<_> = (0..14).map(Some).collect();
    assert_eq!(taken(buffers), first);
    responder.step(IDLE, 0, 0);
    assert_eq!(taken(buffers), [Some(99)], "the current outputs");

    for byte in 0..100 {
        write(&mut responder, byte);
    }
    responder.note(Event::Cleared);
    responder.report();
    assert_eq!(taken(buffers), first);
    write(&mut responder, 200);
    assert_eq!(taken(buffers), [None, Some(200)], "the end precedes the new image");
}

#[test]
fn only_an_expired_watchdog_is_a_time_out() {
    let (mut responder, buffers) = at(Baud::K500);
    let mut write = exchanging(&mut responder);
    for (event, silent) in [
        (Event::Left(bus_profibus::Cause::Watchdog), true),
        (Event::Left(bus_profibus::Cause::Parameters), false),
        (Event::Cleared, false),
    ] {
        write(&mut responder, 1);
        assert_eq!(taken(buffers), [Some(1)]);
        responder.note(event);
        responder.report();
        assert_eq!(buffers.take(), Some(FromMaster::Left { silent }), "{event:?}");
    }
}

#[test]
fn image_is_queued_completely_or_not_at_all() {
    for (room, is_taken) in [(OutputImage::LEN, false), (OutputImage::LEN + 1, true)] {
        let buffers = DpBuffers::new();
        while buffers.events.room() > room {
            let _ = buffers.events.push(0);
        }
        assert_eq!(
            buffers.push(FromMaster::Output([1; OutputImage::LEN])),
            is_taken,
            "room for {room} bytes"
        );
        assert_eq!(buffers.events.room(), if is_taken { 0 } else { room });
    }
}

#[test]
fn incomplete_inputs_are_not_used() {
    let (mut responder, buffers) = at(Baud::K500);
    let first: [u8; InputImage::LEN] = core::array::from_fn(|n| n as u8);
    buffers.show(first);
    assert_eq!(buffers.take_input(), Some(first));
    assert_eq!(buffers.take_input(), None, "nothing new");
    // The handler runs during a write of the main loop.
    buffers.input_version.store(3, Ordering::Relaxed);
    buffers.input[0].store(0xFFFF_FFFF, Ordering::Relaxed);
    responder.step(IDLE, 0, 0);
    assert_eq!(buffers.take_input(), None);
}
