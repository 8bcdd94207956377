//! The parts beside the session: register interface, CAN, parser and encoder, queue and texts.

use std::ffi::{CStr, c_char, c_void};
use std::mem::MaybeUninit;
use std::ptr;

use wsg::can::*;
use wsg::event::*;
use wsg::fieldbus::*;
use wsg::frame::*;
use wsg::queue::*;
use wsg::request::*;
use wsg::session::*;
use wsg::text::*;
use wsg::{wsg_config_t, wsg_error};
use wsg_fieldbus::{Controller, OutputImage, SilenceReaction};
use wsg_protocol::session::{self, Session, Topic};
use wsg_protocol::{AutoUpdate, CommandId, Event, Frame, FrameEncoder, FrameParser, Instant, Reply, Status};

fn generator(mut state: u64) -> impl FnMut(usize) -> usize {
    move |limit| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % limit
    }
}

fn config(verify_settings: u8) -> wsg_config_t {
    let mut config = MaybeUninit::uninit();
    wsg::config::wsg_config_default(Some(&mut config));
    wsg_config_t { verify_settings, ..unsafe { config.assume_init() } }
}

/// Success with a value of the right length and random content, as a gripper gives it.
fn reply(below: &mut impl FnMut(usize) -> usize, id: CommandId) -> Vec<u8> {
    let status = match below(4) {
        0 => id.immediate_statuses()[below(id.immediate_statuses().len())],
        1 if id.kind() == wsg_protocol::Kind::Motion => Status::CmdPending,
        _ => Status::Success,
    };
    // A gripper at rest, mostly, so that motions are sent.
    let at_rest = match id {
        _ if status != Status::Success || below(8) == 0 => None,
        CommandId::GetSystemState => Some(vec![1, 0, 0, 0]),
        CommandId::GetGripperState => Some(vec![0]),
        CommandId::GetSystemLimits => {
            let limits: [f32; 8] = [110.0, 5.0, 420.0, 100.0, 5000.0, 5.0, 80.0, 120.0];
            Some(limits.into_iter().flat_map(f32::to_le_bytes).collect())
        }
        _ => None,
    };
    if let Some(value) = at_rest {
        return [&[0, 0][..], &value].concat();
    }
    [0usize, 4, 1, 8, 2, 32, 3]
        .into_iter()
        .map(|len| {
            let mut value: Vec<u8> = (0..len).map(|_| below(128) as u8).collect();
            if len == 1 {
                value[0] %= 8;
            }
            value.iter_mut().skip(3).step_by(4).for_each(|high| *high &= 0x3F);
            let value = if status == Status::Success { value } else { vec![] };
            [&status.code().to_le_bytes()[..], &value].concat()
        })
        .find(|payload| Reply::decode(&Frame { id: id.code(), payload }).is_ok())
        .unwrap()
}

#[test]
fn fieldbus_gives_the_images_and_messages_of_the_controller() {
    let mut sent = 0;
    for seed in 0..if cfg!(miri) { 3 } else { 400 } {
        let mut below = generator(seed);
        let mut wsg = MaybeUninit::uninit();
        let mut fieldbus = MaybeUninit::<wsg_fieldbus_t>::uninit();
        let fieldbus = fieldbus.as_mut_ptr();
        assert_eq!(unsafe { wsg_init(Some(&mut wsg), Some(&config(1)), None, ptr::null_mut()) }, 0);
        let wsg = unsafe { wsg.assume_init_mut() };
        assert_eq!(unsafe { wsg_fieldbus_attach(fieldbus, Some(wsg)) }, 0);

        let config = session::Config { verify_settings: true, ..session::Config::DEFAULT };
        let (mut session, mut controller) = (Session::new(config), Controller::new());
        let mut parser = FrameParser::<WSG_MAX_PAYLOAD>::new();
        session.subscribe(Topic::Width, AutoUpdate::on_change(10));
        session.subscribe(Topic::Force, AutoUpdate::on_change(10));

        let (mut now, mut asked) = (0u32, Vec::new());
        for _ in 0..120 {
            let at = Instant::from_millis(now);
            match below(6) {
                0 => {
                    let flags = [0, 0, 1 << below(8), 1 << below(4)][below(4)] as u8;
                    let image = [flags, 0, 0xD0, 7, 0x88, 0x13, 20, 0];
                    let written =
                        unsafe { wsg_fieldbus_write(fieldbus, Some(wsg), image.as_ptr(), image.len()) };
                    assert_eq!(written, 0);
                    controller.set_output(&OutputImage::from_bytes(image), session.known());
                }
                1 if below(30) == 0 => {
                    let (code, reaction) = [
                        (WSG_SILENCE_HOLD, SilenceReaction::Hold),
                        (WSG_SILENCE_STOP, SilenceReaction::Stop),
                        (WSG_SILENCE_FAST_STOP, SilenceReaction::FastStop),
                    ][below(3)];
                    assert_eq!(unsafe { wsg_fieldbus_silence(fieldbus, Some(wsg), code) }, 0);
                    controller.silence(reaction, session.known());
                }
                1 => now += below(300) as u32,
                _ => {
                    for id in std::mem::take(&mut asked) {
                        let frame: Vec<u8> =
                            FrameEncoder::new(CommandId::code(id), &reply(&mut below, id)[..]).collect();
                        assert_eq!(unsafe { wsg_receive(wsg, now, frame.as_ptr(), frame.len()) }, 0);
                        for byte in frame {
                            let Some(found) = parser.push(byte) else { continue };
                            if let Some(event) = session.handle(at, &found) {
                                controller.handle(&event, session.known());
                            }
                        }
                    }
                }
            }
            let at = Instant::from_millis(now);
            assert_eq!(unsafe { wsg_tick(wsg, now) }, 0);
            for _ in 0..2 {
                controller.adopt_known(session.known());
                while let Some(command) = controller.poll_command() {
                    if let Err(error) = session.request(command) {
                        controller.refused(command.id(), error, session.known());
                    }
                }
                while let Some(event) = session.tick(at) {
                    controller.handle(&event, session.known());
                }
            }
            loop {
                let mut message = [0; WSG_TRANSMIT_LEN];
                let len = unsafe { wsg_transmit(wsg, now, message.as_mut_ptr(), message.len()) };
                let command = session.poll_transmit(at);
                let expected: Vec<u8> =
                    command.into_iter().flat_map(|it| FrameEncoder::new(it.id().code(), it)).collect();
                assert_eq!(message[..usize::try_from(len).unwrap()], expected, "seed {seed}");
                let Some(command) = command else { break };
                sent += usize::from(command.id().kind() == wsg_protocol::Kind::Motion);
                asked.push(command.id());
            }
            let mut image = [0; WSG_FIELDBUS_INPUT_LEN];
            let len = unsafe { wsg_fieldbus_read(fieldbus, Some(wsg), image.as_mut_ptr(), 12) };
            assert_eq!((len, image), (12, controller.input(session.known()).to_bytes()), "seed {seed}");
        }
    }
    assert!(cfg!(miri) || sent > 100, "{sent} motions");
}

#[test]
fn fieldbus_controller_attaches_once_and_rejects_wrong_lengths() {
    let mut wsg = MaybeUninit::uninit();
    let (mut first, mut second) = (MaybeUninit::uninit(), MaybeUninit::uninit());
    let (fieldbus, second) = (first.as_mut_ptr(), second.as_mut_ptr());
    unsafe { wsg_init(Some(&mut wsg), None, None, ptr::null_mut()) };
    let wsg = unsafe { wsg.assume_init_mut() };
    unsafe {
        assert_eq!(wsg_fieldbus_attach(fieldbus, Some(wsg)), 0);
        assert_eq!(wsg_fieldbus_attach(second, Some(wsg)), wsg_error::Argument as i32);
    }
    let mut image = [0; 12];
    unsafe {
        let argument = wsg_error::Argument as i32;
        assert_eq!(wsg_fieldbus_write(fieldbus, Some(wsg), image.as_ptr(), 7), argument);
        assert_eq!(wsg_fieldbus_silence(fieldbus, Some(wsg), 3), argument);
        let too_small = wsg_error::BufferTooSmall as i32;
        assert_eq!(wsg_fieldbus_read(fieldbus, Some(wsg), image.as_mut_ptr(), 11), too_small);
    }
}

unsafe extern "C" fn count(context: *mut c_void, _: *const wsg_event_t) {
    unsafe { *context.cast::<u32>() += 1 };
}

#[test]
fn messages_over_can_reach_the_gripper_and_replies_come_back() {
    let mut replies = 0u32;
    let (mut wsg, mut can) = (MaybeUninit::uninit(), MaybeUninit::uninit());
    unsafe { wsg_init(Some(&mut wsg), None, Some(count), (&raw mut replies).cast()) };
    let (wsg, can) = unsafe {
        assert_eq!(wsg_can_init(Some(&mut can), 0x7FF), wsg_error::Argument as i32);
        assert_eq!(wsg_can_init(Some(&mut can), WSG_CAN_DEFAULT_ID), 0);
        (wsg.assume_init_mut(), can.assume_init_mut())
    };
    let mut below = generator(1);
    let mut now = 0;
    // Each request of the session is answered until it is connected.
    for _ in 0..20 {
        unsafe { wsg_tick(wsg, now) };
        let mut message = [0; WSG_TRANSMIT_LEN];
        let len = unsafe { wsg_transmit(wsg, now, message.as_mut_ptr(), message.len()) };
        let mut frames = [wsg_can_frame_t::default(); WSG_CAN_MAX_FRAMES];
        let split = |len, frames: &mut [wsg_can_frame_t]| unsafe {
            wsg_can_split(0x120, message.as_ptr(), len, frames.as_mut_ptr(), frames.len())
        };
        let len = usize::try_from(len).unwrap();
        let count = split(len, &mut frames);
        assert_eq!(count, len.div_ceil(8) as i32);
        if len > 8 {
            assert_eq!(split(len, &mut frames[..1]), wsg_error::BufferTooSmall as i32);
            assert_eq!(split(len - 1, &mut frames), wsg_error::Malformed as i32);
        }
        let received: Vec<u8> = frames[..count as usize]
            .iter()
            .flat_map(|frame| frame.data[..frame.length.into()].to_vec())
            .collect();
        assert_eq!(received, message[..len]);
        assert!(frames[..count as usize].iter().all(|frame| frame.id == 0x120));
        if len > 0 {
            let id = CommandId::from_code(message[3]);
            let payload = loop {
                let payload = reply(&mut below, id);
                if payload[..2] == [0, 0] {
                    break payload;
                }
            };
            let answer: Vec<u8> = FrameEncoder::new(message[3], &payload[..]).collect();
            for chunk in answer.chunks(8) {
                let mut frame = wsg_can_frame_t { id: 0x121, length: chunk.len() as u8, data: [0; 8] };
                frame.data[..chunk.len()].copy_from_slice(chunk);
                let foreign = wsg_can_frame_t { id: 0x800, ..frame };
                unsafe {
                    assert_eq!(wsg_can_receive(can, wsg, now, Some(&foreign)), 0);
                    assert_eq!(wsg_can_receive(can, wsg, now, Some(&frame)), 0);
                }
            }
        }
        now += 20;
    }
    let mut counters = MaybeUninit::uninit();
    unsafe { wsg_can_counters(can, Some(&mut counters)) };
    assert_eq!(unsafe { counters.assume_init() }.dropped, 0);
    let mut known = MaybeUninit::uninit();
    wsg::known::wsg_known(Some(wsg), Some(&mut known));
    assert_eq!(unsafe { known.assume_init() }.connected, 1);
    assert!(replies > 0);
    // Half a message ends with its time-out, and a longer frame is no frame.
    let head = wsg_can_frame_t { id: 0x121, length: 8, data: [0xAA, 0xAA, 0xAA, 0x43, 6, 0, 0, 0] };
    let long = wsg_can_frame_t { length: 9, ..head };
    unsafe {
        assert_eq!(wsg_can_receive(can, wsg, now, Some(&long)), wsg_error::Argument as i32);
        assert_eq!(wsg_can_receive(can, wsg, now, Some(&head)), 0);
        assert_eq!(wsg_can_tick(can, wsg, now + 60), 0);
        wsg_can_counters(can, Some(&mut counters));
        assert_eq!(counters.assume_init().expired, 1);
    }
}

#[test]
fn parser_and_encoder_work_without_a_session() {
    for seed in 0..if cfg!(miri) { 3 } else { 200 } {
        let mut below = generator(seed);
        let mut line = Vec::new();
        for _ in 0..20 {
            let payload: Vec<u8> = (0..below(80)).map(|_| below(256) as u8).collect();
            let mut frame = vec![0; payload.len() + 8];
            let short = frame.len() - 1;
            let len = unsafe {
                let too_small =
                    wsg_frame_encode(0x43, payload.as_ptr(), payload.len(), frame.as_mut_ptr(), short);
                assert_eq!(too_small, wsg_error::BufferTooSmall as i32);
                wsg_frame_encode(0x43, payload.as_ptr(), payload.len(), frame.as_mut_ptr(), frame.len())
            };
            assert_eq!(len, frame.len() as i32);
            match below(4) {
                0 => frame.truncate(below(short)),
                1 => frame[below(short)] ^= 1 << below(8),
                _ => {}
            }
            line.extend(frame);
        }
        let mut parser = MaybeUninit::uninit();
        wsg_parser_init(Some(&mut parser));
        let parser = unsafe { parser.assume_init_mut() };
        let mut reference = FrameParser::<WSG_MAX_PAYLOAD>::new();
        let mut rest = &line[..];
        loop {
            let (mut taken, mut frame) = (MaybeUninit::uninit(), MaybeUninit::uninit());
            let bytes = (rest.as_ptr(), rest.len());
            let found = unsafe {
                wsg_parser_push(Some(parser), bytes.0, bytes.1, Some(&mut taken), Some(&mut frame))
            };
            let (expected_taken, expected) = reference.push_slice(rest);
            assert_eq!(unsafe { taken.assume_init() }, expected_taken);
            rest = &rest[expected_taken..];
            let Some(expected) = expected else {
                assert_eq!(found, 0);
                break;
            };
            assert_eq!(found, 1);
            same(unsafe { frame.assume_init() }, expected);
        }
        while let Some(expected) = reference.expire() {
            let mut frame = MaybeUninit::uninit();
            assert_eq!(wsg_parser_expire(Some(parser), Some(&mut frame)), 1);
            same(unsafe { frame.assume_init() }, expected);
        }
        assert_eq!(wsg_parser_expire(Some(parser), Some(&mut MaybeUninit::uninit())), 0);
    }
}

fn same(frame: wsg_frame_t, expected: Event<'_>) {
    let (id, length, kind) = match expected {
        Event::Frame(intact) => {
            let payload = unsafe { std::slice::from_raw_parts(frame.payload, frame.length.into()) };
            assert_eq!(payload, intact.payload);
            let mut event = MaybeUninit::uninit();
            let decoded = unsafe { wsg_reply_decode(Some(&frame), Some(&mut event)) };
            assert_eq!(decoded == 0, Reply::decode(&intact).is_ok());
            (intact.id, intact.payload.len(), WSG_FRAME_INTACT)
        }
        Event::BadChecksum { id, size } => (id, size.into(), WSG_FRAME_BAD_CHECKSUM),
        Event::Oversize { id, size } => (id, size.into(), WSG_FRAME_OVERSIZE),
    };
    assert_eq!((frame.id, usize::from(frame.length), frame.kind), (id, length, kind));
}

fn event(kind: wsg_event, command: u8, bytes: &[u8]) -> wsg_event_t {
    let value = wsg_value_t { bytes: wsg_bytes_t { data: bytes.as_ptr(), length: bytes.len() as u16 } };
    let value_kind = if bytes.is_empty() { wsg_value::None } else { wsg_value::Bytes } as u8;
    wsg_event_t { kind: kind as u8, command, status: 0, value_kind, value }
}

#[test]
fn full_queue_drops_reports_first_and_keeps_one_payload() {
    let mut events = [MaybeUninit::<wsg_event_t>::uninit(); 3];
    let mut bytes = [0u8; 8];
    let mut queue = MaybeUninit::uninit();
    let init = unsafe {
        wsg_queue_init(Some(&mut queue), events.as_mut_ptr().cast(), 3, bytes.as_mut_ptr(), bytes.len())
    };
    assert_eq!(init, 0);
    let queue = unsafe { queue.assume_init_mut() };
    let push = |queue: &mut wsg_queue_t, event: &wsg_event_t| unsafe {
        wsg_queue_push(ptr::from_mut(queue).cast(), event);
    };
    let pop = |queue: &mut wsg_queue_t| {
        let mut event = MaybeUninit::uninit();
        let count = unsafe { wsg_queue_pop(Some(queue), Some(&mut event)) };
        (count == 1).then(|| unsafe { event.assume_init() })
    };
    push(queue, &event(wsg_event::Answered, 1, b"tag"));
    push(queue, &event(wsg_event::Reported, 2, &[]));
    push(queue, &event(wsg_event::Answered, 3, b"no place for this one"));
    // Full: the report makes room, and then nothing does.
    push(queue, &event(wsg_event::Answered, 4, b"nor this"));
    push(queue, &event(wsg_event::Answered, 5, &[]));

    let first = pop(queue).unwrap();
    let data = unsafe { first.value.bytes };
    assert_eq!(unsafe { std::slice::from_raw_parts(data.data, data.length.into()) }, b"tag");
    let rest: Vec<u8> = std::iter::from_fn(|| pop(queue)).map(|event| event.command).collect();
    assert_eq!((first.command, &rest[..]), (1, &[3, 4][..]));
    // Two events and two payloads.
    assert_eq!(wsg_queue_lost(Some(queue)), 4);
    // The first one's place is free again.
    push(queue, &event(wsg_event::Answered, 6, b"again"));
    let last = pop(queue).unwrap();
    assert_eq!(unsafe { last.value.bytes.data }, bytes.as_ptr());
    assert_eq!(&bytes[..5], b"again");
}

#[test]
fn oversize_request_is_rejected_and_oversize_reply_is_no_answer() {
    unsafe extern "C" fn keep(context: *mut c_void, event: *const wsg_event_t) {
        unsafe { (*context.cast::<Vec<(u8, u8)>>()).push(((*event).kind, (*event).command)) };
    }
    const ID: u8 = 0xA0;
    let mut events: Vec<(u8, u8)> = Vec::new();
    let events_place = &raw mut events;
    let mut wsg = MaybeUninit::uninit();
    unsafe { wsg_init(Some(&mut wsg), None, Some(keep), events_place.cast()) };
    let wsg = unsafe { wsg.assume_init_mut() };
    let data = [0; WSG_MAX_PAYLOAD - 1];
    let mut below = generator(1);
    for now in 0..100_000 {
        unsafe { wsg_tick(wsg, now) };
        let mut message = [0; WSG_MAX_PAYLOAD + 8];
        if unsafe { wsg_transmit(wsg, now, message.as_mut_ptr(), message.len()) } > 0 {
            let payload = match CommandId::from_code(message[3]) {
                CommandId::Unknown(ID) => vec![0; WSG_MAX_PAYLOAD + 1],
                id => std::iter::repeat_with(|| reply(&mut below, id)).find(|it| it[..2] == [0, 0]).unwrap(),
            };
            let answer: Vec<u8> = FrameEncoder::new(message[3], &payload[..]).collect();
            unsafe { wsg_receive(wsg, now, answer.as_ptr(), answer.len()) };
        }
        if now == 1_000 {
            let custom =
                |wsg: &mut wsg_t, length| unsafe { wsg_custom(Some(wsg), ID, data.as_ptr(), length) };
            assert_eq!(custom(wsg, data.len()), wsg_error::TooLong as i32);
            assert_eq!(custom(wsg, data.len() - 1), 0);
        }
    }
    let mut counters = MaybeUninit::uninit();
    wsg::known::wsg_counters(Some(wsg), Some(&mut counters));
    assert_eq!(unsafe { counters.assume_init() }.oversize, 1);
    let of_custom: Vec<u8> =
        unsafe { &*events_place }.iter().filter(|it| it.1 == ID).map(|it| it.0).collect();
    assert_eq!(of_custom, [wsg_event::Unanswered as u8]);
}

#[test]
fn only_requests_are_accepted_in_the_callback() {
    struct Seen {
        wsg: *mut wsg_t,
        results: Vec<i32>,
    }
    unsafe extern "C" fn call_back(context: *mut c_void, _: *const wsg_event_t) {
        let seen = context.cast::<Seen>();
        unsafe {
            let wsg = (*seen).wsg;
            let results = [
                wsg_fast_stop(Some(&mut *wsg)),
                wsg_tick(wsg, 0),
                wsg_receive(wsg, 0, ptr::null(), 0),
                wsg_transmit(wsg, 0, [0; 32].as_mut_ptr(), 32),
                wsg_expire(wsg, 0),
                wsg_disconnect(Some(&mut *wsg)),
            ];
            (*seen).results.extend(results);
        }
    }
    let mut wsg = MaybeUninit::<wsg_t>::uninit();
    // As in C, every access is by this one pointer.
    let place = &raw mut wsg;
    let wsg: *mut wsg_t = place.cast();
    let mut seen = Seen { wsg, results: vec![] };
    let seen_place = &raw mut seen;
    assert_eq!(unsafe { wsg_init(Some(&mut *place), None, Some(call_back), seen_place.cast()) }, 0);
    // A Stop without a connection gets no reply.
    unsafe {
        assert_eq!(wsg_stop(Some(&mut *wsg)), 0);
        wsg_tick(wsg, 0);
        assert_eq!(wsg_transmit(wsg, 0, [0; 32].as_mut_ptr(), 32), 8);
        wsg_tick(wsg, 1_000);
    }
    let rejected = wsg_error::InCallback as i32;
    assert_eq!(seen.results[..6], [0, rejected, rejected, rejected, rejected, rejected]);
}

#[test]
fn texts_are_those_of_the_protocol() {
    let text = |text: *const c_char| unsafe { CStr::from_ptr(text) }.to_str().unwrap();
    for code in 0..40 {
        let status = Status::from_code(code);
        assert_eq!(text(wsg_status_name(code)), status.symbol());
        assert_eq!(text(wsg_status_text(code)), status.meaning());
    }
    for id in CommandId::ALL {
        assert_eq!(text(wsg_command_name(id.code())), id.name());
    }
    assert_eq!(text(wsg_command_name(0xFF)), "unknown command");
    assert_eq!(text(wsg_error_text(wsg_error::NotFinite as i32)), "number not finite");
    assert_eq!(text(wsg_error_text(7)), "no error");
    assert_eq!(text(wsg_error_text(-99)), "unknown error");
    assert_eq!(text(wsg_version()), env!("CARGO_PKG_VERSION"));
}
