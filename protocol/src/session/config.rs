//! What can be set about a session: time-outs, subscriptions, read-back.

use crate::command::CommandId;
use crate::frame::{MAX_MESSAGE_LEN, OVERHEAD};
use crate::types::AutoUpdate;

/// Time-outs and subscriptions. All times in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, crate::Format)]
pub struct Config {
    /// How long the first answer to a request may take.
    pub reply_timeout_ms: u32,
    /// How often a request that may be repeated is sent before the connection counts as lost.
    pub attempts: u8,
    /// How often each subscribed value is requested again, besides its automatic updates. The requests are spread evenly
    /// over this time, and each is repeated after a quarter of `reply_timeout_ms`. So on a line that loses one message, no
    /// state gets older than both times together and the time of one answer.
    pub refresh_ms: u32,
    /// How long to wait before connecting is tried again. A gripper that took a damaged frame for the head of a long one
    /// hears nothing until it gives that up, which it does in silence alone: wait for longer than it does.
    pub reconnect_ms: u32,
    /// How long a motion may take.
    pub motion_timeout_ms: u32,
    /// How long the result of a motion is waited for once the gripper reports that it stands still.
    pub result_grace_ms: u32,
    /// The least time between two updates of one value that the gripper sends, at least 10, unless
    /// [`Session::subscribe`](super::Session::subscribe) says otherwise for one of them.
    pub update_period_ms: u16,
    /// Whether the opening width is subscribed to.
    pub width: bool,
    /// Whether the finger speed is subscribed to.
    pub speed: bool,
    /// Whether the gripping force is subscribed to.
    pub force: bool,
    /// Whether Set Acceleration, Set Force Limit and Set Soft Limits are read back, because the checksum is weak. Such a
    /// request counts as answered only then, and another value than the one that was set as [`MISMATCH`](super::MISMATCH).
    pub verify_settings: bool,
    /// How a FAST STOP is repeated until the gripper confirms it.
    pub fast_stop: FastStopPattern,
    /// The commands with time-outs of their own, in place of `reply_timeout_ms` and `motion_timeout_ms`.
    pub timeouts: &'static [Timeout],
}

/// The time-outs of one command. A script on the gripper, for example, may take its time to answer:
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
    /// The command.
    pub id: N,
    /// How long its first answer may take, in milliseconds.
    pub reply_ms: u32,
    /// How long its second answer may take after E_CMD_PENDING, in milliseconds.
    pub result_ms: u32,
}

/// How a FAST STOP is repeated until the gripper confirms it: one frame, then bursts with silent pauses between them.
///
/// A damaged length field makes a gripper wait for the rest of a frame that does not exist. A burst that is longer than any
/// message ends that wait; so does a pause that is longer than the gripper's frame time-out, which the manual does not state.
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
    /// How long the answer to the first frame may take before the first burst, in milliseconds.
    pub answer_ms: u32,
    /// Frames in a burst, 8 bytes each.
    pub burst_frames: u16,
    /// Silence after a burst, in milliseconds.
    pub pause_ms: u32,
}

impl FastStopPattern {
    /// A burst after 30 ms that is longer than the longest message (1 024 bytes) and one more FAST STOP; a pause longer than
    /// a frame time-out of half a second.
    pub const DEFAULT: Self =
        Self { answer_ms: 30, burst_frames: (MAX_MESSAGE_LEN / FAST_STOP_LEN + 2) as u16, pause_ms: 600 };
}

/// Bytes of a FAST STOP: it has no payload.
const FAST_STOP_LEN: usize = OVERHEAD;

impl Config {
    /// For a serial line at 115 200 bit/s: silence is noticed in under a second. System state and gripper state only.
    ///
    /// The longest stroke (210 mm) at the least speed (5 mm/s) takes 42 s, so a motion may take a minute. A finger's
    /// supply is on after about 500 ms (command set, 3.6.3), so two seconds are given.
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

    /// The part that is the same in every dialect.
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

/// The times of a session, as [`Config`] has them, for commands that are named by `N`.
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
    /// How long the first answer to this command may take.
    pub(super) fn reply_timeout(&self, name: N) -> u32 {
        self.timeout(name).map_or(self.reply_timeout_ms, |timeout| timeout.reply_ms)
    }

    /// How long the second answer to this command may take.
    pub(super) fn result_timeout(&self, name: N) -> u32 {
        self.timeout(name).map_or(self.motion_timeout_ms, |timeout| timeout.result_ms)
    }

    fn timeout(&self, name: N) -> Option<&'static Timeout<N>> {
        self.timeouts.iter().find(|timeout| timeout.id == name)
    }
}
