//! Messages to and from the scripts on the gripper: the project's own and UMI's.

use crate::types::SystemFlags;

/// The command id of `wsg_stream.lua`.
pub(super) const STREAM_ID: u8 = 0xA5;
/// The payload that ends a running stream and measures.
pub(super) const STREAM_END: [u8; 1] = [0];
/// The command ids of UMI's `cmd_measure.lua`: measurement and position control.
pub(super) const UMI_MEASURE_ID: u8 = 0xB0;
pub(super) const UMI_MOVE_ID: u8 = 0xB1;

/// Maximum length of the reply of either script, after its status, in bytes.
pub(super) const MAX_ANSWER_LEN: usize = STREAM_ANSWER_LEN;
const STREAM_ANSWER_LEN: usize = 21;
const UMI_ANSWER_LEN: usize = 17;
/// The layout version reported by `wsg_stream.lua`.
const VERSION: u8 = 1;

/// The gain for UMI's script, in 1/s.
const UMI_GAIN: f32 = 15.0;

/// The order that a script follows until the next message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Order {
    /// Target position in mm.
    pub(super) position: f32,
    /// Speed limit in mm/s.
    pub(super) speed_limit: f32,
    /// Force limit in N, summed over both fingers.
    pub(super) force_limit: f32,
}

/// The state in a reply, in mm, mm/s and N.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Measured {
    pub(super) flags: SystemFlags,
    pub(super) position: f32,
    pub(super) speed: f32,
    pub(super) force: f32,
    /// The gripper's time in ms.
    pub(super) measured_ms: Option<u32>,
}

/// Returns the payload of a set-point for `wsg_stream.lua`.
pub(super) fn stream_order(order: &Order) -> [u8; 12] {
    let mut payload = [0; 12];
    put(&mut payload, &[order.position, order.speed_limit, order.force_limit]);
    payload
}

/// Decodes the bytes after the status in a reply of `wsg_stream.lua`.
pub(super) fn stream_answer(answer: &[u8]) -> Option<Measured> {
    let (&VERSION, values) = answer.split_first()? else { return None };
    let [flags, position, speed, force, time] = *words(values)?;
    Some(Measured {
        flags: SystemFlags::from_bits_retain(u32::from_le_bytes(flags)),
        position: f32::from_le_bytes(position),
        speed: f32::from_le_bytes(speed),
        force: f32::from_le_bytes(force),
        measured_ms: Some(u32::from_le_bytes(time)),
    })
}

/// Returns the payload of B1h for UMI's script, which moves at `gain * way`. The gain keeps that speed within the
/// limit, for the path from `here` in mm.
pub(super) fn umi_order(order: &Order, here: f32) -> [u8; 25] {
    let mut payload = [1; 25];
    let gain = UMI_GAIN.min(order.speed_limit / (order.position - here).abs());
    let [_, values @ ..] = &mut payload;
    put(values, &[order.position, order.speed_limit, gain, 0.0, order.force_limit, order.force_limit]);
    payload
}

/// Decodes the bytes after the status in a reply of UMI's script. It reports only the lowest byte of the flags; `known`
/// provides the others. The resolution of its time is too coarse to be usable.
pub(super) fn umi_answer(answer: &[u8], known: SystemFlags) -> Option<Measured> {
    let (&lowest, values) = answer.split_first()?;
    let [position, speed, force, _] = words(values)?.map(f32::from_le_bytes);
    let flags = SystemFlags::from_bits_retain(known.bits() & !0xFF | u32::from(lowest));
    Some(Measured { flags, position, speed, force, measured_ms: None })
}

const _: () = assert!(UMI_ANSWER_LEN <= MAX_ANSWER_LEN);

fn put(payload: &mut [u8], values: &[f32]) {
    for (place, value) in payload.as_chunks_mut::<4>().0.iter_mut().zip(values) {
        *place = value.to_le_bytes();
    }
}

/// Returns the bytes as exactly `N` four-byte words.
fn words<const N: usize>(bytes: &[u8]) -> Option<&[[u8; 4]; N]> {
    let (words, rest) = bytes.as_chunks::<4>();
    if rest.is_empty() { words.try_into().ok() } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ORDER: Order = Order { position: 40.0, speed_limit: 100.0, force_limit: 20.0 };

    #[test]
    fn answer_to_a_three_number_set_point_has_time_and_all_flags() {
        assert_eq!(stream_order(&ORDER), [0, 0, 0x20, 0x42, 0, 0, 0xC8, 0x42, 0, 0, 0xA0, 0x41]);
        let mut answer = [0; STREAM_ANSWER_LEN];
        answer[..5].copy_from_slice(&[VERSION, 1, 0x10, 0, 0]);
        put(&mut answer[5..17], &[40.0, -5.0, 20.0]);
        answer[17] = 7;
        let measured = stream_answer(&answer).unwrap();
        assert_eq!(measured.flags, SystemFlags::REFERENCED | SystemFlags::FAST_STOP);
        assert_eq!((measured.position, measured.speed, measured.force), (40.0, -5.0, 20.0));
        assert_eq!(measured.measured_ms, Some(7));
    }

    #[test]
    fn answers_of_other_scripts_are_not_taken() {
        assert_eq!(stream_answer(&[]), None);
        assert_eq!(stream_answer(&[VERSION; STREAM_ANSWER_LEN - 1]), None);
        assert_eq!(stream_answer(&[VERSION + 1; STREAM_ANSWER_LEN]), None);
        assert_eq!(umi_answer(&[0; UMI_ANSWER_LEN + 4], SystemFlags::empty()), None);
    }

    #[test]
    fn umi_gain_keeps_the_speed_within_the_limit() {
        let speed = |here: f32| {
            let payload = umi_order(&ORDER, here);
            let [position, _, gain, ..] = words::<6>(&payload[1..]).unwrap().map(f32::from_le_bytes);
            gain * (position - here)
        };
        assert_eq!(speed(0.0), 100.0);
        assert_eq!(speed(42.0), -30.0);
        assert_eq!(speed(40.0), 0.0);
    }

    #[test]
    fn umi_answer_takes_the_higher_flags_from_elsewhere() {
        let mut answer = [0; UMI_ANSWER_LEN];
        answer[0] = SystemFlags::REFERENCED.bits() as u8;
        let measured = umi_answer(&answer, SystemFlags::FAST_STOP | SystemFlags::MOVING).unwrap();
        assert_eq!(measured.flags, SystemFlags::REFERENCED | SystemFlags::FAST_STOP);
        assert_eq!(measured.measured_ms, None);
    }
}
