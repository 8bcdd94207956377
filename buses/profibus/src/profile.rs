//! Fixed properties of a slave, and its address.

/// Maximum length in bytes of the outputs, the inputs, and the whole diagnosis (DP-V0).
pub const MAX_DATA_LEN: usize = 244;

/// Length in bytes of the standard part of a diagnosis.
pub const STANDARD_DIAGNOSIS_LEN: usize = 6;

/// Address of a slave before one has been assigned.
pub const DEFAULT_ADDRESS: u8 = 126;

/// Highest address that can be assigned to a slave.
pub(crate) const MAX_ADDRESS: u8 = 125;

/// Fixed properties of a slave, also written to its GSD file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Profile {
    /// Ident_Number, which must match the master's parameters.
    pub ident: u16,
    /// Configuration identifiers, which Chk_Cfg must match exactly; see [`identifiers_fit`].
    pub config: &'static [u8],
    /// Sync_Mode_supp. In Sync mode, received outputs wait for the master's next Sync command,
    /// including outputs that stop something.
    pub sync: bool,
    /// Freeze_Mode_supp: a master can freeze the inputs.
    pub freeze: bool,
    /// Fail_Safe: Data_Exchange without data clears the outputs. Masters send it in the operating mode Clear.
    pub fail_safe: bool,
    /// Set_Slave_Add_supp: a master can change the address before it sends parameters.
    pub set_address: bool,
}

/// Address of a slave on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Address {
    /// Station address, 0 to 125, or [`DEFAULT_ADDRESS`].
    pub station: u8,
    /// No_Add_Chg: masters can no longer change the address.
    pub locked: bool,
}

impl Address {
    /// Creates an address that masters can change if [`Profile::set_address`] permits it.
    #[must_use]
    pub const fn new(station: u8) -> Self {
        Self { station, locked: false }
    }
}

/// Returns whether identifiers in the general format describe this number of output and input bytes. Intended for a
/// `const` assertion next to a [`Profile`]. Returns `false` for identifiers in the special format.
///
/// ```
/// // 8 bytes out and 12 bytes in, each consistent as a whole.
/// const CONFIG: [u8; 2] = [0xA7, 0x9B];
/// const _: () = assert!(bus_profibus::identifiers_fit(&CONFIG, 8, 12));
/// // 4 words in and out.
/// assert!(bus_profibus::identifiers_fit(&[0x73], 8, 8));
/// ```
#[must_use]
pub const fn identifiers_fit(config: &[u8], outputs: usize, inputs: usize) -> bool {
    const INPUT: u8 = 0x10;
    const OUTPUT: u8 = 0x20;
    const INPUT_AND_OUTPUT: u8 = 0x30;
    const WORDS: u8 = 1 << 6;
    const LENGTH: u8 = 0x0F;
    let (mut found_outputs, mut found_inputs) = (0usize, 0usize);
    let mut rest = config;
    while let [identifier, after @ ..] = rest {
        rest = after;
        let units = (*identifier & LENGTH) as usize;
        let bytes = units.saturating_add(1).saturating_mul(if *identifier & WORDS == 0 { 1 } else { 2 });
        if *identifier & INPUT_AND_OUTPUT == 0 {
            return false;
        }
        if *identifier & OUTPUT != 0 {
            found_outputs = found_outputs.saturating_add(bytes);
        }
        if *identifier & INPUT != 0 {
            found_inputs = found_inputs.saturating_add(bytes);
        }
    }
    found_outputs == outputs && found_inputs == inputs
}
