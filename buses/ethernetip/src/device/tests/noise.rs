//! Random bytes, and valid messages with damaged bytes.

use super::*;
use crate::Receiver;

#[test]
fn noise_never_panics_and_never_sets_outputs() {
    let mut random = Random(7);
    let mut number = |limit: u64| random.next() % limit;
    for _ in 0..300 {
        let (mut rig, session) = Rig::with_session();
        let id = rig.open(1, session, &OWN).unwrap();
        let class_3 = hex(&rig.open(1, session, &EXPLICIT).unwrap().to_le_bytes());
        rig.events();
        let messages: Vec<Vec<u8>> = [
            OWN.hex(),
            Fo { is_large: true, ..INPUT_ONLY }.hex(),
            close(2),
            "5202 2006 2401 0a0e 0800 0e03 2001 2401 3007 0100 0100".into(),
            "1003 2064 2401 3001 3412".into(),
            "0e08 3404 0100 0c00 e9fd 8202 2001 2401 3001".into(),
        ]
        .iter()
        .map(|message| bytes(message))
        .collect();
        for _ in 0..60 {
            let message = &messages[number(6) as usize];
            let [len, longer] = [0, 2].map(|more| hex(&(message.len() as u16 + more).to_le_bytes()));
            let (message, count) = (hex(message), hex(&[number(4) as u8, 0]));
            let unconnected = format!("00000000 0000 0200 00000000 b200 {len} {message}");
            let connected = format!("00000000 0000 0200 a100 0400 {class_3} b100 {longer} {count} {message}");
            let packet = format!(
                "0200 0280 0800 {} 01000000 b100 0e00 0100 01000000 ffffffffffffffff",
                hex(&(id ^ 0x4000_0000).to_le_bytes())
            );
            let mut noise = match number(4) {
                0 => frame(0x6F, session, &bytes(&unconnected)),
                1 => frame(0x70, session, &bytes(&connected)),
                2 => bytes(&packet),
                _ => (0..number(80)).map(|_| number(256) as u8).collect(),
            };
            for _ in 0..number(4) {
                let at = number(noise.len() as u64 + 1) as usize;
                match number(3) {
                    0 => noise.truncate(at),
                    1 => noise.insert(at, number(256) as u8),
                    _ => noise.get_mut(at).into_iter().for_each(|byte| *byte = number(256) as u8),
                }
            }
            let mut receiver = Receiver::new();
            if let (_, Some(whole)) = receiver.push_slice(&noise) {
                rig.frame(1, whole);
            }
            rig.frame(1, &noise);
            // From the owner's address with a foreign identifier, and the reverse.
            rig.device.receive_packet(rig.now, if number(2) == 0 { PLC } else { OTHER }, &noise);
            rig.packet(OTHER, id, number(1 << 32) as u32, "0100 01000000 ffffffffffffffff");
            let from = SocketAddrV4::new(OTHER, 1);
            let mut answer = [0; MAX_FRAME_LEN];
            rig.device.receive_datagram(rig.now, from, number(2) == 0, &noise, &mut answer);
            rig.sent();
            rig.now += number(2_000_000);
            let events = rig.events();
            assert!(!events.iter().any(|event| matches!(event, Event::Outputs { .. })), "{events:?}");
            assert_eq!(rig.device.outputs(), &[0; 8]);
        }
    }
}
