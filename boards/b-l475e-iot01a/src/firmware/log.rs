//! The log's destination and time stamps. Without the feature `defmt` there is no log.

#[cfg(all(feature = "log-rtt", feature = "log-semihosting"))]
compile_error!("log-rtt and log-semihosting exclude each other: choose one");

#[cfg(feature = "log-rtt")]
use defmt_rtt as _;
#[cfg(feature = "log-semihosting")]
use defmt_semihosting as _;

#[cfg(feature = "defmt")]
defmt::timestamp!("{=u32:ms}", crate::TICK.now_ms());
