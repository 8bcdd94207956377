//! What can be set about a session: time-outs and subscriptions.

use crate::gcl::CommandName;
use crate::session::config::{FastStopPattern, Timing};

/// Time-outs and subscriptions. All times in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub struct Config {
    /// How long the first answer to a request may take.
    pub reply_timeout_ms: u32,
    /// How often a request that may be repeated is sent before the connection counts as lost.
    pub attempts: u8,
    /// How often each subscribed value is requested again, besides its automatic updates, as in
    /// [`session::Config`](crate::session::Config::refresh_ms).
    pub refresh_ms: u32,
    /// How long to wait before connecting is tried again.
    pub reconnect_ms: u32,
    /// How long a motion may take.
    pub motion_timeout_ms: u32,
    /// How long the result of a motion is waited for once the gripper reports that it stands still.
    pub result_grace_ms: u32,
    /// The least time between two updates of one value that the gripper sends, at least 10, unless
    /// [`Session::subscribe`](super::Session::subscribe) says otherwise for one of them.
    pub interval_ms: u32,
    /// Whether the opening width is subscribed to.
    pub width: bool,
    /// Whether the finger speed is subscribed to.
    pub speed: bool,
    /// Whether the gripping force is subscribed to.
    pub force: bool,
    /// Whether the temperature is subscribed to.
    pub temperature: bool,
    /// Whether errors come with a text (VERBOSE).
    pub verbose: bool,
}

impl Config {
    /// As the binary protocol's: silence is noticed in under a second. System state and gripper state only.
    ///
    /// The longest stroke (210 mm) at the least speed (5 mm/s) takes 42 s, so a motion may take a minute.
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

    /// The part that is the same in every dialect.
    ///
    /// A FASTSTOP is repeated one line at a time, without bursts: a line has no length field that could be damaged.
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
