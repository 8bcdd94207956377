//! Device identification of a server (specification, 6.21).

/// Number of objects in the basic category, which are mandatory.
const BASIC_LEN: usize = 3;

/// Conformity levels: stream and individual access to the basic or the regular objects.
const CONFORMITY_BASIC: u8 = 0x81;
const CONFORMITY_REGULAR: u8 = 0x82;

/// Device identification in printable ASCII. Keep the total below 240 bytes, or clients need several requests.
///
/// ```
/// use bus_modbus::Identification;
///
/// let identification = Identification {
///     vendor_name: "a vendor",
///     product_code: "AB-1",
///     revision: "V1.0",
///     regular: None,
/// };
/// assert!(identification.regular.is_none());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Identification {
    /// Object 0: VendorName.
    pub vendor_name: &'static str,
    /// Object 1: ProductCode.
    pub product_code: &'static str,
    /// Object 2: MajorMinorRevision.
    pub revision: &'static str,
    /// Objects 3 to 6 (optional): VendorUrl, ProductName, ModelName, UserApplicationName.
    pub regular: Option<[&'static str; 4]>,
}

impl Identification {
    /// Returns the object with this number, or `None` if it does not exist.
    pub(crate) fn object(&self, id: u8) -> Option<&'static str> {
        match id {
            0 => Some(self.vendor_name),
            1 => Some(self.product_code),
            2 => Some(self.revision),
            _ => self.regular?.get(usize::from(id).checked_sub(BASIC_LEN)?).copied(),
        }
    }

    /// Returns the conformity level for the objects present.
    pub(crate) const fn conformity(&self) -> u8 {
        if self.regular.is_some() { CONFORMITY_REGULAR } else { CONFORMITY_BASIC }
    }
}
