//! The IP stack, tested with Ethernet frames.

use super::*;
const OWN: MacAddress = MacAddress([0x02, 0, 0, 0, 0, 0x10]);
const PEER: MacAddress = MacAddress([0x02, 0, 0, 0, 0, 0x01]);
const IP: IpParameters =
    IpParameters { address: [192, 168, 0, 5], mask: [255, 255, 255, 0], gateway: [192, 168, 0, 254] };

fn sum(bytes: &[u8]) -> [u8; 2] {
    let words = bytes.chunks(2).map(|word| u32::from(word[0]) << 8 | u32::from(*word.get(1).unwrap_or(&0)));
    let total: u32 = words.sum();
    (!(((total & 0xFFFF) + (total >> 16)) as u16)).to_be_bytes()
}

/// Returns a datagram from the peer to this port, without a checksum or with a wrong one.
fn udp(port: u16, payload: &[u8], is_wrong: bool) -> Vec<u8> {
    let len = payload.len() as u16;
    let [a, b] = (len + 28).to_be_bytes();
    let mut ip = [0x45, 0, a, b, 0, 0, 0x40, 0, 64, 17, 0, 0, 192, 168, 0, 1, 192, 168, 0, 5];
    let [a, b] = sum(&ip);
    (ip[10], ip[11]) = (a, b);
    let checksum = if is_wrong { [1, 2] } else { [0, 0] };
    let head = [&OWN.0[..], &PEER.0, &[8, 0], &ip, &50_000_u16.to_be_bytes(), &port.to_be_bytes()];
    [&head.concat()[..], &(len + 8).to_be_bytes(), &checksum, payload].concat()
}

fn arp(operation: u8, target: [u8; 4]) -> Vec<u8> {
    [
        &[0xFF; 6][..],
        &PEER.0,
        &[8, 6, 0, 1, 8, 0, 6, 4, 0, operation],
        &PEER.0,
        &[192, 168, 0, 1],
        &[0; 6],
        &target,
    ]
    .concat()
}

fn sent(stack: &mut IpStack) -> Vec<Vec<u8>> {
    let mut buffer = [0; MAX_FRAME_LEN];
    core::iter::from_fn(|| stack.poll_transmit(0, &mut buffer).map(|len| buffer[..len].to_vec())).collect()
}

#[test]
fn address_is_answered_for_as_soon_as_it_is_set_and_no_longer() {
    let mut stack = IpStack::new(OWN, 0);
    stack.receive(0, &arp(1, IP.address));
    assert_eq!(sent(&mut stack), Vec::<Vec<u8>>::new());
    stack.set_parameters(&IP);
    stack.receive(0, &arp(1, [192, 168, 0, 6]));
    stack.receive(0, &arp(1, IP.address));
    let answers = sent(&mut stack);
    assert_eq!(answers.len(), 1);
    assert_eq!((&answers[0][..6], answers[0][21], &answers[0][22..28]), (&PEER.0[..], 2, &OWN.0[..]));
    stack.set_parameters(&IpParameters::NONE);
    stack.receive(0, &arp(1, IP.address));
    assert_eq!(sent(&mut stack), Vec::<Vec<u8>>::new());
}

#[test]
fn datagrams_come_and_go_by_the_port_of_rpc() {
    let mut stack = IpStack::new(OWN, 0);
    stack.set_parameters(&IP);
    stack.receive(0, &arp(1, IP.address));
    sent(&mut stack);
    stack.receive(0, &udp(RPC_PORT, b"request", false));
    let from = Endpoint { address: [192, 168, 0, 1], port: 50_000 };
    assert_eq!(stack.take_datagram(|from, data| (from, data.to_vec())), Some((from, b"request".to_vec())));
    assert_eq!(stack.take_datagram(|_, _| ()), None);

    assert!(stack.send(0, from, b"answer"));
    let frames = sent(&mut stack);
    assert_eq!(frames.len(), 1);
    assert_eq!(
        (&frames[0][..6], &frames[0][26..38]),
        (&PEER.0[..], &[192, 168, 0, 5, 192, 168, 0, 1, 0x88, 0x94, 0xC3, 0x50][..])
    );
    assert_eq!(frames[0][42..], *b"answer");

    stack.receive(0, &udp(RPC_PORT + 1, b"other", false));
    assert_eq!(stack.take_datagram(|_, _| ()), None);
}

#[test]
fn datagram_without_a_computed_checksum_is_accepted() {
    let mut stack = IpStack::new(OWN, 0);
    stack.set_parameters(&IP);
    stack.receive(0, &udp(RPC_PORT, b"request", true));
    assert_eq!(stack.take_datagram(|_, data| data.to_vec()), Some(b"request".to_vec()));
}

#[test]
fn unresolved_address_does_not_block_the_next_answer() {
    let mut stack = IpStack::new(OWN, 0);
    stack.set_parameters(&IP);
    stack.receive(0, &arp(1, IP.address));
    sent(&mut stack);
    for last in 100..110 {
        assert!(stack.send(0, Endpoint { address: [192, 168, 0, last], port: 1 }, b"no station"));
    }
    sent(&mut stack);
    assert!(stack.send(0, Endpoint { address: [192, 168, 0, 1], port: 1 }, b"somebody"));
    let frames = sent(&mut stack);
    assert!(frames.iter().any(|frame| frame.ends_with(b"somebody")), "{frames:?}");
}

#[test]
fn other_networks_are_reached_by_the_router() {
    let mut stack = IpStack::new(OWN, 0);
    stack.set_parameters(&IP);
    assert!(stack.send(0, Endpoint { address: [10, 0, 0, 1], port: 1 }, b"far"));
    let frames = sent(&mut stack);
    assert_eq!(frames[0][38..42], IP.gateway, "an ARP request for the router's address");
}

#[test]
fn frames_that_are_too_long_or_of_other_protocols_are_ignored() {
    let mut stack = IpStack::new(OWN, 0);
    stack.set_parameters(&IP);
    stack.receive(0, &[0; MAX_FRAME_LEN + 1]);
    let good = udp(RPC_PORT, b"request", false);
    for len in 0..good.len() {
        stack.receive(0, &good[..len]);
    }
    assert_eq!((stack.take_datagram(|_, _| ()), sent(&mut stack).len()), (None, 0));
}
