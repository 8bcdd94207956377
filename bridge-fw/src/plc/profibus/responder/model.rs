//! Models of handler and main loop in every order of events: `cargo xtask loom`.

extern crate std;

use super::*;
use crate::atomic::model::made;
use loom::thread;
use std::boxed::Box;
use std::sync::Arc;

#[test]
fn input_image_is_read_whole_and_the_last_one_is_not_missed() {
    loom::model(|| {
        let buffers = Arc::new(made::<DpBuffers>());
        buffers.show([1; InputImage::LEN]);
        let shared = Arc::clone(&buffers);
        let handler = thread::spawn(move || shared.take_input());
        buffers.show([2; InputImage::LEN]);
        let taken = handler.join().unwrap();
        assert!(matches!(taken, None | Some([1 | 2, ..])));
        if let Some(image) = taken {
            assert_eq!(image, [image[0]; InputImage::LEN], "torn");
        }
        let is_last = taken == Some([2; InputImage::LEN]);
        assert_eq!(buffers.take_input(), (!is_last).then_some([2; InputImage::LEN]));
    });
}

#[test]
fn events_are_received_completely_and_in_order() {
    const EVENTS: [FromMaster; 3] = [
        FromMaster::Output([1; OutputImage::LEN]),
        FromMaster::Left { silent: true },
        FromMaster::Output([2; OutputImage::LEN]),
    ];
    loom::model(|| {
        let buffers = Arc::new(made::<DpBuffers>());
        let shared = Arc::clone(&buffers);
        let handler = thread::spawn(move || {
            for event in EVENTS {
                while !shared.push(event) {
                    thread::yield_now();
                }
            }
        });
        for event in EVENTS {
            let taken = loop {
                match buffers.take() {
                    Some(taken) => break taken,
                    None => thread::yield_now(),
                }
            };
            assert_eq!(taken, event);
        }
        handler.join().unwrap();
        assert_eq!(buffers.take(), None);
    });
}

#[test]
fn handler_has_the_address_with_the_first_rate() {
    loom::model(|| {
        let buffers: &'static DpBuffers = Box::leak(Box::new(made()));
        let handler = thread::spawn(move || {
            let mut responder = DpResponder::new(buffers);
            responder.take_rate().map(|rate| (rate, responder.slave.address().station))
        });
        buffers.set_address(9);
        buffers.set_rate(Baud::K500);
        assert!(matches!(handler.join().unwrap(), None | Some((Baud::K500, 9))));
    });
}
