//! Exception codes (MODBUS application protocol specification V1.1b3, chapter 7).

/// Why a request was not carried out, as the second byte of an exception response says it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Exception {
    /// 01: the server does not know the function, or not in this state.
    IllegalFunction = 0x01,
    /// 02: a register or bit of the request does not exist, or one behind the last.
    IllegalDataAddress = 0x02,
    /// 03: a quantity, a byte count or a length that the request may not have, or a value that is refused.
    IllegalDataValue = 0x03,
    /// 04: the server failed at it.
    ServerDeviceFailure = 0x04,
    /// 06: not now; the same request may succeed later.
    ServerDeviceBusy = 0x06,
    /// 0A: a gateway has no path to its target, as when the target has never answered.
    GatewayPathUnavailable = 0x0A,
    /// 0B: a gateway's target does not respond, as when it has fallen silent.
    GatewayTargetDeviceFailedToRespond = 0x0B,
}

impl Exception {
    /// The byte that stands for it.
    ///
    /// ```
    /// use bus_modbus::Exception;
    ///
    /// assert_eq!(Exception::GatewayPathUnavailable.code(), 10);
    /// ```
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }
}

impl core::fmt::Display for Exception {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::IllegalFunction => "illegal function",
            Self::IllegalDataAddress => "illegal data address",
            Self::IllegalDataValue => "illegal data value",
            Self::ServerDeviceFailure => "server device failure",
            Self::ServerDeviceBusy => "server device busy",
            Self::GatewayPathUnavailable => "gateway path unavailable",
            Self::GatewayTargetDeviceFailedToRespond => "gateway target device failed to respond",
        })
    }
}

impl core::error::Error for Exception {}
