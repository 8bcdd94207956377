//! A CAN bus of SLCAN lines: the emulated board, a virtual gripper, and a terminal for masters.
//!
//! What one says all others hear, in the order in which it comes. The board is on a line without answers; whoever is on
//! the masters' line is the host of an adapter.

use std::io::Write;
use std::os::unix::net::UnixStream;
use std::sync::mpsc::{self, Sender};
use std::thread;

use anyhow::{Context, Result};
use bus_slcan::{Adapter, ClassicFrame, Decoder, Line, encode};
use embedded_can::{Frame, Id};
use wsg_protocol::can::{Identifiers, Segmenter};

use crate::uninterrupted;

/// Who is on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Station {
    Board,
    Gripper,
    Master,
}

/// What a station says.
type Said = (Station, Vec<u8>);

/// The bus's lines.
#[derive(Debug)]
pub struct CanHub {
    /// The gripper's end: messages byte by byte, as [`GripperEnd`](crate::gripper_end::GripperEnd) takes them.
    pub gripper: UnixStream,
    /// The master's end: SLCAN, with the answers of an adapter.
    pub master: UnixStream,
}

impl CanHub {
    /// A bus with the board on it. It is there until the board is gone.
    ///
    /// # Errors
    /// When a line or a thread cannot be made.
    pub fn start(board: UnixStream) -> Result<Self> {
        let (gripper, own_gripper) = UnixStream::pair()?;
        let (master, own_master) = UnixStream::pair()?;
        let (sender, said) = mpsc::channel();
        for (station, line) in
            [(Station::Board, &board), (Station::Gripper, &own_gripper), (Station::Master, &own_master)]
        {
            listen(station, line.try_clone()?, sender.clone())?;
        }
        let mut bus = Bus {
            board: (board, Decoder::new()),
            gripper: (own_gripper, Segmenter::new()),
            master: (own_master, Decoder::new(), Adapter::new()),
        };
        thread::Builder::new().name("can".into()).spawn(move || {
            for (station, bytes) in said {
                if bus.take(station, &bytes).is_none() {
                    return;
                }
            }
        })?;
        Ok(Self { gripper, master })
    }
}

fn listen(station: Station, line: UnixStream, sender: Sender<Said>) -> Result<()> {
    let run = move || {
        let mut chunk = [0; 256];
        while let Ok(count @ 1..) = uninterrupted::read(&line, &mut chunk) {
            if sender.send((station, chunk[..count].to_vec())).is_err() {
                return;
            }
        }
    };
    thread::Builder::new().name("can line".into()).spawn(run).context("no thread for a line")?;
    Ok(())
}

struct Bus {
    board: (UnixStream, Decoder),
    gripper: (UnixStream, Segmenter),
    master: (UnixStream, Decoder, Adapter),
}

impl Bus {
    /// `None` when the board is gone.
    fn take(&mut self, station: Station, bytes: &[u8]) -> Option<()> {
        for &byte in bytes {
            let frame = match station {
                Station::Board => match self.board.1.push(byte) {
                    Some(Line::Frame(frame)) => Some(frame),
                    _ => None,
                },
                Station::Gripper => {
                    let id = Identifiers::DEFAULT.gripper().transmit;
                    self.gripper.1.push(byte).and_then(|segment| segment.frame(id))
                }
                Station::Master => {
                    let line = self.master.1.push(byte);
                    let answer = line.map_or(&b""[..], |line| self.master.2.answer(&line));
                    // A master that is gone hears nothing.
                    let _ = self.master.0.write_all(answer);
                    match line {
                        Some(Line::Frame(frame)) if self.master.2.is_open() => Some(frame),
                        _ => None,
                    }
                }
            };
            if let Some(frame) = frame {
                self.spread(station, &frame)?;
            }
        }
        Some(())
    }

    fn spread(&mut self, from: Station, frame: &ClassicFrame) -> Option<()> {
        let line = encode(frame);
        if from != Station::Board {
            self.board.0.write_all(line.as_bytes()).ok()?;
        }
        let for_gripper = frame.id() == Id::Standard(Identifiers::DEFAULT.gripper().receive);
        if from != Station::Gripper && for_gripper && frame.is_data_frame() {
            let _ = self.gripper.0.write_all(frame.data());
        }
        if from != Station::Master && self.master.2.is_open() {
            let _ = self.master.0.write_all(line.as_bytes());
        }
        Some(())
    }
}
