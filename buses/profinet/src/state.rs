//! State of a device towards its controller, and events for the application.

/// An event for the application.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A controller has connected and confirmed that the device is ready. Outputs follow.
    Connected,
    /// Outputs were received, possibly with the same values.
    Outputs,
    /// The controller has stopped or marked its outputs as bad. The outputs are now 0.
    Cleared,
    /// The connection to the controller has ended. The outputs are now 0.
    Left(Cause),
    /// Name, IP address or I&M data were set. Save [`stored`](crate::Device::stored), and update the IP stack.
    Stored,
    /// A tool searches for this device. Flash an LED for 3 s.
    Signal,
}

/// Reason for the end of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The controller has released the connection.
    Released,
    /// The controller has aborted the connection, or started another one with the same UUID.
    Aborted,
    /// No valid outputs within the controller's hold time, or the start-up has timed out, or the caller has disconnected.
    Silence,
    /// The controller did not confirm that the device is ready.
    NotConfirmed,
    /// The controller did not acknowledge an alarm.
    AlarmFailed,
    /// The device was reset by DCP.
    Reset,
}

impl Cause {
    /// Returns the RTA-ERR code to send to the controller, if any.
    pub(crate) const fn reason(self) -> Option<u8> {
        match self {
            Self::Released | Self::Aborted => None,
            // Consumer hold time, call without answer, alarm without answer, reset.
            Self::Silence => Some(5),
            Self::NotConfirmed => Some(14),
            Self::AlarmFailed => Some(8),
            Self::Reset => Some(20),
        }
    }
}

/// State of the connection to a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// No controller is connected.
    Unconnected,
    /// A controller has connected and writes parameters.
    Parameters,
    /// Parameters have ended, and the device reports that it is ready.
    Ready,
    /// The controller has confirmed; cyclic data is exchanged.
    Data,
}
