//! The contract of a client of any protocol: its received bytes, its queued frames, and its due times.

use crate::config::Config;
use crate::device::Device;
use crate::fieldbus::Fieldbus;
use crate::port::{Completion, FrameBuffer, PortCounters, PortId};
use crate::time::Time;
use crate::updates::Readings;
use wsg_fieldbus::SilenceReaction;

/// A client of the gripper. A client without a function keeps its default.
pub(crate) trait Client {
    fn id(&self) -> PortId;

    fn counters(&self) -> PortCounters;

    /// Takes over the settings of a running gripper that the client cannot change itself, and keeps the subscriptions.
    fn reconfigure(&mut self, _before: &Config, _config: &Config) {}

    /// Returns whether the end of the connection is an error.
    fn is_missed(&self) -> bool {
        // Many masters reconnect for each request; a bus has a watchdog.
        false
    }

    /// Returns the reaction to the client's end for a motion that it started by the register interface.
    fn reaction_to_its_end(&self, _config: &Config) -> SilenceReaction {
        // Many masters reconnect for each request.
        SilenceReaction::Hold
    }

    /// Returns whether the client's byte stream has lost synchronization for good.
    fn is_lost(&self) -> bool {
        false
    }

    /// Takes bytes up to the first request, or some of them, and executes the request. Returns the number of bytes
    /// taken and whether anything happened.
    fn receive(
        &mut self,
        device: &mut Device,
        fieldbus: &mut Fieldbus,
        now: Time,
        bytes: &[u8],
    ) -> (usize, bool);

    /// Marks the end of the available bytes and executes a request that the end of a datagram completes. Returns
    /// whether anything happened.
    fn pause(&mut self, _device: &mut Device, _now: Time) -> bool {
        false
    }

    /// Processes an expired time-out of an incomplete frame or of a master, and returns whether anything happened. Call
    /// until it returns `false`. Also ends the subscriptions of a client that has been silent for too long.
    fn expire(&mut self, _device: &mut Device, _fieldbus: &mut Fieldbus, _now: Time) -> bool {
        false
    }

    /// Ends all subscriptions, because another sender uses the line now.
    fn end_updates(&mut self) {}

    fn next_due(&self, _now: Time) -> Option<Time> {
        None
    }

    /// Sends the second answer to a command.
    fn complete(&mut self, _done: Completion) {}

    /// Sends an answer of a script; script commands belong to the binary protocol.
    fn answer_script(&mut self, _id: u8, _payload: &[u8]) {}

    /// Sends the updates that are due.
    fn publish(&mut self, _now: Time, _readings: &Readings) {}

    fn has_frame(&self) -> bool;

    /// Returns the next complete frame or line and removes it from the queue.
    fn next_frame<'a>(&mut self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]>;
}
