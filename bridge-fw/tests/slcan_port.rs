//! CAN over a serial line that has little room: what leaves, what is given up, what comes.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::rc::Rc;

use bus_slcan::ClassicFrame;
use embedded_can::nb::Can;
use embedded_can::{Frame, StandardId};
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use wsg_bridge_fw::can::{CanController, SlcanPort};

/// A serial line; the other end is the test's.
#[derive(Clone, Debug, Default)]
struct Line(Rc<RefCell<Ends>>);

#[derive(Debug, Default)]
struct Ends {
    coming: VecDeque<u8>,
    left: Vec<u8>,
    /// Bytes that it takes before it is full.
    room: usize,
    /// It says that it has room, and takes nothing.
    lies: bool,
}

impl ErrorType for Line {
    type Error = Infallible;
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.borrow().coming.is_empty())
    }
}

impl Read for Line {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        Ok(self.0.borrow_mut().coming.pop_front().map_or(0, |byte| {
            buffer[0] = byte;
            1
        }))
    }
}

impl WriteReady for Line {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        let ends = self.0.borrow();
        Ok(ends.room > 0 || ends.lies)
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let mut ends = self.0.borrow_mut();
        let count = bytes.len().min(ends.room);
        ends.room -= count;
        ends.left.extend(&bytes[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

fn with_room(room: usize) -> (SlcanPort<Line>, Line) {
    let line = Line::default();
    line.0.borrow_mut().room = room;
    (SlcanPort::new(line.clone()), line)
}

fn frame(id: u16) -> ClassicFrame {
    ClassicFrame::new(StandardId::new(id).unwrap(), &[0xAB]).unwrap()
}

fn left(line: &Line) -> String {
    String::from_utf8(line.0.borrow().left.clone()).unwrap()
}

#[test]
fn a_frame_leaves_as_a_line() {
    let (mut port, line) = with_room(100);
    assert_eq!(port.transmit(&frame(0x123)), Ok(None));
    assert_eq!(left(&line), "t1231AB\r");
}

#[test]
fn the_rest_of_a_line_leaves_as_there_is_room_and_the_next_frame_waits_for_it() {
    let (mut port, line) = with_room(3);
    assert_eq!(port.transmit(&frame(0x123)), Ok(None));
    assert_eq!(left(&line), "t12");
    assert_eq!(port.transmit(&frame(0x124)), Err(nb::Error::WouldBlock));
    line.0.borrow_mut().room = 2;
    // Also by looking for frames.
    assert_eq!(port.receive(), Err(nb::Error::WouldBlock));
    assert_eq!(left(&line), "t1231");
    line.0.borrow_mut().room = 100;
    assert_eq!(port.transmit(&frame(0x124)), Ok(None));
    assert_eq!(left(&line), "t1231AB\rt1241AB\r");
}

#[test]
fn a_line_that_takes_nothing_though_it_has_room_is_tried_again() {
    let (mut port, line) = with_room(1);
    line.0.borrow_mut().lies = true;
    assert_eq!(port.transmit(&frame(0x123)), Ok(None));
    assert_eq!(left(&line), "t");
    line.0.borrow_mut().room = 100;
    assert_eq!(port.receive(), Err(nb::Error::WouldBlock));
    assert_eq!(left(&line), "t1231AB\r");
}

#[test]
fn a_line_that_has_begun_is_ended_and_one_that_has_not_is_forgotten() {
    for (room, ends_as) in [(1, "t1231AB\r"), (0, "")] {
        let (mut port, line) = with_room(room);
        assert_eq!(port.transmit(&frame(0x123)), Ok(None));
        port.abort();
        line.0.borrow_mut().room = 100;
        assert_eq!(port.receive(), Err(nb::Error::WouldBlock));
        assert_eq!(left(&line), ends_as);
    }
}

#[test]
fn frames_come_between_lines_that_are_none() {
    let (mut port, line) = with_room(0);
    line.0.borrow_mut().coming.extend(b"V\rt1231AB\rt99\rt1241AB\r".iter());
    assert_eq!(port.receive(), Ok(frame(0x123)));
    assert!(matches!(port.receive(), Err(nb::Error::Other(_))));
    assert_eq!(port.receive(), Ok(frame(0x124)));
    assert_eq!(port.receive(), Err(nb::Error::WouldBlock));
}
