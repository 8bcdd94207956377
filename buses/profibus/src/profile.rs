//! What is fixed about a slave, and its address.

/// The most bytes of outputs, of inputs, and of a whole diagnosis (DP-V0).
pub const MAX_DATA_LEN: usize = 244;

/// Bytes of a diagnosis before the device's own part.
pub const STANDARD_DIAGNOSIS_LEN: usize = 6;

/// The address of a slave that was not given one yet.
pub const DEFAULT_ADDRESS: u8 = 126;

/// The greatest address that a slave may be given.
pub(crate) const MAX_ADDRESS: u8 = 125;

/// What is fixed about a slave; its GSD file says the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Profile {
    /// Ident_Number, which the master's parameters have to name.
    pub ident: u16,
    /// The configuration identifiers, which Chk_Cfg has to bring as they are: see [`identifiers_fit`].
    pub config: &'static [u8],
    /// Sync_Mode_supp. While a master has outputs synchronised, those that it sends wait for its next Sync: also one that
    /// stops something.
    pub sync: bool,
    /// Freeze_Mode_supp.
    pub freeze: bool,
    /// Fail_Safe: Data_Exchange without data clears the outputs. A master in the operating mode Clear sends such.
    pub fail_safe: bool,
    /// Set_Slave_Add_supp: a master may change the address as long as it has not sent parameters.
    pub set_address: bool,
}

/// Where a slave is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Address {
    /// The address, 0 to 125, or [`DEFAULT_ADDRESS`].
    pub station: u8,
    /// No_Add_Chg: no master may change it any more.
    pub locked: bool,
}

impl Address {
    /// An address that a master may change, if the slave lets it.
    #[must_use]
    pub const fn new(station: u8) -> Self {
        Self { station, locked: false }
    }
}

/// Whether identifiers in the general format describe so many bytes of outputs and of inputs, for a `const` assertion beside
/// a [`Profile`]. Identifiers in the special format are not understood: `false`.
///
/// ```
/// // 8 bytes out, 12 bytes in, each consistent as a whole.
/// const CONFIG: [u8; 2] = [0xA7, 0x9B];
/// const _: () = assert!(bus_profibus::identifiers_fit(&CONFIG, 8, 12));
/// // 4 words, in and out.
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
