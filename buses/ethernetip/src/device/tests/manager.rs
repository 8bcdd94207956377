//! The connection manager.

use super::*;
use std::vec;

/// The extended status of a refusal, and the right value of a wrong size.
fn refusal(rig: &mut Rig, session: u32, open: &Fo) -> String {
    let answer = rig.open(1, session, open).expect_err(open.path);
    // The answer ends with the triad.
    let triad = hex(&open.serial.to_le_bytes()) + "01000df0efbe0000";
    answer.strip_prefix(if open.is_large { "db0001" } else { "d40001" }).unwrap()[2..]
        .strip_suffix(&triad)
        .unwrap()
        .into()
}

#[test]
fn each_wrong_field_has_its_extended_status() {
    let (mut rig, session) = Rig::with_session();
    let path = |path| Fo { path, ..OWN };
    for (open, code) in [
        (Fo { transport: 0x02, ..OWN }, "0301"),
        (Fo { transport: 0x11, ..OWN }, "0301"),
        (Fo { flags: [2, 4], ..OWN }, "2301"),
        (Fo { flags: [0, 4], ..OWN }, "2301"),
        (Fo { flags: [4, 2], ..EXPLICIT }, "2401"),
        (Fo { flags: [4, 6], ..OWN }, "2401"),
        (Fo { flags: [12, 4], ..OWN }, "2501"),
        (Fo { flags: [0, 0], ..OWN }, "3201"),
        (Fo { rpi: [999, 20_000], ..OWN }, "1101"),
        (Fo { rpi: [20_000, 10_000_001], ..OWN }, "1101"),
        (Fo { multiplier: 8, ..OWN }, "1101"),
        (Fo { size: [10, 14], ..OWN }, "27010e00"),
        (Fo { size: [14, 12], ..OWN }, "28010e00"),
        (Fo { size: [14, 16], is_large: true, ..OWN }, "28010e00"),
        (Fo { size: [14, 14], ..INPUT_ONLY }, "27010200"),
        (path("2004 2497 2c96 2c64 8001 0000"), "26010000"),
        (path("2004 2497 2c95 2c64"), "2a01"),
        (path("2004 2497 2c96 2c65"), "2b01"),
        (path("2004 2c96"), "2f01"),
        (path("2004 2497 2c96 2c64 2c64"), "2f01"),
        (path("2001 2497 2c96 2c64"), "1701"),
        (path("2c96 2004 2c64"), "1503"),
        (path("2004 2497 2c96 2c64 80ff"), "1503"),
        (path("2004 2497 2c96 2c64 2d00"), "1503"),
        (path("2004 2497 2c96 2c64 8000 8000"), "1503"),
        (path("0100 2004 2c96 2c64"), "1503"),
        (path("2004 2004 2497 2c96 2c64"), "1503"),
        (path("3404 0000 0000 0000 0000 3404 0000 0000 0000 0000 2004 2497 2c96 2c64"), "1503"),
        (path("2004 3404 0000 0000 0000 0000 2497 2c96 2c64"), "1503"),
        (path("2004 2497 2c96 2c64 3001"), "1503"),
        (path("3404 0200 0000 0000 0000 2004 2497 2c96 2c64"), "1401"),
        (path("3404 0100 0000 0100 0000 2004 2497 2c96 2c64"), "1401"),
        (path("3404 0100 0b00 0000 0000 2004 2497 2c96 2c64"), "1501"),
        (path("3404 0100 0c00 e9fd 0303 2004 2497 2c96 2c64"), "1601"),
        (path("3404 0100 0c00 e9fd 0204 2004 2497 2c96 2c64"), "1601"),
        (path("3404 0100 0c00 e9fd 8204 2004 2497 2c96 2c64"), "1601"),
        (path("3405 0100 0c00 e9fd 0203 2004 2497 2c96 2c64"), "1503"),
        // A socket address of another station: the device would be an amplifier.
        (Fo { items: "0180 1000 0002 08ae c0a80002 0000000000000000", ..OWN }, "0502"),
        (LISTEN_ONLY, "1901"),
        (Fo { path: "2001 2401", ..EXPLICIT }, "1701"),
        (Fo { path: "2002 2401 2401", ..EXPLICIT }, "1701"),
        (Fo { rpi: [0, 1], ..EXPLICIT }, "1101"),
        (Fo { size: [4_000, 500], is_large: true, ..EXPLICIT }, "2701ff01"),
        (Fo { size: [500, 4_000], is_large: true, ..EXPLICIT }, "2801ff01"),
        // An answer to a request that opens a connection would not fit.
        (Fo { size: [500, 31], ..EXPLICIT }, "28012000"),
    ] {
        assert_eq!(refusal(&mut rig, session, &open), code, "{}", open.hex());
        assert_eq!((rig.events(), rig.sent()), (Vec::new(), Vec::new()));
    }
    assert_eq!(rig.device.counters().opens_refused, 45);
    // Lengths: a short request, and a path that is shorter or longer than announced.
    let whole = bytes(&OWN.hex());
    for (request, answer) in [
        (&*hex(&whole[..36]), "d4001300"),
        (&hex(&whole[..whole.len() - 2]), "d4001300"),
        (&(hex(&whole) + "0000"), "d4001500"),
        ("4e02 2006 2401 0af0 0100 0100 0df0", "ce001300"),
        ("4e02 2006 2401 0af0 0100 0100 0df0efbe 0200 2004", "ce001300"),
        ("4e02 2006 2401 0af0 0100 0100 0df0efbe 0000 2004", "ce001500"),
        (&close(1), "ce000101 0701 0100 0100 0df0efbe 0000"),
    ] {
        assert_like(&rig.message(1, session, request, ""), answer, request);
    }
}

#[test]
fn owners_open_with_each_form_of_the_path() {
    for open in [
        OWN,
        Fo { is_large: true, ..OWN },
        Fo { transport: 0x81, ..OWN },
        Fo { path: "2004 2c96 2c64", ..OWN },
        Fo { path: "2004 2401 2c96 2c64", ..OWN },
        Fo { path: "2004 2c97 2c96 2c64 8000", ..OWN },
        Fo { path: "2004 2497 2496 2464", ..OWN },
        Fo { path: "2100 0400 2500 9700 2d00 9600 2d00 6400", ..OWN },
        Fo { path: "3404 0100 0c00 e9fd 0203 2004 2497 2c96 2c64", ..OWN },
        Fo { path: "3404 0100 0c00 e9fd 8202 2004 2497 2c96 2c64", ..OWN },
        Fo { rpi: [1_000, 10_000_000], ..OWN },
    ] {
        let (mut rig, session) = Rig::with_session();
        rig.open(1, session, &open).expect(open.path);
        assert_eq!(rig.events(), [Event::Connected]);
        assert_eq!(refusal(&mut rig, session, &open), "0001", "the same triad");
        assert_eq!(refusal(&mut rig, session, &Fo { serial: 2, ..OWN }), "0601", "a second owner");
        assert_eq!(rig.events(), []);
    }
    for size in [0, 2, 6] {
        let (mut rig, session) = Rig::with_session();
        rig.open(1, session, &Fo { size: [size, 14], ..INPUT_ONLY }).unwrap();
        rig.open(1, session, &Fo { size: [size, 14], ..LISTEN_ONLY }).unwrap();
        assert_eq!(rig.events(), []);
    }
}

#[test]
fn full_tables_refuse_and_evict_nothing() {
    let (mut rig, session) = Rig::with_session();
    let io = (10..17).map(|serial| Fo { serial, ..INPUT_ONLY });
    let explicit = (20..28).map(|serial| Fo { serial, ..EXPLICIT });
    let mut ids: Vec<u32> = io.chain(explicit).map(|open| rig.open(1, session, &open).unwrap()).collect();
    // The owner's place is free, and no connection gets a place twice.
    assert_eq!(refusal(&mut rig, session, &Fo { serial: 30, ..INPUT_ONLY }), "1301");
    assert_eq!(refusal(&mut rig, session, &Fo { serial: 30, ..LISTEN_ONLY }), "1301");
    assert_eq!(refusal(&mut rig, session, &Fo { serial: 30, ..EXPLICIT }), "1301");
    ids.push(rig.open(1, session, &OWN).unwrap());
    assert_eq!((rig.sent().len(), rig.events()), (8, std::vec![Event::Connected]));
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), 16);
    assert!(ids.iter().all(|id| id >> PLACE_BITS != 0), "{ids:x?}");
    for serial in (10..17).chain(20..28).chain([1]) {
        assert_like(&rig.message(1, session, &close(serial), "")[..8], "ce000000", "close");
    }
    assert_eq!(rig.device.connections().count(), 0);
    assert_eq!(rig.events(), [Event::Left(Cause::Closed)]);
}

#[test]
fn only_the_opener_closes_over_any_of_its_sessions() {
    let (mut rig, session) = Rig::with_session();
    rig.open(1, session, &OWN).unwrap();
    rig.events();
    let (second, foreign) = (rig.register(2), rig.register(100));
    let denied = rig.message(100, foreign, &close(1), "");
    assert_like(&denied, "ce000f00 0100 0100 0df0efbe 0000", "another station");
    // The loss of TCP changes nothing, neither does the end of the session.
    rig.device.closed(1);
    assert_eq!((rig.events(), rig.device.state()), (Vec::new(), State::Waiting));
    assert_like(&rig.message(2, second, &close(1), ""), "ce000000 0100 0100 0df0efbe 0000", "the opener");
    assert_eq!((rig.events(), rig.device.state()), (std::vec![Event::Left(Cause::Closed)], State::Unowned));
    assert!(rig.sent().is_empty());
    // An owner that the application never knew leaves no trace, and takes no request away.
    assert_like(&rig.message(2, second, "0502 2001 2401", ""), "85000000", "reset");
    rig.open(2, second, &OWN).unwrap();
    rig.message(2, second, &close(1), "");
    assert_eq!(rig.events(), [Event::Reset(Reset::Restart)]);
}

#[test]
fn listen_only_ends_with_the_last_other_connection() {
    let (mut rig, session) = Rig::with_session();
    rig.open(1, session, &OWN).unwrap();
    rig.open(1, session, &INPUT_ONLY).unwrap();
    rig.open(1, session, &LISTEN_ONLY).unwrap();
    for (serial, remaining) in [(1, 2), (2, 0)] {
        rig.message(1, session, &close(serial), "");
        assert_eq!(rig.device.connections().count(), remaining);
    }
}

#[test]
fn multicast_is_one_production_until_its_last_consumer_leaves() {
    let (mut rig, session) = Rig::with_session();
    let other = rig.register(100);
    // The socket address of the request has no meaning for a group.
    let items = "0180 1000 0002 08af c0a80009 0000000000000000";
    let [owner, input, listen] =
        [OWN, INPUT_ONLY, LISTEN_ONLY].map(|open| Fo { flags: [4, 2], items, ..open });
    let open = |rig: &mut Rig, (client, session), open: &Fo| {
        let answer = rig.message(client, session, &open.hex(), open.items);
        assert_like(&answer[..8], "d4000000", open.path);
        answer[16..24].to_owned()
    };
    // Identifier, sequence number and receiver of each packet.
    let sent = |rig: &mut Rig| {
        let sent = rig.sent().into_iter();
        sent.map(|(to, packet)| (packet[12..20].to_owned(), packet[20..28].to_owned(), to))
            .collect::<Vec<_>>()
    };
    let packet = |id: &str, sequence: u32| {
        let group = SocketAddrV4::new(Ipv4Addr::new(239, 192, 1, 128), 2_222);
        (id.to_owned(), hex(&sequence.to_le_bytes()), group)
    };
    let id = open(&mut rig, (1, session), &input);
    assert_ne!(id, "2fa119e4");
    assert_eq!(sent(&mut rig), [packet(&id, 1)]);
    rig.now = 7_000;
    assert_eq!(open(&mut rig, (100, other), &owner), id);
    assert_eq!(open(&mut rig, (1, session), &listen), id);
    let slower = Fo { rpi: [20_000, 40_000], ..owner };
    assert_eq!(refusal(&mut rig, session, &Fo { serial: 9, ..slower }), "0601");
    assert_eq!(
        refusal(&mut rig, session, &Fo { path: INPUT_ONLY.path, size: [2, 14], serial: 9, ..slower }),
        "1201"
    );
    // A unicast connection with the same identifier keeps its own packets and interval.
    let unicast = SocketAddrV4::new(PLC, 2_222);
    let own = Fo { rpi: [20_000, 33_000], serial: 9, ..INPUT_ONLY };
    assert_eq!(open(&mut rig, (1, session), &own), "2fa119e4");
    assert_eq!(sent(&mut rig), [("2fa119e4".to_owned(), "01000000".to_owned(), unicast)]);
    rig.message(1, session, &close(9), "");
    assert_eq!((rig.device.poll_timeout(rig.now), rig.events()), (rig.now, vec![Event::Connected]));
    for sequence in 2..5 {
        assert_eq!(sent(&mut rig), []);
        rig.now = rig.device.poll_timeout(rig.now);
        assert_eq!(
            (rig.now, sent(&mut rig)),
            (u64::from(sequence - 1) * 20_000, vec![packet(&id, sequence)])
        );
        // The production survives the originator that began it, and ends with the last one that does not only listen.
        if sequence == 3 {
            rig.message(1, session, &close(2), "");
        }
    }
    rig.message(100, other, &close(1), "");
    rig.now += 20_000;
    assert_eq!((sent(&mut rig), rig.device.connections().count()), (vec![], 0));
    // The next production has an interval and an identifier of its own.
    let next = open(&mut rig, (1, session), &slower);
    assert_ne!(next, id);
    assert_eq!(sent(&mut rig), [packet(&next, 1)]);
    rig.device = Device::new(Profile { allows_multicast: false, ..PROFILE }, NETWORK, 1);
    let session = rig.register(1);
    assert_eq!(refusal(&mut rig, session, &owner), "2401");
    assert_like(&rig.message(1, session, "0e03 20f5 2401 3009", ""), "8e000000 0000000000000000", "no group");
}

#[test]
fn inputs_go_to_the_opener_at_the_port_of_its_choice() {
    for (items, port) in [
        ("", 2_222),
        ("0080 1000 0002 08af 0a000001 0000000000000000", 2_222),
        ("0180 1000 0002 08af 00000000 0000000000000000", 2_223),
        (
            "0080 1000 0002 08ae 00000000 0000000000000000 0180 1000 0002 08af c0a80001 0000000000000000",
            2_223,
        ),
        ("0180 1000 0002 0000 c0a80001 0000000000000000", 2_222),
    ] {
        let (mut rig, session) = Rig::with_session();
        rig.device.show_inputs(&[7; 12]);
        rig.open(1, session, &Fo { items, ..OWN }).unwrap();
        let [(to, packet)] = &rig.sent()[..] else { panic!("{items}") };
        assert_eq!(*to, SocketAddrV4::new(PLC, port), "{items}");
        let wanted = "0200 0280 0800 2fa119e4 01000000 b100 0e00 0100 070707070707070707070707";
        assert_like(packet, wanted, "first packet");
    }
}
