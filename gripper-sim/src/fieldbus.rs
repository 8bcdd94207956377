//! The register interface (fieldbus, chapters 5 and 6): one pair of images for all masters, and the controller between
//! them and the device.
//!
//! The controller is the one of the bridge. There a session stands between it and a gripper; here its commands reach the
//! device at once, and what it is told is true at that moment. What was decided where the manual is silent stands in
//! `docs/decisions.md`.

use crate::device::Device;
use crate::port::{Completion, PortId, Request};
use crate::time::Time;
use bus_modbus::{Bits, Exception, Identification, MAX_PDU_LEN, Words};
use wsg_fieldbus::{CommandFlags, Controller, Images, InputImage, MaskedFlags, OutputImage, SilenceReaction};
use wsg_protocol::session::{Event, Known};
use wsg_protocol::{Reply, Status, Value};

/// What the gripper calls itself (FC 43/14).
const IDENTIFICATION: Identification = Identification {
    vendor_name: "wsg-sim",
    product_code: "WSG",
    revision: concat!("V", env!("CARGO_PKG_VERSION")),
    regular: None,
};

/// The register interface of the gripper.
#[derive(Clone, Debug)]
pub(crate) struct Fieldbus {
    images: Images,
    controller: Controller,
    /// Who wrote to the output image last, as long as it is there.
    writer: Option<PortId>,
    /// Whether anything has been written: before, the controller waits for nothing.
    in_use: bool,
    /// The last outputs, of whichever master.
    written: OutputImage,
    /// The master with cyclic data that exchanges, and its outputs.
    cyclic: Option<(PortId, OutputImage)>,
    /// A Modbus master asserts FASTSTOP in the image that it wrote last.
    modbus_fast_stop: bool,
    /// When a Modbus master asked for something last, since one has written.
    heard: Option<Time>,
    masked: MaskedFlags,
    /// What a Modbus master writes next is the first since they fell silent.
    is_new: bool,
}

impl Fieldbus {
    pub(crate) fn new(device: &Device) -> Self {
        let mut controller = Controller::new();
        // There is no line between the two that could be cut.
        controller.handle(&Event::Connected, &known(device));
        let images = Images::new(device.config().modbus_swap_bytes);
        Self {
            images,
            controller,
            writer: None,
            in_use: false,
            written: OutputImage::ZERO,
            cyclic: None,
            modbus_fast_stop: false,
            heard: None,
            masked: MaskedFlags::NONE,
            is_new: false,
        }
    }

    /// Answers a request PDU of this client, and lets what it writes take effect. What it leads to is due at the next
    /// [`follow`](Self::follow). Returns the length of the response.
    pub(crate) fn serve(
        &mut self,
        device: &Device,
        asked: Request,
        request: &[u8],
        response: &mut [u8; MAX_PDU_LEN],
    ) -> usize {
        self.images.set_input(&self.input(device));
        let len = bus_modbus::serve(request, &mut Registers(&mut self.images), response);
        let written = self.images.take_written();
        if self.heard.is_some() || written.is_some() {
            self.heard = Some(asked.now);
        }
        if let Some(image) = written {
            let is_first = core::mem::take(&mut self.is_new);
            self.modbus_fast_stop = image.flags.contains(CommandFlags::FASTSTOP);
            self.write(device, asked.port, &image, is_first);
        }
        len
    }

    /// What a master reads now.
    pub(crate) fn input(&self, device: &Device) -> InputImage {
        self.controller.input(&known(device))
    }

    /// Returns the outputs: those that a master wrote last, and zeros after [`end_outputs`](Self::end_outputs).
    pub(crate) const fn written(&self) -> &OutputImage {
        &self.written
    }

    /// Sets OF, as a script on the gripper does.
    pub(crate) const fn set_user_outputs(&mut self, flags: u8) {
        self.controller.set_user_outputs(flags);
    }

    /// Takes the outputs of a master with cyclic data. Only a change counts: the same image again must not undo, or repeat as
    /// an edge, what another client wrote in between. What it leads to is due at the next [`follow`](Self::follow).
    pub(crate) fn exchange(&mut self, device: &Device, client: PortId, image: &OutputImage, is_first: bool) {
        let before = self.cyclic.replace((client, *image));
        if is_first || before != Some((client, *image)) {
            self.write(device, client, image, is_first);
        }
    }

    /// Takes an image that this client wrote as a whole. Flags in its first one count after they were 0, but FASTSTOP, which
    /// counts as long as any client asserts it.
    fn write(&mut self, device: &Device, client: PortId, image: &OutputImage, is_first: bool) {
        self.written = *image;
        self.masked.see(image.flags, is_first);
        let cyclic = self.cyclic.map_or(CommandFlags::empty(), |(_, image)| image.flags);
        let mut flags = self.masked.counting(image.flags) | cyclic.intersection(CommandFlags::FASTSTOP);
        flags.set(CommandFlags::FASTSTOP, flags.contains(CommandFlags::FASTSTOP) || self.modbus_fast_stop);
        let counting = OutputImage { flags, ..*image };
        self.controller.set_output(&counting, &known(device));
        self.writer = Some(client);
        self.in_use = true;
    }

    /// A client is gone, has stopped, or is silent. If it was the one that commands, what runs ends as `reaction` says, and a
    /// jog in any case: nobody holds its button any more. The image stays.
    pub(crate) fn leave(&mut self, device: &Device, client: PortId, reaction: SilenceReaction) {
        if self.writer == Some(client) {
            self.writer = None;
            // Its FASTSTOP stays until the next master writes.
            self.modbus_fast_stop = false;
            self.controller.silence(reaction, &known(device));
        }
    }

    /// The master of a bus with cyclic data has left, has stopped, or says that its outputs are bad. Its outputs are zeros now, as
    /// the bus itself has it; apart from that it is [`leave`](Self::leave).
    pub(crate) fn end_outputs(&mut self, device: &Device, client: PortId, reaction: SilenceReaction) {
        if self.writer == Some(client) {
            self.written = OutputImage::ZERO;
        }
        self.cyclic = self.cyclic.filter(|(cyclic, _)| *cyclic != client);
        self.leave(device, client, reaction);
    }

    /// When the Modbus masters have been silent for too long.
    pub(crate) fn next_due(&self, device: &Device) -> Option<Time> {
        let timeout_ms = device.config().bus_timeout_ms;
        self.heard.filter(|_| timeout_ms > 0).map(|heard| heard.plus_millis(timeout_ms.into()))
    }

    /// Does what is to be done when the Modbus masters have been silent for too long; whether they have.
    pub(crate) fn expire(&mut self, device: &Device, now: Time) -> bool {
        let is_due = self.next_due(device).is_some_and(|due| due <= now);
        if is_due {
            self.is_new = true;
            self.modbus_fast_stop = false;
            self.heard = None;
            // A master with cyclic data that has taken over commands on.
            if self.cyclic.is_none_or(|(cyclic, _)| self.writer != Some(cyclic)) {
                self.writer = None;
                self.controller.silence(device.config().bus_reaction, &known(device));
            }
        }
        is_due
    }

    /// The second answer to a command.
    pub(crate) fn complete(&mut self, device: &Device, done: Completion) {
        let reply = Reply::status_only(done.id, done.status);
        self.controller.handle(&Event::Answered(reply), &known(device));
    }

    /// Tells the controller how things stand, and carries out what it asks for; whether it asked for anything, which
    /// may have ended a motion.
    pub(crate) fn follow(&mut self, device: &mut Device, now: Time) -> bool {
        if !self.in_use {
            return false;
        }
        let (flags, state) = (device.flags(), device.state());
        let known_now = known(device);
        self.controller.handle(&Event::Reported(Value::GetSystemState(flags)), &known_now);
        self.controller.handle(&Event::Reported(Value::GetGripperState(state)), &known_now);
        let mut asked = false;
        while let Some(command) = self.controller.poll_command() {
            asked = true;
            let id = command.id();
            let reply = device.execute(Request { port: PortId::FIELDBUS, now }, &command);
            let status = reply.status();
            // The one value that the controller takes from an answer: all others are reported.
            let answer = match reply.value() {
                Some(Value::GetSoftLimits(limits)) => Reply::success(Value::GetSoftLimits(limits)),
                _ => Reply::status_only(id, status),
            };
            device.note_result(id.kind(), status);
            let event = match status {
                Status::CmdPending => Event::Pending(id),
                _ => Event::Answered(answer),
            };
            self.controller.handle(&event, &known(device));
        }
        asked
    }
}

/// All that a session could know of the gripper, at this moment.
fn known(device: &Device) -> Known {
    Known {
        info: Some(device.info()),
        limits: Some(*device.limits()),
        flags: Some(device.flags()),
        state: Some(device.state()),
        width: Some(device.reported_width()),
        speed: Some(device.speed() as f32),
        force: Some(device.reported_force()),
        // So it is set ahead of each motion that has one.
        force_limit: None,
    }
}

/// The images as a server sees them.
struct Registers<'a>(&'a mut Images);

impl bus_modbus::Device for Registers<'_> {
    fn coil(&self, address: u16) -> Result<bool, Exception> {
        self.0.coil(address)
    }

    fn discrete_input(&self, address: u16) -> Result<bool, Exception> {
        self.0.discrete_input(address)
    }

    fn holding_register(&self, address: u16) -> Result<u16, Exception> {
        self.0.holding_register(address)
    }

    fn input_register(&self, address: u16) -> Result<u16, Exception> {
        self.0.input_register(address)
    }

    fn write_coils(&mut self, first: u16, values: Bits<'_>) -> Result<(), Exception> {
        self.0.write_coils(first, values)
    }

    fn write_registers(&mut self, first: u16, values: Words<'_>) -> Result<(), Exception> {
        self.0.write_registers(first, values)
    }

    fn identification(&self) -> Identification {
        IDENTIFICATION
    }
}
