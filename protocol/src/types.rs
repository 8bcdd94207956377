//! The value types of requests and replies: status codes, states, flags and limits.

mod flags;
mod info;
mod state;
mod status;
mod text;

pub use flags::{FingerFlags, PrePositionFlags, SystemFlags, UpdateFlags};
pub use info::{
    DeviceType, FingerInfo, FingerType, FirmwareVersion, GrippingStatistics, SoftLimits, SystemInfo,
    SystemLimits, Temperature,
};
pub use state::{AutoUpdate, GripperState, HomingDirection};
pub use status::Status;
pub use text::{AckKey, DeviceTag, FingerData, LoopData};
