//! Evaluation of Set_Prm.

use crate::Profile;

/// Bits of Station_status, the first byte.
const UNLOCK: u8 = 1 << 6;
const LOCK_AND_UNLOCK: u8 = 0xC0;
const SYNC: u8 = 1 << 5;
const FREEZE: u8 = 1 << 4;
const WATCHDOG: u8 = 1 << 3;
const RESERVED: u8 = 0b111;

/// Bit of DPV1_Status_1, which DP-V1 masters send to every slave. It repeats a property of the profile.
const DPV1_FAIL_SAFE: u8 = 1 << 6;

/// Unit of WD_Fact_1 times WD_Fact_2.
const WATCHDOG_UNIT_MS: u32 = 10;

/// Parameters from a master.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Parameters {
    pub(super) sync: bool,
    pub(super) freeze: bool,
    pub(super) watchdog_ms: Option<u32>,
    /// Min T_SDR in bit times; 0 leaves it unchanged.
    pub(super) min_tsdr_bits: u8,
    pub(super) group: u8,
}

/// Meaning of a Set_Prm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SetPrm {
    /// Locks the slave for this master.
    Lock(Parameters),
    /// Releases the slave.
    Unlock,
    /// Changes only min T_SDR.
    MinTsdr(u8),
    /// Rejected with Diag.Prm_Fault.
    Fault,
    /// Rejected with Diag.Not_Supported.
    NotSupported,
}

impl SetPrm {
    pub(super) fn of(data: &[u8], profile: &Profile) -> Self {
        let &[status, factor_1, factor_2, min_tsdr_bits, high, low, group, ref user @ ..] = data else {
            return Self::Fault;
        };
        if status & LOCK_AND_UNLOCK == 0 {
            return Self::MinTsdr(min_tsdr_bits);
        }
        if u16::from_be_bytes([high, low]) != profile.ident {
            return Self::Fault;
        }
        if status & UNLOCK != 0 {
            return Self::Unlock;
        }
        let (sync, freeze) = (status & SYNC != 0, status & FREEZE != 0);
        if status & RESERVED != 0 || sync && !profile.sync || freeze && !profile.freeze {
            return Self::NotSupported;
        }
        let watchdog_ms =
            u32::from(factor_1).saturating_mul(u32::from(factor_2)).saturating_mul(WATCHDOG_UNIT_MS);
        let is_watched = status & WATCHDOG != 0;
        if is_watched && watchdog_ms == 0 || !asks_for_nothing(user, profile) {
            return Self::Fault;
        }
        let watchdog_ms = is_watched.then_some(watchdog_ms);
        Self::Lock(Parameters { sync, freeze, watchdog_ms, min_tsdr_bits, group })
    }
}

/// Returns whether the user parameters are empty, or the three DP-V1 bytes without any request beyond DP-V0.
fn asks_for_nothing(user: &[u8], profile: &Profile) -> bool {
    let known = if profile.fail_safe { DPV1_FAIL_SAFE } else { 0 };
    match user {
        [] => true,
        &[status_1, 0, 0] => status_1 & !known == 0,
        _ => false,
    }
}
