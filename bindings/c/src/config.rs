//! Time-outs and subscriptions of a session.

use core::mem::MaybeUninit;

use wsg_protocol::session::{Config, FastStopPattern};

use crate::error::{DONE, Outcome, code, wsg_error};
use crate::memory::give;

/// Bit of `updates`: subscribe to the opening width.
pub const WSG_UPDATE_WIDTH: u8 = 1;
/// Bit of `updates`: subscribe to the finger speed.
pub const WSG_UPDATE_SPEED: u8 = 2;
/// Bit of `updates`: subscribe to the gripping force.
pub const WSG_UPDATE_FORCE: u8 = 4;

const ALL_UPDATES: u8 = WSG_UPDATE_WIDTH | WSG_UPDATE_SPEED | WSG_UPDATE_FORCE;

/// Maximum of every time in the configuration: one hour.
pub const WSG_CONFIG_MAX_MS: u32 = 3_600_000;

/// Time-out for the next byte of an incomplete frame by default.
const FRAME_TIMEOUT_MS: u16 = 20;

/// Time-outs and subscriptions of a session. Times are in milliseconds, from 1 to WSG_CONFIG_MAX_MS.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct wsg_config_t {
    /// Time-out for the first reply to a request. Default: 200.
    pub reply_timeout_ms: u32,
    /// Polling period of each subscribed value, in addition to automatic updates. Default: 500.
    pub refresh_ms: u32,
    /// Delay before the next attempt to connect. Default: 600.
    pub reconnect_ms: u32,
    /// Time-out for the result of a motion. Default: 60 000.
    pub motion_timeout_ms: u32,
    /// Time-out for the result of a motion after the gripper reports standstill. Default: 1 000.
    pub result_grace_ms: u32,
    /// Time-out for the reply to a FAST STOP before it is repeated in bursts. Default: 30.
    pub fast_stop_answer_ms: u32,
    /// Silence after a burst of FAST STOP frames. Default: 600.
    pub fast_stop_pause_ms: u32,
    /// Time-out for the next byte of an incomplete frame. Default: 20.
    pub frame_timeout_ms: u16,
    /// Number of FAST STOP frames in a burst, at least 1. Default: 130.
    pub fast_stop_burst_frames: u16,
    /// Minimum time between two automatic updates of a value, 10 to 65 535. Default: 10.
    pub update_period_ms: u16,
    /// Number of times a repeatable request is sent before the connection counts as lost, at least 1. Default: 3.
    pub attempts: u8,
    /// Values to subscribe to in addition to the two states: WSG_UPDATE_WIDTH, WSG_UPDATE_SPEED, WSG_UPDATE_FORCE. Default: 0.
    pub updates: u8,
    /// 1 to read Set Acceleration, Set Force Limit and Set Soft Limits back, 0 (default) to trust their replies. A
    /// different value is reported as WSG_E_WRITE_ERROR.
    pub verify_settings: u8,
    /// Must be 0.
    pub reserved: [u8; 3],
}

impl wsg_config_t {
    /// The defaults: a serial line at 115 200 bit/s.
    pub(crate) const DEFAULT: Self = {
        let config = Config::DEFAULT;
        Self {
            reply_timeout_ms: config.reply_timeout_ms,
            refresh_ms: config.refresh_ms,
            reconnect_ms: config.reconnect_ms,
            motion_timeout_ms: config.motion_timeout_ms,
            result_grace_ms: config.result_grace_ms,
            fast_stop_answer_ms: config.fast_stop.answer_ms,
            fast_stop_pause_ms: config.fast_stop.pause_ms,
            frame_timeout_ms: FRAME_TIMEOUT_MS,
            fast_stop_burst_frames: config.fast_stop.burst_frames,
            update_period_ms: config.update_period_ms,
            attempts: config.attempts,
            updates: 0,
            verify_settings: 0,
            reserved: [0; 3],
        }
    };

    /// Returns the configuration of the session, or an error if a value is outside its range.
    pub(crate) fn session(&self) -> Result<Config, wsg_error> {
        let times = [
            self.reply_timeout_ms,
            self.refresh_ms,
            self.reconnect_ms,
            self.motion_timeout_ms,
            self.result_grace_ms,
            self.frame_timeout_ms.into(),
            self.fast_stop_answer_ms,
            self.fast_stop_pause_ms,
        ];
        let is_valid = times.iter().all(|time| (1..=WSG_CONFIG_MAX_MS).contains(time))
            && self.fast_stop_burst_frames >= 1
            && self.update_period_ms >= wsg_protocol::AutoUpdate::MIN_PERIOD_MS
            && self.attempts >= 1
            && self.updates & !ALL_UPDATES == 0
            && self.verify_settings <= 1
            && self.reserved == [0; 3];
        if !is_valid {
            return Err(wsg_error::Config);
        }
        Ok(Config {
            reply_timeout_ms: self.reply_timeout_ms,
            attempts: self.attempts,
            refresh_ms: self.refresh_ms,
            reconnect_ms: self.reconnect_ms,
            motion_timeout_ms: self.motion_timeout_ms,
            result_grace_ms: self.result_grace_ms,
            update_period_ms: self.update_period_ms,
            width: self.updates & WSG_UPDATE_WIDTH != 0,
            speed: self.updates & WSG_UPDATE_SPEED != 0,
            force: self.updates & WSG_UPDATE_FORCE != 0,
            verify_settings: self.verify_settings == 1,
            fast_stop: FastStopPattern {
                answer_ms: self.fast_stop_answer_ms,
                burst_frames: self.fast_stop_burst_frames,
                pause_ms: self.fast_stop_pause_ms,
            },
            ..Config::DEFAULT
        })
    }
}

/// Writes the default configuration: a serial line at 115 200 bit/s, subscribed to the two states only.
#[unsafe(no_mangle)]
pub extern "C" fn wsg_config_default(config: Option<&mut MaybeUninit<wsg_config_t>>) -> i32 {
    let fill = || -> Outcome {
        give(config, wsg_config_t::DEFAULT)?;
        DONE
    };
    code(fill())
}
