//! The Modbus master: `tokio-modbus` over TCP or a serial line. Every request is bounded, and repeated if unanswered.
//! Repetition is always safe, because writing the same image again raises no edge.

use anyhow::{Context as _, Result, anyhow};
use serial2_tokio::SerialPort;
use std::net::SocketAddr;
use std::time::{Duration, Instant};
use tokio::time::{sleep, timeout};
use tokio_modbus::client::{Context, rtu, tcp};
use tokio_modbus::prelude::{Reader, Slave, Writer};
use wsg_fieldbus::{InputImage, OutputImage};

/// Pause before a failed request is repeated.
const PAUSE: Duration = Duration::from_millis(200);
/// Maximum number of attempts.
const ATTEMPTS: u32 = 5;

/// Address of the gripper, or of the bridge in front of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Target {
    Tcp(SocketAddr),
    /// A serial line (8N1) and its rate in bit/s.
    Rtu {
        device: String,
        baud: u32,
    },
}

/// Statistics of the line.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Traffic {
    pub(crate) requests: u64,
    pub(crate) repeated: u64,
    pub(crate) slowest: Duration,
}

pub(crate) struct Master {
    target: Target,
    unit: u8,
    /// Time limit for an answer.
    patience: Duration,
    context: Option<Context>,
    traffic: Traffic,
}

enum Request<'a> {
    Read,
    Write(&'a [u16]),
}

impl Master {
    pub(crate) const fn new(target: Target, unit: u8, patience: Duration) -> Self {
        let traffic = Traffic { requests: 0, repeated: 0, slowest: Duration::ZERO };
        Self { target, unit, patience, context: None, traffic }
    }

    pub(crate) const fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// Reads the input image.
    pub(crate) async fn read(&mut self) -> Result<InputImage> {
        let registers = self.ask(&Request::Read).await?;
        let mut bytes = [0; InputImage::LEN];
        for (pair, register) in bytes.chunks_exact_mut(2).zip(registers) {
            pair.copy_from_slice(&register.to_be_bytes());
        }
        Ok(InputImage::from_bytes(bytes))
    }

    /// Writes the complete output image.
    pub(crate) async fn write(&mut self, image: &OutputImage) -> Result<()> {
        let bytes = image.to_bytes();
        let registers: Vec<u16> =
            bytes.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect();
        self.ask(&Request::Write(&registers)).await.map(|_| ())
    }

    async fn ask(&mut self, request: &Request<'_>) -> Result<Vec<u16>> {
        let mut attempt = 1;
        loop {
            self.traffic.requests += 1;
            let begin = Instant::now();
            match self.ask_once(request).await {
                Ok(registers) => {
                    self.traffic.slowest = self.traffic.slowest.max(begin.elapsed());
                    return Ok(registers);
                }
                Err(error) if attempt >= ATTEMPTS => {
                    return Err(error.context(format!("no answer to {ATTEMPTS} requests")));
                }
                Err(_) => {
                    // Reconnects, so that a late answer is not mistaken for the next one.
                    self.context = None;
                    sleep(PAUSE).await;
                    attempt += 1;
                    self.traffic.repeated += 1;
                }
            }
        }
    }

    async fn ask_once(&mut self, request: &Request<'_>) -> Result<Vec<u16>> {
        let context = match &mut self.context {
            Some(context) => context,
            none => none.insert(connect(&self.target, self.unit, self.patience).await?),
        };
        let answer = async {
            match request {
                Request::Read => context.read_input_registers(0, InputImage::LEN as u16 / 2).await,
                Request::Write(registers) => {
                    context.write_multiple_registers(0, registers).await.map(|done| done.map(|()| vec![]))
                }
            }
        };
        let answer = timeout(self.patience, answer).await.context("no answer in time")??;
        answer.map_err(|exception| anyhow!("exception: {exception}"))
    }
}

async fn connect(target: &Target, unit: u8, patience: Duration) -> Result<Context> {
    let slave = Slave(unit);
    match target {
        Target::Tcp(address) => timeout(patience, tcp::connect_slave(*address, slave))
            .await
            .with_context(|| format!("{address} did not accept the connection in time"))?
            .with_context(|| format!("{address} cannot be reached")),
        Target::Rtu { device, baud } => {
            // Opening with only a rate selects 8N1.
            let line =
                SerialPort::open(device, *baud).with_context(|| format!("{device} cannot be opened"))?;
            line.discard_buffers().with_context(|| format!("the buffers of {device} cannot be cleared"))?;
            Ok(rtu::attach_slave(line, slave))
        }
    }
}
