//! Faults that can be injected, independent of commands and parts.

use crate::finger::Jaw;

/// A fault that a test or an operator injects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The axis is jammed: the fingers move in neither direction.
    AxisBlocked,
    /// The hardware is above its critical temperature: SF_TEMP_FAULT. A motion and the force on a part end, and motion
    /// commands are refused until the temperature has fallen, without a FAST STOP (command set, appendix B, D14).
    OverTemperature,
    /// The supply voltage is out of range: SF_POWER_FAULT, with the effects of over-temperature (D15).
    SupplyOutOfRange,
    /// The motor is at its thermal limit: SF_CURR_FAULT and a FAST STOP. Without injection, the motor reaches the limit
    /// under much more than the nominal force and recovers without that load.
    MotorCurrent,
    /// The supply of this finger is shorted. An empty sensor port cannot be.
    FingerShortCircuit(Jaw),
    /// This finger does not answer. The result is FF_COMM_FAULT, or FF_INIT_FAULT if its supply comes on in the
    /// meantime, that is after a short circuit. Only fingers of a known type communicate.
    FingerCommunication(Jaw),
}
