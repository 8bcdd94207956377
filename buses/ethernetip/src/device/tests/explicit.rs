//! Encapsulation, sessions, objects, class 3.

use super::*;

/// Frames of the measured exchange: command, data, data of the answer. `C` is the identifier in the answer before.
const WIRE: &str = "
    00 | 01020304 |
    04 | | 0100 0001 1400 0100 2001 436f6d6d756e69636174696f6e730000
    63 | | 0100 0c00 2b00 0100 0002af12c0a80005 0000000000000000 0100 0c00 e9fd 0203 3000 15cd5b07 09 4f70454e6572205043 03
    64 | | 0000
    6f | 00000000 0a00 0200 0000 0000 b200 0800 0e03 2004 2464 3003
       | 00000000 0000 0200 0000 0000 b200 1000 8e000000 000000000000000000000000
    6f | 00000000 0a00 0200 0000 0000 b200 0600 0102 2001 2401
       | 00000000 0000 0200 0000 0000 b200 1c00 81000000 0100 0c00 e9fd 0203 3000 15cd5b07 09 4f70454e6572205043
    6f | 00000000 0a00 0200 0000 0000 b200 1600 5202 2006 2401 0a0e 0800 0e03 2001 2401 3007 0100 0100
       | 00000000 0000 0200 0000 0000 b200 0e00 8e000000 09 4f70454e6572205043
    6f | 00000000 0a00 0200 0000 0000 b200 3c00 5402 2006 2401 0af0 30a119e4 2fa119e4 0100 0100 0df0efbe 01000000
         204e0000 0e48 204e0000 0e48 01 09 3404 000000000000 0000 2004 2497 2c96 2c64
       | 00000000 0000 0300 0000 0000 b200 1e00 d4000000 ........ 2fa119e4 0100 0100 0df0efbe 204e0000 204e0000 0000
         0080 1000 0002 08ae 00000000 0000000000000000
    6f | 00000000 0a00 0200 0000 0000 b200 1a00 4e02 2006 2401 0af0 0100 0100 0df0efbe 0400 2004 2497 2c96 2c64
       | 00000000 0000 0200 0000 0000 b200 0e00 ce000000 0100 0100 0df0efbe 0000
    6f | 00000000 0a00 0200 0000 0000 b200 3c00 5402 2006 2401 0af0 30a119e4 2fa119e4 0900 0100 0df0efbe 01000000
         204e0000 0248 204e0000 0e28 01 09 3404 000000000000 0000 2004 2497 2c98 2c64
       | 00000000 0000 0400 0000 0000 b200 1e00 d4000000 ........ ........ 0900 0100 0df0efbe 204e0000 204e0000 0000
         0080 1000 0002 08ae 00000000 0000000000000000 0180 1000 0002 08ae efc00180 0000000000000000
    6f | 00000000 0a00 0200 0000 0000 b200 3400 5402 2006 2401 0af0 30a119e4 2fa119e4 0100 4d4d 44332211 01000000
         204e0000 1048 204e0000 0e48 01 05 2004 2497 2c96 2c64 8000
       | 00000000 0000 0200 0000 0000 b200 1200 d4000102 2701 0e00 0100 4d4d 44332211 0000
    6f | 00000000 0a00 0200 0000 0000 b200 4000 5b02 2006 2401 0af0 30a119e4 2fa119e4 0200 0100 0df0efbe 01000000
         204e0000 0e000048 204e0000 0e000048 01 09 3404 000000000000 0000 2004 2497 2c96 2c64
       | 00000000 0000 0300 0000 0000 b200 1e00 db000000 ........ 2fa119e4 0200 0100 0df0efbe 204e0000 204e0000 0000
         0080 1000 0002 08ae 00000000 0000000000000000
    6f | 00000000 0a00 0200 0000 0000 b200 3000 5402 2006 2401 0af0 30a119e4 1a005c3c 0300 0100 0df0efbe 01000000
         204e0000 f443 204e0000 f443 a3 03 2002 2500 0100
       | 00000000 0000 0200 0000 0000 b200 1e00 d4000000 ........ 1a005c3c 0300 0100 0df0efbe 204e0000 204e0000 0000
    70 | 00000000 0000 0200 a100 0400 C b100 0a00 0100 0e03 2001 2401 3007
       | 00000000 0000 0200 a100 0400 1a005c3c b100 1000 0100 8e000000 09 4f70454e6572205043
    66 | |";

#[test]
fn wire_examples_get_the_measured_answers() {
    let (mut rig, session) = Rig::with_session();
    let mut id = String::new();
    let columns: Vec<&str> = WIRE.split('|').collect();
    // A row's last column ends with the next row's command.
    let mut command = columns[0];
    for pair in columns[1..].chunks(2) {
        let (data, (answer, next)) = (pair[0], pair[1].rsplit_once('\n').unwrap_or((pair[1], "")));
        let number = u16::from_str_radix(command.trim(), 16).unwrap();
        let found = rig.command(1, number, session, &data.replace('C', &id));
        assert_eq!(found.is_none(), answer.trim().is_empty(), "{command}");
        let (status, found) = found.unwrap_or_default();
        assert_eq!(status, 0, "{data}");
        assert_like(&hex(&found), answer, data);
        (id, command) = (hex(found.get(20..24).unwrap_or(&[])), next);
    }
    assert_eq!(rig.events().last(), Some(&Event::Close(1)));
}

#[test]
fn malformed_frames_have_the_status_of_the_specification() {
    let (mut rig, session) = Rig::with_session();
    for (command, handle, data, status) in [
        (0x65, 0, "0100 0000", 0x01),
        (0x65, 0, "0100 0000 00", 0x65),
        (0x1234, session, "", 0x01),
        (0x04, 0, "00", 0x65),
        (0x63, 0, "00", 0x65),
        (0x64, 0, "00", 0x65),
        (0x6F, session + 1, "", 0x64),
        (0x70, 0, "", 0x64),
        (0x66, session + 1, "", 0x64),
    ] {
        let found = rig.command(1, command, handle, data).map(|(status, _)| status);
        assert_eq!(found, Some(status), "{command:x} {data}");
    }
    let socket = "1000 0002 08ae 00000000 0000000000000000";
    // Interface, item count 0, 1, 3, 5 and 65535, item types and lengths, trailing bytes, incomplete messages. A socket
    // address twice, of another type, of another family.
    for data in "
        01000000 0000 0200 00000000 b200 0200 0100 | 00000000 0000 0000 00000000 b200 0200 0100
        00000000 0000 0100 00000000 b200 0200 0100 | 00000000 0000 0300 00000000 b200 0200 0100
        00000000 0000 ffff 00000000 b200 0200 0100 | 00000000 0000 0200 00000100 b200 0200 0100
        00000000 0000 0200 00000000 b100 0200 0100 | 00000000 0000 0200 00000000 b200 0300 0100
        00000000 0000 0200 00000000 b200 0200 010000 | 00000000 0000 0200 00000000 b200 0000 |
        00000000 0000 0200 a100 0400 01000000 b100 0400 0100 0100
        00000000 0000 0200 00000000 b200 0100 01 | 00000000 0000 0200 00000000 b200 0400 01ff 2001
        00000000 0000 0400 00000000 b200 0200 0100 0180 S 0180 S
        00000000 0000 0300 00000000 b200 0200 0100 0280 S
        00000000 0000 0300 00000000 b200 0200 0100 0180 1000 0003 08ae 00000000 0000000000000000"
        .split(['|', '\n'])
    {
        let data = data.trim().replace('S', socket);
        assert_eq!(rig.command(1, 0x6F, session, &data), Some((0x03, Vec::new())), "{data}");
    }
    // Connected messages: unconnected items; three items; without a sequence count; of an unknown connection.
    for (data, status) in [
        ("00000000 0000 0200 00000000 b200 0400 0100 0100", Some(0x03)),
        ("00000000 0000 0300 a100 0400 01000000 b100 0400 0100 0100", Some(0x03)),
        ("00000000 0000 0200 a100 0400 01000000 b100 0100 01", None),
        ("00000000 0000 0200 a100 0400 01000000 b100 0400 0100 0100", None),
    ] {
        assert_eq!(rig.command(1, 0x70, session, data).map(|(status, _)| status), status, "{data}");
    }
    // A length that the frame does not have, as the receiver passes a frame that is too long. Status and options are ignored.
    let mut wrong = frame(0x6F, session, &[]);
    wrong[2..4].copy_from_slice(&1_000_u16.to_le_bytes());
    assert_eq!(rig.frame(1, &wrong)[8], 0x65);
    for at in [8, 20] {
        let mut ignored = frame(0x04, 0, &[]);
        ignored[at] = 1;
        assert!(rig.frame(1, &ignored).is_empty());
    }
    assert_eq!(rig.command(2, 0x65, 0, "0200 0000"), Some((0x69, bytes("01000000"))));
}

#[test]
fn sessions_are_bound_to_their_tcp_connection() {
    let (mut rig, session) = Rig::with_session();
    let get = "00000000 0000 0200 00000000 b200 0600 0102 2001 2401";
    rig.register(2);
    for (client, handle, status) in [(1, session, 0), (2, session, 0x64), (3, session, 0x64), (1, 0, 0x64)] {
        assert_eq!(rig.command(client, 0x6F, handle, get).unwrap().0, status, "{client}");
    }
    // Another connection cannot unregister it.
    assert_eq!(rig.command(2, 0x66, session, "").unwrap().0, 0x64);
    // A full table refuses and evicts nothing.
    (3..=8).for_each(|client| assert_ne!(rig.register(client), session));
    assert_eq!(rig.command(9, 0x65, 0, "0100 0000").unwrap().0, 0x02);
    assert_eq!(rig.command(1, 0x6F, session, get).unwrap().0, 0);
    rig.device.closed(2);
    assert_ne!(rig.register(9), session);
    // Only frames prevent the inactivity time-out, half a frame does not arrive.
    rig.now = 119_999_999;
    rig.command(1, 0, session, "");
    assert_eq!(rig.device.poll_timeout(rig.now), 120_000_000);
    rig.now = 120_000_000;
    let mut closed = rig.events();
    closed.sort_by_key(|event| format!("{event:?}"));
    assert_eq!(closed, (3..=9).map(Event::Close).collect::<Vec<_>>());
    assert_eq!(rig.command(1, 0x6F, session, get).unwrap().0, 0);
}

#[test]
fn objects_answer_with_their_attributes_or_a_status() {
    let (mut rig, session) = Rig::with_session();
    for (request, answer) in [
        ("0e03 2001 2401 3001", "8e000000 0100"),
        ("0e03 2001 2401 3008", "8e000000 03"),
        ("0e03 2001 2400 3001", "8e000000 0100"),
        ("0e03 2004 2400 3002", "8e000000 9900"),
        ("0e03 2004 2400 3003", "8e000000 0500"),
        ("0e03 20f5 2400 3001", "8e000000 0400"),
        // 16 and 32 bits, and a connection point instead of the instance.
        ("0e06 2100 0400 2500 6400 3100 0400", "8e000000 0c00"),
        ("0e06 2004 2600 64000000 3100 0400", "8e000000 0c00"),
        ("0e03 2004 2c96 3003", "8e000000 0000000000000000"),
        ("0e03 2004 2497 3003", "8e000000"),
        ("0e03 2004 2497 3004", "8e000000 0000"),
        // Keys: any device, this device, compatible, and three others.
        ("0e08 3404 0000 0000 0000 0000 2001 2401 3001", "8e000000 0100"),
        ("0e08 3404 0100 0c00 e9fd 0203 2001 2401 3001", "8e000000 0100"),
        ("0e08 3404 0100 0c00 e9fd 8202 2001 2401 3001", "8e000000 0100"),
        ("0e08 3404 0200 0000 0000 0000 2001 2401 3001", "8e002500"),
        ("0e08 3404 0100 0c00 e9fd 8204 2001 2401 3001", "8e002500"),
        ("0e08 3404 0100 0c00 e9fd 0202 2001 2401 3001", "8e002500"),
        ("0e03 20f5 2401 3001", "8e000000 01000000"),
        ("0e03 20f5 2401 3004", "8e000000 0200 20f6 2401"),
        ("0e03 20f5 2401 3005", "8e000000 0500a8c0 00ffffff 00000000 00000000 00000000 0000"),
        ("0e03 20f5 2401 3006", "8e000000 0000"),
        ("0e03 20f5 2401 3008", "8e000000 01"),
        ("0e03 20f5 2401 3009", "8e000000 0000 0100 8001c0ef"),
        ("0e03 20f6 2401 3001", "8e000000 64000000"),
        ("0e03 20f6 2401 3003", "8e000000 020000000005"),
        ("0e03 20f6 2401 300b", "8e000000 02000000 01 6400 01"),
        ("0e03 2048 2401 3004", "8e000000 37"),
        ("0e03 2048 2401 3008", "8e000000 1b"),
        ("0e03 2048 2401 3009", "8e001400"),
        ("0102 2048 2401", "81000800"),
        ("0102 2001 2400", "81000800"),
        ("0e03 2001 2401 3001 0000", "8e000000 0100"),
        ("0e03 2099 2401 3001", "8e000500"),
        ("0e03 2001 2402 3001", "8e001600"),
        ("0e03 2004 2477 3003", "8e001600"),
        ("0e03 2001 2401 3063", "8e001400"),
        ("0e02 2001 2401", "8e001400"),
        ("0e03 2002 2401 3001", "8e001400"),
        ("0e03 2006 2401 3001", "8e001400"),
        ("4c02 2001 2401", "cc000800"),
        ("8e03 2001 2401 3001", "8e000800"),
        ("5402 2001 2401", "d4000800"),
        // No class; attribute before the instance; a member; a symbol; an incomplete segment; a reserved size.
        ("0e01 2401", "8e000400"),
        ("0e03 2001 3001 2401", "8e000400"),
        ("0e03 2001 2401 2801", "8e000400"),
        ("0e02 9102 6161", "8e000400"),
        ("0e02 2100 0100 ", "8e001400"),
        ("0e01 2100", "8e000400"),
        ("0e02 2300 0100", "8e000400"),
        ("0e00", "8e000400"),
        // Assemblies and the rest are read-only.
        ("1003 2004 2496 3003 0000000000000001", "90000e00"),
        ("1003 2001 2401 3001 0200", "90000e00"),
        ("1003 2001 2401 3063 0200", "90001400"),
        ("1003 20f5 2401 300d 3c00", "90000e00"),
        ("0e03 20f5 2401 300d", "8e000000 7800"),
        // Unconnected_Send: an odd message with its pad byte, then lengths and nesting.
        ("5202 2006 2401 0a0e 0900 0e03 2001 2401 3001 01 00 0100 0100", "8e000000 0100"),
        ("5202 2006 2401 0a0e 0800 0e03 2001 2401 3001 0200 0100", "d2001300"),
        ("5202 2006 2401 0a0e 0800 0e03 2001 2401 3001 0000 0100", "d2001500"),
        ("5202 2006 2401 0a0e ffff 0e03", "d2001300"),
        ("5202 2006 2402 0a0e 0800 0e03 2001 2401 3001 0100 0100", "d2001600"),
        ("5202 2006 2401 0a0e 0200 0e03 0000", "d2000400"),
        ("5202 2006 2401 0a0e 0e00 5202 2006 2401 0a0e 0200 0102 0000 0000", "d2000800"),
        // Registers of the application.
        ("1003 2064 2401 3001 3412", "90000000"),
        ("0e03 2064 2401 3001", "8e000000 3412"),
        ("0e04 2064 2401 3100 fa01", "8e001100"),
        ("0e03 2064 2409 3001", "8e001600"),
        ("1003 2064 2403 3001 3412", "90000e00"),
        ("0102 2064 2401", "81001400"),
        ("0103 2064 2401 3001", "81000800"),
    ] {
        assert_like(&rig.message(1, session, request, ""), answer, request);
    }
    // The longest answer.
    assert_eq!(bytes(&rig.message(1, session, "0e04 2064 2401 3100 f901", "")).len(), MAX_MESSAGE_LEN);
    let all = rig.message(1, session, "0102 20f5 2401", "");
    assert_eq!(bytes(&all).len(), 4 + 12 + 6 + 22 + 2 + 6 + 1 + 8 + 37 + 2);
    let all = rig.message(1, session, "0102 20f6 2401", "");
    assert_like(
        &all,
        &("81000000 64000000 0f000000 020000000005".to_owned()
            + &"00".repeat(96)
            + "02 010100 02000000 01 6400 01"),
        "Ethernet link",
    );
    rig.device = Device::new(PROFILE, Network { speed: 0, ..NETWORK }, 1);
    let session = rig.register(1);
    for (attribute, answer) in [("01", "00000000"), ("02", "01000000"), ("0b", "02000000 00")] {
        let request = format!("0e03 20f6 2401 30{attribute}");
        assert_like(&rig.message(1, session, &request, ""), &format!("8e000000 {answer}"), "unknown speed");
    }
}

#[test]
fn owner_makes_the_application_read_only_and_resets_wait() {
    let (mut rig, session) = Rig::with_session();
    let status = "0e03 2001 2401 3005";
    let id = rig.open(1, session, &OWN).unwrap();
    for (request, answer) in [
        (status, "8e000000 7100"),
        ("1003 2064 2401 3001 3412", "90001000"),
        ("1003 2004 2496 3003 0000000000000001", "90000e00"),
        ("0502 2001 2401", "85001000"),
    ] {
        assert_like(&rig.message(1, session, request, ""), answer, request);
    }
    rig.outputs(id, 1, 5, 1);
    assert_like(&rig.message(1, session, status, ""), "8e000000 6100", "run");
    assert_like(&rig.message(1, session, "0e03 2004 2496 3003", ""), "8e000000 0505050505050505", "outputs");
    let session = rig.register(2);
    rig.now = 160_000;
    assert_like(&rig.message(2, session, status, ""), "8e000000 2000", "timed out");
    assert_eq!(rig.events(), [Event::Left(Cause::Silence), Event::Close(1)]);
    for (request, answer, event) in [
        ("0502 2001 2401 02", "85000900", None),
        ("0502 2001 2401 0000", "85001500", None),
        ("0502 2001 2401", "85000000", Some(Event::Reset(Reset::Restart))),
        ("0502 2001 2401 01", "85000000", Some(Event::Reset(Reset::Factory))),
    ] {
        assert_like(&rig.message(2, session, request, ""), answer, request);
        assert_eq!(rig.events().first().copied(), event);
    }
}

#[test]
fn equal_sequence_counts_repeat_the_stored_answer() {
    let (mut rig, session) = Rig::with_session();
    let id = rig.open(1, session, &EXPLICIT).unwrap();
    let other = rig.register(2);
    let mut send = |client, session, count: &str, message: &str| {
        let (id, len) = (hex(&id.to_le_bytes()), bytes(message).len() as u8 + 2);
        let data = format!("00000000 0000 0200 a100 0400 {id} b100 {len:02x}00 {count} {message}");
        rig.command(client, 0x70, session, &data).map(|(_, data)| hex(&data[20..]))
    };
    let (serial, vendor) = ("0e03 2001 2401 3006", "0e03 2001 2401 3001");
    for (count, message, answer) in [
        ("0000", serial, "0000 8e000000 15cd5b07"),
        ("0000", vendor, "0000 8e000000 15cd5b07"),
        ("0100", vendor, "0100 8e000000 0100"),
        ("0000", vendor, "0000 8e000000 0100"),
        ("0500", "4c02 2001 2401", "0500 cc000800"),
    ] {
        assert_like(&send(1, session, count, message).unwrap(), answer, message);
    }
    // Over another TCP connection, even of the same station.
    assert_eq!(send(2, other, "0900", serial), None);
    // A message may close its own connection.
    assert_like(
        &send(1, session, "0a00", &close(4)).unwrap(),
        "0a00 ce000000 0400 0100 0df0efbe 0000",
        "close",
    );
    assert_eq!(send(1, session, "0b00", serial), None);
}

#[test]
fn class_3_answers_fit_and_end_with_tcp_or_their_time_out() {
    let (mut rig, session) = Rig::with_session();
    let small = Fo { size: [500, 32], ..EXPLICIT };
    let ask = |rig: &mut Rig, id: u32, count: &str| {
        let id = hex(&id.to_le_bytes());
        let data = format!("00000000 0000 0200 a100 0400 {id} b100 0800 {count} 0102 20f5 2401");
        rig.command(1, 0x70, session, &data).map(|(_, data)| hex(&data[20..]))
    };
    let id = rig.open(1, session, &small).unwrap();
    let last = rig.open(1, session, &Fo { serial: 9, multiplier: 7, ..EXPLICIT }).unwrap();
    rig.now = 9_999_999;
    assert_like(&ask(&mut rig, id, "0100").unwrap(), "0100 81001100", "too large");
    assert!(ask(&mut rig, last, "0200").is_some());
    // RPI 20 ms: 8 and 512 times.
    rig.now += 160_000;
    assert_eq!(ask(&mut rig, id, "0300"), None);
    assert!(rig.events().is_empty());
    rig.now += 10_240_000 - 160_000;
    assert_eq!(rig.events(), [Event::Close(1)]);
    // All connections of the originator have timed out. The loss of TCP ends the next one.
    rig.device.closed(1);
    let session = rig.register(1);
    assert_like(&rig.message(1, session, "0e03 2001 2401 3005", ""), "8e000000 3000", "no cyclic data");
    rig.open(1, session, &EXPLICIT).unwrap();
    rig.device.closed(1);
    assert_eq!(rig.device.connections().count(), 0);
}

#[test]
fn broadcasts_are_answered_after_a_random_delay() {
    let mut rig = Rig::new();
    let ask = |rig: &mut Rig, is_broadcast, frame: &[u8]| {
        let mut answer = [0; MAX_FRAME_LEN];
        let from = SocketAddrV4::new(PLC, 50_000);
        rig.device.receive_datagram(rig.now, from, is_broadcast, frame, &mut answer).map(<[u8]>::to_vec)
    };
    let mut question = frame(0x63, 0, &[]);
    let at_once = ask(&mut rig, false, &question).unwrap();
    // Longest delay in ms, in the first bytes of the context.
    for (context, longest) in [(0_u16, 2_000), (1, 500), (3_000, 3_000)] {
        question[12..14].copy_from_slice(&context.to_le_bytes());
        let mut delays = Vec::new();
        for _ in 0..200 {
            assert_eq!(ask(&mut rig, true, &question), None);
            let due = rig.device.poll_timeout(rig.now);
            delays.push(due - rig.now);
            assert!(rig.now == due || rig.sent().is_empty());
            rig.now = due;
            let sent = rig.sent();
            assert_eq!(sent[0].0, SocketAddrV4::new(PLC, 50_000));
            assert_eq!(bytes(&sent[0].1)[24..], at_once[24..]);
        }
        let max = delays.into_iter().max().unwrap();
        assert!((longest * 900..=longest * 1_000).contains(&max), "{context}: {max}");
    }
    (0..6).for_each(|_| drop(ask(&mut rig, true, &question)));
    assert_eq!(rig.device.counters().identities_lost, 2);
    // What a second device answers must not be answered.
    for wrong in [frame(0x1234, 0, &[]), at_once, frame(0x65, 0, &[1, 0, 0, 0]), frame(0x63, 0, &[0])] {
        assert_eq!(ask(&mut rig, false, &wrong), None);
    }
}
