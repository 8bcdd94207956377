//! Models of handler and main loop in every order of events: `cargo xtask loom`.

extern crate std;

use core::convert::Infallible;

use super::*;
use crate::atomic::model::made;
use embedded_hal::spi::ErrorType;
use loom::thread;
use std::sync::Arc;

/// A controller with one frame in each receive buffer.
struct Controller {
    full: [bool; 2],
}

impl ErrorType for Controller {
    type Error = Infallible;
}

impl SpiDevice for Controller {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        match operations {
            [Operation::TransferInPlace([_, status])] => {
                *status = if self.full[0] { RX0IF } else { 0 } | if self.full[1] { RX1IF } else { 0 };
            }
            [Operation::Write(read), Operation::Read(raw)] => {
                let buffer = usize::from(**read == [READ_RX[1]]);
                self.full[buffer] = false;
                raw.fill(1 + buffer as u8);
            }
            _ => unreachable!(),
        }
        Ok(())
    }
}

#[test]
fn frames_are_read_whole_and_from_the_first_buffer_after_set_up() {
    loom::model(|| {
        let buffers = Arc::new(made::<Mcp2515Buffers>());
        // Left over from an earlier set-up.
        buffers.second_is_older.store(true, Ordering::Relaxed);
        let shared = Arc::clone(&buffers);
        let handler = thread::spawn(move || {
            let mut controller = Controller { full: [true; 2] };
            for _ in 0..2 {
                let _ = shared.serve(&mut controller);
            }
            controller.full
        });
        buffers.open();
        let first = buffers.pop();
        let full = handler.join().unwrap();
        let rest = [first, buffers.pop(), buffers.pop()];
        let popped = rest.iter().flatten().count();
        assert_eq!(popped, full.iter().filter(|full| !**full).count(), "each frame is read once");
        for (frame, byte) in rest.iter().flatten().zip(1..) {
            assert_eq!(*frame, [byte; FRAME_LEN]);
        }
    });
}
