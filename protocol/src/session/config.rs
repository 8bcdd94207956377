//! Session settings: time-outs, subscriptions and read-back.

use crate::command::CommandId;
use crate::frame::{MAX_MESSAGE_LEN, OVERHEAD};
use crate::types::AutoUpdate;

/// Time-outs and subscriptions of a session. All times are in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, crate::Format)]
pub struct Config {
    /// Time-out for the first reply to a request.
    pub reply_timeout_ms: u32,
    /// Number of times a repeatable request is sent before the connection counts as lost.
    pub attempts: u8,
    /// Polling period of each subscribed value, in addition to its automatic updates. The requests are spread evenly
    /// over this period, and each is repeated after a quarter of `reply_timeout_ms`. If a line loses one message, no
    /// state gets older than the sum of both times and one reply time.
    pub refresh_ms: u32,
    /// Delay before the next attempt to connect. A gripper that mistook a damaged frame for the head of a long one
    /// discards it only after a period of silence. Choose a longer delay than that period.
    pub reconnect_ms: u32,
    /// Time-out for the result of a motion.
    pub motion_timeout_ms: u32,
    /// Time-out for the result of a motion after the gripper reports standstill.
    pub result_grace_ms: u32,
    /// Minimum period between two updates of a value, at least 10 ms. [`Session::subscribe`](super::Session::subscribe)
    /// overrides it for a single value.
    pub update_period_ms: u16,
    /// Whether to subscribe to the opening width.
    pub width: bool,
    /// Whether to subscribe to the finger speed.
    pub speed: bool,
    /// Whether to subscribe to the gripping force.
    pub force: bool,
    /// Whether Set Acceleration, Set Force Limit and Set Soft Limits are read back, because the checksum is weak. Such
    /// a request counts as answered only after the read-back. A different value, such as one that the gripper corrected to
    /// its limits, is reported as [`MISMATCH`](super::MISMATCH).
    pub verify_settings: bool,
    /// Repetition pattern of an unconfirmed FAST STOP.
    pub fast_stop: FastStopPattern,
    /// Commands with individual time-outs, which replace `reply_timeout_ms` and `motion_timeout_ms`.
    pub timeouts: &'static [Timeout],
}

/// The time-outs of one command, for example a script on the gripper that replies slowly:
///
/// ```
/// use wsg_protocol::session::{Config, Timeout};
/// use wsg_protocol::CommandId;
///
/// const SCRIPT: Timeout = Timeout { id: CommandId::Unknown(0xB0), reply_ms: 2_000, result_ms: 10_000 };
/// let config = Config { timeouts: &[SCRIPT], ..Config::DEFAULT };
/// assert_eq!(config.timeouts.len(), 1);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, crate::Format)]
pub struct Timeout<N = CommandId> {
    /// The command to which the time-outs apply.
    pub id: N,
    /// Time-out for the first reply, in milliseconds.
    pub reply_ms: u32,
    /// Time-out for the second reply after E_CMD_PENDING, in milliseconds.
    pub result_ms: u32,
}

/// Repetition pattern of an unconfirmed FAST STOP: a single frame, then bursts with silent pauses in between.
///
/// A damaged length field makes a gripper wait for the rest of a frame that does not exist. A burst longer than any
/// message ends that wait. So does a pause longer than the gripper's frame time-out, which the manual does not state.
///
/// ```
/// use wsg_protocol::session::FastStopPattern;
///
/// // At 115 200 bit/s a burst takes 90 ms.
/// let bytes = 8 * FastStopPattern::DEFAULT.burst_frames;
/// assert!(bytes >= 1_024 + 2 * 8);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, crate::Format)]
pub struct FastStopPattern {
    /// Time-out for the reply to the first frame, after which the first burst begins, in milliseconds.
    pub answer_ms: u32,
    /// Number of frames in a burst, 8 bytes each.
    pub burst_frames: u16,
    /// Silence after a burst, in milliseconds.
    pub pause_ms: u32,
}

impl FastStopPattern {
    /// Starts the first burst after 30 ms. A burst is longer than the longest message (1 024 bytes) plus one FAST STOP.
    /// A pause is longer than a frame time-out of half a second.
    pub const DEFAULT: Self =
        Self { answer_ms: 30, burst_frames: (MAX_MESSAGE_LEN / FAST_STOP_LEN + 2) as u16, pause_ms: 600 };
}

/// Length of a FAST STOP in bytes; it has no payload.
const FAST_STOP_LEN: usize = OVERHEAD;

impl Config {
    /// Settings for a serial line at 115 200 bit/s. Silence is detected in less than a second. Subscribes to system
    /// state and gripper state only.
    ///
    /// The motion time-out is one minute, because the longest stroke (210 mm) at the lowest speed (5 mm/s) takes 42 s.
    /// A finger's supply is on after about 500 ms (command set, 3.6.3), so its time-out is two seconds.
    pub const DEFAULT: Self = Self {
        reply_timeout_ms: 200,
        attempts: 3,
        refresh_ms: 500,
        reconnect_ms: 600,
        motion_timeout_ms: 60_000,
        result_grace_ms: 1_000,
        update_period_ms: AutoUpdate::MIN_PERIOD_MS,
        width: false,
        speed: false,
        force: false,
        verify_settings: false,
        fast_stop: FastStopPattern::DEFAULT,
        timeouts: &[
            Timeout { id: CommandId::Finger1Power, reply_ms: 200, result_ms: 2_000 },
            Timeout { id: CommandId::Finger2Power, reply_ms: 200, result_ms: 2_000 },
        ],
    };

    /// Returns the settings that are common to all dialects.
    pub(super) const fn timing(&self) -> Timing<CommandId> {
        Timing {
            reply_timeout_ms: self.reply_timeout_ms,
            attempts: self.attempts,
            refresh_ms: self.refresh_ms,
            reconnect_ms: self.reconnect_ms,
            motion_timeout_ms: self.motion_timeout_ms,
            result_grace_ms: self.result_grace_ms,
            fast_stop: self.fast_stop,
            timeouts: self.timeouts,
        }
    }
}

/// The time settings of a session, for commands named by `N`.
#[derive(Clone, Copy, Debug, Hash)]
pub(crate) struct Timing<N: 'static> {
    pub(crate) reply_timeout_ms: u32,
    pub(crate) attempts: u8,
    pub(crate) refresh_ms: u32,
    pub(crate) reconnect_ms: u32,
    pub(crate) motion_timeout_ms: u32,
    pub(crate) result_grace_ms: u32,
    pub(crate) fast_stop: FastStopPattern,
    pub(crate) timeouts: &'static [Timeout<N>],
}

impl<N: Copy + PartialEq> Timing<N> {
    /// Returns the time-out for the first reply to this command, in milliseconds.
    pub(super) fn reply_timeout(&self, name: N) -> u32 {
        self.timeout(name).map_or(self.reply_timeout_ms, |timeout| timeout.reply_ms)
    }

    /// Returns the time-out for the second reply to this command, in milliseconds.
    pub(super) fn result_timeout(&self, name: N) -> u32 {
        self.timeout(name).map_or(self.motion_timeout_ms, |timeout| timeout.result_ms)
    }

    fn timeout(&self, name: N) -> Option<&'static Timeout<N>> {
        self.timeouts.iter().find(|timeout| timeout.id == name)
    }
}
