//! State of a device towards the owner of its outputs, and events for the application.

/// An event for the application.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// An exclusive owner has opened its connection. The outputs are 0 until [`Outputs`](Self::Outputs).
    Connected,
    /// The owner has changed from run to idle mode. The outputs are 0 until [`Outputs`](Self::Outputs).
    Idle,
    /// New outputs of an owner in run mode, possibly with the same values. The first after [`Connected`](Self::Connected) or
    /// [`Idle`](Self::Idle) must not cause an edge.
    Outputs,
    /// The connection to the owner has ended. The outputs are now 0.
    Left(Cause),
    /// A tool requests a reset. Restart the device after the pending answers are sent.
    Reset(Reset),
    /// Close the TCP connection of this number after its pending answers are sent. The device has ended its session.
    Close(u32),
}

/// Reason for the end of the owner's connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The owner has closed the connection (Forward_Close).
    Closed,
    /// No valid packet within the owner's time-out.
    Silence,
}

/// Kind of a requested reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reset {
    /// Type 0: as if the power was cycled.
    Restart,
    /// Type 1: back to the factory settings, then as type 0.
    Factory,
}

/// State of the owner's connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// No owner is connected.
    Unowned,
    /// An owner is connected and has not sent data yet.
    Waiting,
    /// The owner is in idle mode.
    Idle,
    /// The owner is in run mode.
    Run,
}
