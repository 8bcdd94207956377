//! Requests and their names, in any dialect.

use core::fmt::Debug;
use core::hash::Hash;

use crate::command::Kind;

/// The name of a command.
pub trait Name: Copy + PartialEq + Debug + Hash + 'static {
    /// Returns what the command is for.
    fn kind(self) -> Kind;

    /// Whether sending it a second time changes nothing.
    fn is_repeatable(self) -> bool;
}

/// A request, whole.
pub trait Message: Copy + PartialEq + Debug + 'static {
    /// The names of commands.
    type Name: Name;

    /// Stop.
    const STOP: Self;
    /// FAST STOP.
    const FAST_STOP: Self;

    /// Returns the command that it is.
    fn name(&self) -> Self::Name;

    /// Whether sending it a second time changes nothing.
    fn is_repeatable(&self) -> bool;
}
