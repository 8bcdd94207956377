//! What can be made to go wrong, beside what commands and parts do.

use crate::finger::Jaw;

/// A fault that a test or an operator injects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The axis is jammed: the fingers move in neither direction.
    AxisBlocked,
    /// The hardware is above its critical temperature: SF_TEMP_FAULT and a FAST STOP.
    OverTemperature,
    /// The supply voltage is out of range: SF_POWER_FAULT and a FAST STOP.
    SupplyOutOfRange,
    /// The motor is at its thermal limit: SF_CURR_FAULT and a FAST STOP. By itself it comes there under much more than the
    /// nominal force, and recovers without it.
    MotorCurrent,
    /// The supply of this finger is shorted; an empty sensor port has nothing to short.
    FingerShortCircuit(Jaw),
    /// This finger does not answer. That is FF_COMM_FAULT, or FF_INIT_FAULT where its supply comes on meanwhile: after a short
    /// circuit. Only fingers of a known type communicate.
    FingerCommunication(Jaw),
}
