//! Session settings: time-outs and subscriptions.

use crate::gcl::CommandName;
use crate::session::config::{FastStopPattern, Timing};

/// Time-outs and subscriptions of a session. All times are in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub struct Config {
    /// Time-out for the first reply to a request.
    pub reply_timeout_ms: u32,
    /// Number of times a repeatable request is sent before the connection counts as lost.
    pub attempts: u8,
    /// Polling period of each subscribed value, in addition to its automatic updates, as in
    /// [`session::Config`](crate::session::Config::refresh_ms).
    pub refresh_ms: u32,
    /// Delay before the next attempt to connect.
    pub reconnect_ms: u32,
    /// Time-out for the result of a motion.
    pub motion_timeout_ms: u32,
    /// Time-out for the result of a motion after the gripper reports standstill.
    pub result_grace_ms: u32,
    /// Minimum interval between two updates of a value, at least 10 ms.
    /// [`Session::subscribe`](super::Session::subscribe) overrides it for a single value.
    pub interval_ms: u32,
    /// Whether to subscribe to the opening width.
    pub width: bool,
    /// Whether to subscribe to the finger speed.
    pub speed: bool,
    /// Whether to subscribe to the gripping force.
    pub force: bool,
    /// Whether to subscribe to the temperature.
    pub temperature: bool,
    /// Whether error replies include a text (VERBOSE).
    pub verbose: bool,
}

impl Config {
    /// Like the binary protocol's settings: silence is detected in less than a second. Subscribes to system state and
    /// gripper state only.
    ///
    /// The motion time-out is one minute, because the longest stroke (210 mm) at the lowest speed (5 mm/s) takes 42 s.
    pub const DEFAULT: Self = Self {
        reply_timeout_ms: 200,
        attempts: 3,
        refresh_ms: 500,
        reconnect_ms: 250,
        motion_timeout_ms: 60_000,
        result_grace_ms: 1_000,
        interval_ms: 10,
        width: false,
        speed: false,
        force: false,
        temperature: false,
        verbose: false,
    };

    /// Returns the settings that are common to all dialects.
    ///
    /// A FASTSTOP is repeated line by line without bursts, because a line has no length field that could be damaged.
    pub(super) const fn timing(&self) -> Timing<CommandName> {
        Timing {
            reply_timeout_ms: self.reply_timeout_ms,
            attempts: self.attempts,
            refresh_ms: self.refresh_ms,
            reconnect_ms: self.reconnect_ms,
            motion_timeout_ms: self.motion_timeout_ms,
            result_grace_ms: self.result_grace_ms,
            fast_stop: FastStopPattern {
                answer_ms: self.reply_timeout_ms,
                burst_frames: 1,
                pause_ms: self.reply_timeout_ms,
            },
            timeouts: &[],
        }
    }
}
