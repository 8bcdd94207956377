//! The bus as a PLC side: requests in, output images out; the input image and the registers of the bridge in answers.

use super::BusPort;
use super::report::{FIRST_REPORT, Link, Subjects};
use super::settings::{FIRST_SETTING, Settings};
use bus_modbus::rtu::{self, Character, Event, Server};
use bus_modbus::{Bits, Device, Exception, Identification, Words};
use wsg_protocol::Instant;
use wsg_protocol::fieldbus::{Images, InputImage, OutputImage};

/// What the bridge calls itself (FC 43/14).
pub const IDENTIFICATION: Identification = Identification {
    vendor_name: "wsg-bridge",
    product_code: env!("CARGO_PKG_NAME"),
    revision: concat!("V", env!("CARGO_PKG_VERSION")),
    regular: None,
};

/// What a request did besides being answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Served {
    /// It wrote to the output image.
    pub(crate) image: Option<OutputImage>,
    /// It wrote to the settings.
    pub(crate) configured: bool,
}

/// What the line has brought.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Heard {
    /// A character, and the silence before it in microseconds.
    Character(Character, u32),
    /// No character for so long, in microseconds.
    Silence(u32),
}

/// The bus's side of a bridge.
#[derive(Clone, Debug, Hash)]
pub(crate) struct ModbusSide {
    server: Server,
    images: Images,
    /// When a request for this unit came last; none once that is too long ago.
    heard_at: Option<Instant>,
}

impl ModbusSide {
    pub(crate) const fn new(config: &super::BusConfig, settings: &Settings) -> Self {
        Self {
            server: Server::new(settings.server(), config.timing()),
            images: Images::new(settings.swap_bytes()),
            heard_at: None,
        }
    }

    pub(crate) const fn counters(&self) -> rtu::Counters {
        self.server.counters()
    }

    /// Whether a PLC is heard.
    pub(crate) const fn is_heard(&self) -> bool {
        self.heard_at.is_some()
    }

    /// Takes over settings.
    pub(crate) fn configure(&mut self, settings: &Settings) {
        self.server.configure(settings.server());
        self.images.set_swap_bytes(settings.swap_bytes());
    }

    /// What the line has brought; none when there is nothing to serve, which is nearly always.
    pub(crate) fn listen(&self, port: &mut impl BusPort) -> Option<Heard> {
        match port.receive() {
            Some((character, silence_us)) => Some(Heard::Character(character, silence_us)),
            None if self.server.is_idle() => None,
            None => Some(Heard::Silence(port.silence_us())),
        }
    }

    /// Takes what the line brought up to the next request, and answers it; none when nothing more has come.
    #[expect(clippy::too_many_arguments, reason = "what a request may show or change, each of another owner")]
    pub(crate) fn serve(
        &mut self,
        now: Instant,
        mut heard: Heard,
        port: &mut impl BusPort,
        gripper: &InputImage,
        moving: bool,
        subjects: &Subjects<'_>,
        settings: &mut Settings,
    ) -> Option<Served> {
        self.images.set_input(gripper);
        loop {
            let Self { server, images, .. } = self;
            let mut device =
                BridgeDevice { images, moving, subjects, settings: &mut *settings, configured: false };
            let event = match heard {
                Heard::Character(character, silence_us) => server.push(character, silence_us, &mut device),
                Heard::Silence(silence_us) => server.silence(silence_us, &mut device),
            };
            let configured = device.configured;
            match event {
                Some(Event::Answer(answer)) => port.send(answer),
                Some(Event::Served) => {}
                None if matches!(heard, Heard::Silence(_)) => return None,
                Some(Event::Passed | Event::Damaged(_)) | None => {
                    heard = self.listen(port)?;
                    continue;
                }
            }
            self.heard_at = Some(now);
            return Some(Served { image: self.images.take_written(), configured });
        }
    }

    /// Whether the PLC has been silent for so long, in milliseconds; says so once.
    pub(crate) fn has_fallen_silent(&mut self, now: Instant, timeout_ms: u32) -> bool {
        let silent =
            timeout_ms > 0 && self.heard_at.is_some_and(|heard_at| now.since(heard_at) >= timeout_ms);
        if silent {
            self.heard_at = None;
        }
        silent
    }
}

/// The bridge as a device, for one request.
struct BridgeDevice<'a> {
    images: &'a mut Images,
    moving: bool,
    subjects: &'a Subjects<'a>,
    settings: &'a mut Settings,
    configured: bool,
}

impl BridgeDevice<'_> {
    /// The input image is the gripper's: without one there is nothing to show.
    fn gripper_answers(&self) -> Result<(), Exception> {
        match self.subjects.link() {
            Link::Never => Err(Exception::GatewayPathUnavailable),
            Link::Silent => Err(Exception::GatewayTargetDeviceFailedToRespond),
            Link::Up => Ok(()),
        }
    }
}

impl Device for BridgeDevice<'_> {
    fn coil(&self, address: u16) -> Result<bool, Exception> {
        self.images.coil(address)
    }

    fn discrete_input(&self, address: u16) -> Result<bool, Exception> {
        let value = self.images.discrete_input(address)?;
        self.gripper_answers().map(|()| value)
    }

    fn holding_register(&self, address: u16) -> Result<u16, Exception> {
        match address.checked_sub(FIRST_SETTING) {
            None => self.images.holding_register(address),
            Some(index) => self.settings.register(index),
        }
    }

    fn input_register(&self, address: u16) -> Result<u16, Exception> {
        if let Some(index) = address.checked_sub(FIRST_REPORT) {
            return self.subjects.register(index);
        }
        let value = self.images.input_register(address)?;
        self.gripper_answers().map(|()| value)
    }

    fn write_coils(&mut self, first: u16, values: Bits<'_>) -> Result<(), Exception> {
        self.images.write_coils(first, values)
    }

    fn write_registers(&mut self, first: u16, values: Words<'_>) -> Result<(), Exception> {
        let Some(index) = first.checked_sub(FIRST_SETTING) else {
            return self.images.write_registers(first, values);
        };
        if self.moving {
            // What exists and what it takes is said before that it is not the time.
            self.settings.check(index, values)?;
            return Err(Exception::ServerDeviceBusy);
        }
        self.settings.write(index, values)?;
        self.configured = true;
        Ok(())
    }

    fn identification(&self) -> Identification {
        IDENTIFICATION
    }
}
