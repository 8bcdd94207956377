//! Cost of the parser's two paths for payloads of several lengths.

use core::hint::black_box;

use cortex_m_semihosting::hprintln;
use wsg_protocol::{Event, FrameEncoder, FrameParser};

use crate::counting::Counter;

const PAYLOADS: [usize; 4] = [2, 14, 64, 256];
const LONGEST: usize = 256;

/// Counts whole frames, including preamble and checksum, with the caller's loop over the bytes.
// Not inlined, so that register allocation is independent of the other measurements.
#[inline(never)]
pub(crate) fn count(counter: &Counter) {
    let mut parser = FrameParser::<LONGEST>::new();
    let mut line = [0; LONGEST + 8];
    for size in PAYLOADS {
        let payload: [u8; LONGEST] = core::array::from_fn(|at| at as u8);
        let Some(payload) = payload.get(..size) else { continue };
        let length = FrameEncoder::new(0x06, payload).write_into(&mut line);
        let frame = black_box(length.ok().and_then(|length| line.get(..length)).unwrap_or(&[]));

        let parser = black_box(&mut parser);
        let mut delivered = 0;
        let instructions = counter.of(|| {
            for &byte in frame {
                if let Some(Event::Frame(frame)) = parser.push(byte) {
                    delivered += frame.payload.len();
                }
            }
        });
        assert!(delivered == size, "the frame must be delivered");
        hprintln!("byte-path/{} {} {}", size, instructions, frame.len());

        let mut delivered = 0;
        let instructions = counter.of(|| {
            let mut rest = frame;
            while let (taken, Some(event)) = parser.push_slice(rest) {
                if let Event::Frame(frame) = event {
                    delivered += frame.payload.len();
                }
                rest = rest.get(taken..).unwrap_or(&[]);
            }
        });
        assert!(delivered == size, "the frame must be delivered");
        hprintln!("bulk-path/{} {} {}", size, instructions, frame.len());
    }
}
