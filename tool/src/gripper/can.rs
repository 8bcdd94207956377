//! Transport to a gripper on a CAN bus, through an SLCAN adapter or an interface of Linux SocketCAN.

use std::collections::VecDeque;
use std::io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
use std::io::{self, Read, Write};
use std::thread::sleep;
use std::time::{Duration, Instant};

use bus_slcan::{ClassicFrame, Decoder as LineDecoder, Line, encode};
use embedded_can::{Frame, StandardId};
use wsg_protocol::can::{HALF_MESSAGE_MS, Identifiers, MAX_FRAMES, Reassembler, Segmenter};
use wsg_protocol::driver::{Clock, host::StdClock};
use wsg_protocol::{Event, FrameEncoder};

/// Rate of the serial port of an adapter in bit/s. USB adapters ignore it; others use it as their default.
pub(crate) const PORT_RATE: u32 = 115_200;

/// Maximum number of bytes per read.
const CHUNK_LEN: usize = 512;

/// Length of Linux's `struct can_frame`: identifier with flags, data length, three unused bytes, and data.
pub(crate) const STRUCT_LEN: usize = 16;

/// Flag in its identifier: not a frame of the bus, but an error of the controller.
const ERROR: u32 = 1 << 29;

/// Pause between two attempts to write to a full interface, and the longest time until the bus has taken a frame.
const RETRY: Duration = Duration::from_millis(2);
const WRITE_TIME: Duration = Duration::from_secs(1);

/// How a port carries CAN frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Carrier {
    /// SLCAN: each frame is a line of text.
    Slcan,
    /// SocketCAN: each read or write is a frame, as a `struct can_frame`.
    SocketCan,
}

impl Carrier {
    fn encode(self, frame: &ClassicFrame, identifier: StandardId) -> Vec<u8> {
        match self {
            Self::Slcan => encode(frame).as_bytes().to_vec(),
            Self::SocketCan => {
                let mut bytes = u32::from(identifier.as_raw()).to_ne_bytes().to_vec();
                bytes.extend([frame.data().len() as u8, 0, 0, 0]);
                bytes.extend(frame.data());
                bytes.resize(STRUCT_LEN, 0);
                bytes
            }
        }
    }

    /// Returns the maximum number of bytes of a write.
    const fn write_len(self) -> usize {
        match self {
            Self::Slcan => usize::MAX,
            Self::SocketCan => STRUCT_LEN,
        }
    }

    /// Returns the bytes that end the use of a port: they close the channel of an SLCAN adapter, after the rest of an earlier line.
    pub(crate) const fn closing(self) -> &'static [u8] {
        match self {
            Self::Slcan => b"\rC\r",
            Self::SocketCan => b"",
        }
    }
}

/// Returns the frame in a `struct can_frame`, if it is a data frame with a standard identifier.
fn frame_of(bytes: &[u8; STRUCT_LEN]) -> io::Result<Option<ClassicFrame>> {
    let [i0, i1, i2, i3, len, _, _, _, data @ ..] = bytes;
    let identifier = u32::from_ne_bytes([*i0, *i1, *i2, *i3]);
    if identifier & ERROR != 0 {
        return Err(io::Error::other("the CAN controller is bus-off"));
    }
    // Any flag exceeds 16 bits.
    let identifier = u16::try_from(identifier).ok().and_then(StandardId::new);
    Ok(identifier.zip(data.get(..usize::from(*len))).and_then(|(id, data)| ClassicFrame::new(id, data)))
}

/// Returns whether a write failed because the queue of a CAN interface is full. The system does not report when it has room.
#[cfg(unix)]
pub(crate) fn is_full(error: &io::Error) -> bool {
    error.raw_os_error() == Some(rustix::io::Errno::NOBUFS.raw_os_error())
}

#[cfg(not(unix))]
fn is_full(_: &io::Error) -> bool {
    false
}

/// Returns the digit of the SLCAN command `S` for a rate in kbit/s, or `None` for an unsupported rate.
pub(crate) fn rate_of(kbit: u16) -> Option<char> {
    const RATES: [(u16, char); 9] = [
        (10, '0'),
        (20, '1'),
        (50, '2'),
        (100, '3'),
        (125, '4'),
        (250, '5'),
        (500, '6'),
        (800, '7'),
        (1000, '8'),
    ];
    RATES.iter().find(|(rate, _)| *rate == kbit).map(|(_, digit)| *digit)
}

/// Closes any channel that is open on the adapter, sets the rate and opens the channel.
pub(crate) fn open_channel(port: &mut impl Write, kbit: u16) -> io::Result<()> {
    let rate =
        rate_of(kbit).ok_or_else(|| io::Error::other(format!("SLCAN does not support {kbit} kbit/s")))?;
    write!(port, "\rC\rS{rate}\rO\r")
}

/// Encodes gripper messages as CAN frames, and writes them to a port, if it has one.
#[derive(Debug)]
pub(crate) struct Encoder<S> {
    port: S,
    pub(crate) carrier: Carrier,
    identifier: StandardId,
    segmenter: Segmenter,
}

impl<S> Encoder<S> {
    pub(crate) const fn new(port: S, carrier: Carrier, identifiers: Identifiers) -> Self {
        Self { port, carrier, identifier: identifiers.controller().transmit, segmenter: Segmenter::new() }
    }

    /// Returns the CAN frames that these bytes of messages complete.
    pub(crate) fn encode(&mut self, bytes: &[u8]) -> Vec<u8> {
        let Self { carrier, identifier, segmenter, .. } = self;
        let segments = bytes.iter().filter_map(|byte| segmenter.push(*byte));
        let frames = segments.filter_map(|segment| segment.frame::<ClassicFrame>(*identifier));
        frames.flat_map(|frame| carrier.encode(&frame, *identifier)).collect()
    }
}

impl<S: Write> Encoder<S> {
    /// Writes as many frames as the carrier takes at once, for at most [`WRITE_TIME`].
    fn write_frames(&mut self, frames: &[u8]) -> io::Result<()> {
        let start = Instant::now();
        while let Err(error) = self.port.write_all(frames) {
            if !is_full(&error) || start.elapsed() > WRITE_TIME {
                return Err(error);
            }
            sleep(RETRY);
        }
        Ok(())
    }
}

/// Does not wait for the bus: only for stops.
impl<S: Write> Write for Encoder<S> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        for frames in self.encode(bytes).chunks(self.carrier.write_len()) {
            self.write_frames(frames)?;
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.port.flush()
    }
}

/// Decodes the gripper's messages from CAN frames.
pub(crate) struct Decoder {
    carrier: Carrier,
    lines: LineDecoder,
    reassembler: Reassembler<MAX_FRAMES>,
    clock: StdClock,
}

impl Decoder {
    pub(crate) fn new(carrier: Carrier, identifiers: Identifiers) -> Self {
        Self {
            carrier,
            lines: LineDecoder::new(),
            reassembler: Reassembler::new(identifiers.controller().receive, HALF_MESSAGE_MS),
            clock: StdClock::new(),
        }
    }

    /// Appends the messages that these bytes complete.
    ///
    /// # Errors
    /// The interface has reported that its controller has left the bus.
    pub(crate) fn decode(&mut self, bytes: &[u8], received: &mut VecDeque<u8>) -> io::Result<()> {
        let Self { carrier, lines, reassembler, clock } = self;
        let mut receive = |frame: &ClassicFrame| {
            reassembler.receive(clock.now(), frame, |event| {
                if let Event::Frame(frame) = event {
                    received.extend(FrameEncoder::new(frame.id, frame.payload));
                }
            });
        };
        match carrier {
            Carrier::Slcan => {
                for &byte in bytes {
                    // Replies of the adapter are skipped: if it failed to open the channel, the gripper does not answer.
                    if let Some(Line::Frame(frame)) = lines.push(byte) {
                        receive(&frame);
                    }
                }
            }
            Carrier::SocketCan => {
                for bytes in bytes.as_chunks().0 {
                    frame_of(bytes)?.iter().for_each(&mut receive);
                }
            }
        }
        Ok(())
    }
}

/// A byte stream of gripper messages, carried in CAN frames.
pub(crate) struct CanStream<S: Read + Write> {
    encoder: Encoder<S>,
    decoder: Decoder,
    received: VecDeque<u8>,
}

impl<S: Read + Write> CanStream<S> {
    pub(crate) fn new(port: S, carrier: Carrier, identifiers: Identifiers) -> Self {
        Self {
            encoder: Encoder::new(port, carrier, identifiers),
            decoder: Decoder::new(carrier, identifiers),
            received: VecDeque::new(),
        }
    }
}

impl<S: Read + Write> CanStream<S> {
    /// Reads from the port, and appends the messages that the bytes complete. Returns the bytes.
    #[expect(clippy::disallowed_methods, reason = "the callers treat an interrupted read as no data")]
    fn receive<'a>(&mut self, chunk: &'a mut [u8; CHUNK_LEN]) -> io::Result<&'a [u8]> {
        let count = self.encoder.port.read(chunk)?;
        let bytes = chunk.get(..count).unwrap_or(&[]);
        self.decoder.decode(bytes, &mut self.received)?;
        Ok(bytes)
    }

    /// Waits for the echo of a frame, which an interface returns after the bus has taken it.
    fn await_echo(&mut self, frame: &[u8]) -> io::Result<()> {
        let start = Instant::now();
        while start.elapsed() <= WRITE_TIME {
            match self.receive(&mut [0; CHUNK_LEN]) {
                Ok(bytes) if bytes == frame => return Ok(()),
                Ok(_) => {}
                Err(error) if matches!(error.kind(), WouldBlock | TimedOut | Interrupted) => {}
                Err(error) => return Err(error),
            }
        }
        Err(io::Error::new(TimedOut, "the CAN bus does not take a frame"))
    }
}

impl<S: Read + Write> Read for CanStream<S> {
    #[expect(clippy::disallowed_methods, reason = "no signal interrupts a read from the queue")]
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.received.is_empty() {
            if self.receive(&mut [0; CHUNK_LEN])?.is_empty() {
                return Ok(0);
            }
            if self.received.is_empty() {
                return Err(WouldBlock.into());
            }
        }
        self.received.read(buffer)
    }
}

impl<S: Read + Write> Write for CanStream<S> {
    /// Without a bus, an interface keeps its frames and sends them later. Therefore it gets one at a time, and never a whole motion
    /// command.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        for frames in self.encoder.encode(bytes).chunks(self.encoder.carrier.write_len()) {
            self.encoder.write_frames(frames)?;
            if self.encoder.carrier == Carrier::SocketCan {
                self.await_echo(frames)?;
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.encoder.flush()
    }
}

impl<S: Read + Write> Drop for CanStream<S> {
    fn drop(&mut self) {
        // An error cannot be reported from here.
        let _ = self.encoder.port.write_all(self.encoder.carrier.closing());
    }
}

#[cfg(all(test, unix))]
mod tests {
    use std::fs::File;
    use std::os::fd::OwnedFd;
    use std::os::unix::net::UnixDatagram;
    use std::sync::Arc;
    use std::thread;

    use embedded_io::{Read as _, ReadReady as _, Write as _};
    use wsg_protocol::HomingDirection;
    use wsg_protocol::driver::blocking::Gripper;
    use wsg_protocol::driver::host::Stream;
    use wsg_protocol::driver::{Mm, MmPerS, OnBlock};
    use wsg_sim::{Config, PortKind, VirtualRig};

    use super::*;

    /// Connects a gripper, and other nodes, with the other end of an interface.
    fn serve(bus: &UnixDatagram, rig: &VirtualRig, is_open: &Arc<()>) {
        let mut segmenter = Segmenter::new();
        while Arc::strong_count(is_open) > 1 {
            let mut frame = [0; STRUCT_LEN];
            if let Ok(len) = bus.recv(&mut frame) {
                assert_eq!((len, &frame[..4]), (STRUCT_LEN, &0x100_u32.to_ne_bytes()[..]));
                rig.line().write_all(&frame[8..][..usize::from(frame[4])]).unwrap();
                bus.send(&frame).unwrap();
            }
            rig.pass(10);
            let (mut line, mut byte) = (rig.line(), [0]);
            while line.read_ready().unwrap() && line.read(&mut byte).unwrap() == 1 {
                let Some(segment) = segmenter.push(byte[0]) else { continue };
                // The same data from another node, in an extended frame, and in a remote frame.
                for identifier in [0x102_u32, 0x8000_0101, 0x4000_0101, 0x101] {
                    let mut frame = identifier.to_ne_bytes().to_vec();
                    frame.extend([segment.data().len() as u8, 0, 0, 0]);
                    frame.extend(segment.data());
                    frame.resize(STRUCT_LEN, 0);
                    // The driver may have ended.
                    let _ = bus.send(&frame);
                }
            }
        }
    }

    /// A pair of datagram sockets takes the place of a CAN interface.
    #[test]
    fn gripper_homes_and_moves_over_the_frames_of_socketcan() {
        let (interface, bus) = UnixDatagram::pair().unwrap();
        for socket in [&interface, &bus] {
            socket.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        }
        let (rig, is_open) = (VirtualRig::with_port(PortKind::Can, Config::default()), Arc::new(()));
        let (seen, open) = (rig.clone(), Arc::clone(&is_open));
        let bus = thread::spawn(move || serve(&bus, &seen, &open));
        let interface = File::from(OwnedFd::from(interface));
        let stream = CanStream::new(interface, Carrier::SocketCan, Identifiers::from_base(0x100).unwrap());
        let mut gripper = Gripper::new(Stream::new(stream), StdClock::new());
        gripper.connect().unwrap();
        gripper.home(HomingDirection::Default).unwrap();
        gripper.move_to(Mm(60.0), MmPerS(300.0), OnBlock::Stop).unwrap();
        assert_eq!(rig.state().width, 60.0);
        drop((gripper, is_open));
        bus.join().unwrap();
    }

    #[test]
    fn cut_bus_gets_one_frame_of_a_command() {
        let (interface, bus) = UnixDatagram::pair().unwrap();
        interface.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        bus.set_nonblocking(true).unwrap();
        let interface = File::from(OwnedFd::from(interface));
        let mut stream = CanStream::new(interface, Carrier::SocketCan, Identifiers::DEFAULT);
        let grip = wsg_protocol::Command::GripPart { width: 20.0, speed: 50.0 };
        let grip: Vec<u8> = FrameEncoder::new(grip.id().code(), grip).collect();
        assert_eq!(stream.write_all(&grip).unwrap_err().kind(), TimedOut);
        let mut frame = [0; STRUCT_LEN];
        assert!(bus.recv(&mut frame).is_ok() && bus.recv(&mut frame).is_err(), "one frame");
    }

    #[test]
    fn bus_off_is_an_error() {
        let mut decoder = Decoder::new(Carrier::SocketCan, Identifiers::DEFAULT);
        let mut frame = [0; STRUCT_LEN];
        frame[..4].copy_from_slice(&0x2000_0040_u32.to_ne_bytes());
        let error = decoder.decode(&frame, &mut VecDeque::new()).unwrap_err();
        assert!(error.to_string().contains("bus-off"), "{error}");
    }
}
