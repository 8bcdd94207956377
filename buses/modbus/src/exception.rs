//! Exception codes (MODBUS application protocol specification V1.1b3, chapter 7).

/// Reason for rejecting a request: the second byte of an exception response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Exception {
    /// 01: the server does not support the function, or not in its present state.
    IllegalFunction = 0x01,
    /// 02: a register or bit in the requested range does not exist.
    IllegalDataAddress = 0x02,
    /// 03: an invalid quantity, byte count or length, or a rejected value.
    IllegalDataValue = 0x03,
    /// 04: the server failed while executing the request.
    ServerDeviceFailure = 0x04,
    /// 06: the server is busy; the same request may succeed later.
    ServerDeviceBusy = 0x06,
    /// 0A: a gateway has no path to its target, for example because the target has never responded.
    GatewayPathUnavailable = 0x0A,
    /// 0B: a gateway's target has stopped responding.
    GatewayTargetDeviceFailedToRespond = 0x0B,
}

impl Exception {
    /// Returns the exception code as sent in the response.
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
