//! How far a master has come with a slave, and what the application is told.

use crate::Address;

/// How far a master has come with a slave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// It waits for parameters, of whatever master.
    WaitPrm,
    /// It is a master's, and waits for its configuration.
    WaitCfg,
    /// Outputs and inputs are exchanged.
    DataExch,
}

/// What came from the master, for the application.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// [`Slave::outputs`](crate::Slave::outputs) are what the master wants, changed or not.
    Outputs,
    /// The master has cleared the outputs: they are 0. It does so again and again as long as it is in the operating mode Clear.
    Cleared,
    /// There is no data exchange any more, and the outputs are 0. Outputs that come later are those of a new one.
    Left(Cause),
    /// A master has changed the address: it is to be kept, and given to [`Slave::new`](crate::Slave::new) after the next start.
    Address(Address),
}

/// Why data exchange has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The master was silent for longer than the watchdog that it has asked for.
    Watchdog,
    /// The master has sent parameters again, right ones or wrong ones.
    Parameters,
    /// The master has sent another configuration.
    Configuration,
    /// The master has sent outputs of another length.
    OutputLength,
    /// The master has released the slave.
    Unlocked,
}
