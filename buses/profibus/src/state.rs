//! State of a slave towards its master, and events for the application.

use crate::Address;

/// State of a slave towards its master.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Waits for parameters from any master.
    WaitPrm,
    /// Locked by a master, and waits for its configuration.
    WaitCfg,
    /// Exchanges outputs and inputs with its master.
    DataExch,
}

/// An event from the master for the application.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The master has set [`Slave::outputs`](crate::Slave::outputs), possibly to the same values.
    Outputs,
    /// The master has set all outputs to 0. It repeats this cyclically in the operating mode Clear.
    Cleared,
    /// Data exchange has ended, and all outputs are 0. Later outputs belong to a new data exchange.
    Left(Cause),
    /// A master has changed the address. Store it, and pass it to
    /// [`Slave::new`](crate::Slave::new) after the next start.
    Address(Address),
}

/// Reason for the end of data exchange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The master's watchdog time has expired without a request from it.
    Watchdog,
    /// The master has sent parameters again, valid or not.
    Parameters,
    /// The master has sent a configuration that does not match.
    Configuration,
    /// The master has sent outputs of a wrong length.
    OutputLength,
    /// The master has unlocked the slave.
    Unlocked,
}
