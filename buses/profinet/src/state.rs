//! What a device tells its application.

/// Something happened that concerns the application.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A controller has connected, and it has confirmed that the device is ready: outputs may come.
    Connected,
    /// Outputs came, as they are now.
    Outputs,
    /// The controller has stopped, or says that its outputs are bad: they are zeros now.
    Cleared,
    /// The connection to the controller has ended: outputs are zeros.
    Left(Cause),
    /// Name, address or I&M were set: keep [`stored`](crate::Device::stored), and give the IP stack the address.
    Stored,
    /// Somebody looks for the device: blink for 3 s.
    Signal,
}

/// Why a connection has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The controller has released it.
    Released,
    /// The controller has aborted it, or has begun another one under the same name.
    Aborted,
    /// No outputs came for as long as the controller had asked for, or it has not gone on with its start.
    Silence,
    /// The controller did not answer that the device is ready.
    NotConfirmed,
    /// The controller did not take an alarm.
    AlarmFailed,
    /// Somebody has reset the device.
    Reset,
}

impl Cause {
    /// What the controller is told (RTA-ERR), if it is told.
    pub(crate) const fn reason(self) -> Option<u8> {
        match self {
            Self::Released | Self::Aborted => None,
            // The consumer's hold time; the answer to a call; the answer to an alarm; a reset.
            Self::Silence => Some(5),
            Self::NotConfirmed => Some(14),
            Self::AlarmFailed => Some(8),
            Self::Reset => Some(20),
        }
    }
}

/// How far a controller has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// There is none.
    Unconnected,
    /// It has connected, and writes parameters.
    Parameters,
    /// It has ended that, and is told that the device is ready.
    Ready,
    /// It has confirmed that: data exchange.
    Data,
}
