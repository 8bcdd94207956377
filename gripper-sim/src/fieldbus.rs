//! The register interface (fieldbus, chapters 5 and 6): one pair of images for all masters, and the controller between
//! the images and the device.
//!
//! The controller is that of the bridge. In the bridge, a session connects it to a gripper. Here its commands reach the
//! device immediately, and its view of the device is always current. `docs/decisions.md` records the decisions made
//! where the manual is silent.

use crate::device::Device;
use crate::port::{Completion, PortId, Request};
use crate::time::Time;
use bus_modbus::{Bits, Exception, Identification, MAX_PDU_LEN, Words};
use wsg_fieldbus::{
    CommandFlags, Controller, GripperFlags, Images, InputImage, MaskedFlags, OutputImage, SilenceReaction,
};
use wsg_protocol::session::{Event, Known};
use wsg_protocol::{CommandId, Reply, Status, Value};

/// Identification of the gripper (FC 43/14).
const IDENTIFICATION: Identification = Identification {
    vendor_name: "wsg-sim",
    product_code: "WSG",
    revision: concat!("V", env!("CARGO_PKG_VERSION")),
    regular: None,
};

/// The data exchange of the register interface with its masters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Exchange {
    /// How the exchange stands.
    pub state: ExchangeState,
    /// The master that wrote the outputs last, while it is connected.
    pub master: Option<PortId>,
    /// Number of output images received, repeated ones included.
    pub outputs: u32,
    /// Number of expired watchdogs: the time-out of Modbus masters, and that of a PROFIBUS master.
    pub timeouts: u32,
}

/// How data exchange with the masters stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ExchangeState {
    /// No master has written since power-up.
    #[default]
    Waiting,
    /// A master exchanges data.
    DataExchange,
    /// The watchdog of the last master has expired.
    WatchdogExpired,
    /// The last master has stopped or disconnected.
    Left,
}

/// The register interface of the gripper.
#[derive(Clone, Debug)]
pub(crate) struct Fieldbus {
    images: Images,
    controller: Controller,
    /// The master that wrote the output image last, while it is connected.
    writer: Option<PortId>,
    /// Whether anything has been written. Until then the controller stays idle.
    in_use: bool,
    /// The outputs that any master wrote last.
    written: OutputImage,
    /// The master with cyclic data exchange, and its outputs.
    cyclic: Option<(PortId, OutputImage)>,
    /// Whether FASTSTOP is set in the image that a Modbus master wrote last.
    modbus_fast_stop: bool,
    /// Time of the last Modbus request since a Modbus master has written.
    last_request: Option<Time>,
    masked: MaskedFlags,
    exchange: Exchange,
    /// The time of the controller's last Stop, and the speed in mm/s that it ended.
    stopped: Option<(Time, f64)>,
    /// Whether the next write of a Modbus master is the first after a silence.
    is_new: bool,
}

impl Fieldbus {
    pub(crate) fn new(device: &Device) -> Self {
        let mut controller = Controller::new();
        // No line connects the two, so the session is always connected.
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
            last_request: None,
            masked: MaskedFlags::NONE,
            exchange: Exchange::default(),
            stopped: None,
            is_new: false,
        }
    }

    /// Answers a request PDU of this client and applies its writes. The resulting commands are executed by the next
    /// [`follow`](Self::follow). Returns the length of the response.
    pub(crate) fn serve(
        &mut self,
        device: &Device,
        sender: Request,
        request: &[u8],
        response: &mut [u8; MAX_PDU_LEN],
    ) -> usize {
        self.images.set_input(&self.input(device));
        let len = bus_modbus::serve(request, &mut Registers(&mut self.images), response);
        let written = self.images.take_written();
        if self.last_request.is_some() || written.is_some() {
            self.last_request = Some(sender.now);
        }
        if let Some(image) = written {
            self.exchange.outputs = self.exchange.outputs.saturating_add(1);
            let is_first = core::mem::take(&mut self.is_new);
            self.modbus_fast_stop = image.flags.contains(CommandFlags::FASTSTOP);
            self.write(device, sender.port, &image, is_first);
        }
        len
    }

    /// Counts an expired watchdog of a master.
    pub(crate) const fn note_timeout(&mut self) {
        self.exchange.state = ExchangeState::WatchdogExpired;
        self.exchange.timeouts = self.exchange.timeouts.saturating_add(1);
    }

    /// Returns how data exchange with the masters stands.
    pub(crate) const fn exchange_state(&self) -> Exchange {
        Exchange { master: self.writer, ..self.exchange }
    }

    /// Returns the current inputs.
    pub(crate) fn input(&self, device: &Device) -> InputImage {
        self.controller.input(&known(device))
    }

    /// Returns the outputs that a master wrote last, or zeros after [`end_outputs`](Self::end_outputs).
    pub(crate) const fn written(&self) -> &OutputImage {
        &self.written
    }

    /// Returns the master that wrote the output image last, while it is connected.
    pub(crate) const fn writer(&self) -> Option<PortId> {
        self.writer
    }

    /// Sets OF from a script on the gripper.
    pub(crate) const fn set_user_outputs(&mut self, flags: u8) {
        self.controller.set_user_outputs(flags);
    }

    /// Takes the outputs of a master with cyclic data exchange. Only changes take effect: a repeated image must not
    /// undo a write of another client, or repeat it as an edge. The resulting commands are executed by the next
    /// [`follow`](Self::follow).
    pub(crate) fn exchange(&mut self, device: &Device, client: PortId, image: &OutputImage, is_first: bool) {
        self.exchange.outputs = self.exchange.outputs.saturating_add(1);
        let before = self.cyclic.replace((client, *image));
        if is_first || before != Some((client, *image)) {
            self.write(device, client, image, is_first);
        }
    }

    /// Takes an image written as a whole by this client. Flags set in its first image take effect only after they have
    /// been 0, except FASTSTOP, which takes effect while any client asserts it.
    fn write(&mut self, device: &Device, client: PortId, image: &OutputImage, is_first: bool) {
        self.written = *image;
        self.masked.see(image.flags, is_first);
        let cyclic = self.cyclic.map_or(CommandFlags::empty(), |(_, image)| image.flags);
        let mut flags = self.masked.counting(image.flags) | cyclic.intersection(CommandFlags::FASTSTOP);
        flags.set(CommandFlags::FASTSTOP, flags.contains(CommandFlags::FASTSTOP) || self.modbus_fast_stop);
        let counting = OutputImage { flags, ..*image };
        self.controller.set_output(&counting, &known(device));
        self.writer = Some(client);
        self.exchange.state = ExchangeState::DataExchange;
        self.in_use = true;
    }

    /// Reports that a client has disconnected, stopped or fallen silent. If it was the active master, a running motion
    /// ends as `reaction` specifies. A jog ends in any case, because its button is no longer held. The image stays.
    pub(crate) fn leave(&mut self, device: &Device, client: PortId, reaction: SilenceReaction) {
        if self.writer == Some(client) {
            self.writer = None;
            self.exchange.state = ExchangeState::Left;
            // FASTSTOP of the client stays set until the next master writes.
            self.modbus_fast_stop = false;
            self.controller.silence(reaction, &known(device));
        }
    }

    /// Reports that the master of a bus with cyclic data exchange has left, has stopped, or has marked its outputs as
    /// bad. Its outputs become zeros, as the bus specifies; otherwise the same as [`leave`](Self::leave).
    pub(crate) fn end_outputs(&mut self, device: &Device, client: PortId, reaction: SilenceReaction) {
        if self.writer == Some(client) {
            self.written = OutputImage::ZERO;
        }
        self.cyclic = self.cyclic.filter(|(cyclic, _)| *cyclic != client);
        self.leave(device, client, reaction);
    }

    /// Returns when the time-out of the Modbus masters expires.
    pub(crate) fn next_due(&self, device: &Device) -> Option<Time> {
        let timeout_ms = device.config().bus_timeout_ms;
        self.last_request.filter(|_| timeout_ms > 0).map(|at| at.plus_millis(timeout_ms.into()))
    }

    /// Handles the expired time-out of the Modbus masters. Returns whether it has expired.
    pub(crate) fn expire(&mut self, device: &Device, now: Time) -> bool {
        let is_due = self.next_due(device).is_some_and(|due| due <= now);
        if is_due {
            self.is_new = true;
            self.modbus_fast_stop = false;
            self.last_request = None;
            self.note_timeout();
            // A master with cyclic data exchange that has taken over stays in control.
            if self.cyclic.is_none_or(|(cyclic, _)| self.writer != Some(cyclic)) {
                self.writer = None;
                self.controller.silence(device.config().bus_reaction, &known(device));
            }
        }
        is_due
    }

    /// Passes the second answer to a command to the controller.
    pub(crate) fn complete(&mut self, device: &Device, done: Completion) {
        let reply = Reply::status_only(done.id, done.status);
        self.controller.handle(&Event::Answered(reply), &known(device));
    }

    /// Updates the controller's view of the device and executes its commands. Returns whether there were any, which may
    /// have ended a motion.
    pub(crate) fn follow(&mut self, device: &mut Device, now: Time) -> bool {
        if !self.in_use {
            return false;
        }
        let (flags, state) = (device.flags(), device.motion().state());
        let known_now = known(device);
        self.controller.handle(&Event::Reported(Value::GetSystemState(flags)), &known_now);
        self.controller.handle(&Event::Reported(Value::GetGripperState(state)), &known_now);
        let mut has_executed = false;
        while let Some(command) = self.controller.poll_command() {
            has_executed = true;
            let id = command.id();
            if id == CommandId::Stop {
                self.stopped = Some((now, device.motion().axis().speed()));
            }
            let reply = device.execute(Request { port: PortId::FIELDBUS, now }, &command);
            let status = reply.status();
            // The only value that the controller takes from an answer; all others are reported.
            let answer = match reply.value() {
                Some(Value::GetSoftLimits(limits)) => Reply::success(Value::GetSoftLimits(limits)),
                _ => Reply::status_only(id, status),
            };
            device.note_result(id.kind(), status);
            if id == CommandId::PrePosition && status == Status::CmdPending {
                self.follow_dial(device, now);
            }
            let event = match status {
                Status::CmdPending => Event::Pending(id),
                _ => Event::Answered(answer),
            };
            self.controller.handle(&event, &known(device));
        }
        has_executed
    }

    /// Lets the fingers continue at their speed if a jog was stopped just now in order to take over the values of the
    /// PLC's dial (fieldbus, 6.7).
    fn follow_dial(&mut self, device: &mut Device, now: Time) {
        let jogs = self.input(device).state == GripperFlags::RELEASING;
        if let Some((_, speed)) = self.stopped.take().filter(|(at, _)| jogs && *at == now) {
            device.motion_mut().keep_speed(speed);
        }
    }
}

/// Returns everything that a session could know about the gripper at present.
fn known(device: &Device) -> Known {
    Known {
        info: Some(device.info()),
        limits: Some(*device.limits()),
        flags: Some(device.flags()),
        state: Some(device.motion().state()),
        width: Some(device.reported_width()),
        speed: Some(device.motion().axis().speed() as f32),
        force: Some(device.reported_force()),
        // Unknown, so that the controller sets it before each motion that has one.
        force_limit: None,
    }
}

/// The images as seen by a server.
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
