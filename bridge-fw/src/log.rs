//! Logging with the feature `defmt`: start, lost bytes, sent commands and session events.

#![cfg_attr(not(feature = "defmt"), expect(unused_variables, reason = "used only with the feature"))]

use wsg_protocol::Command;
use wsg_protocol::session::Event;

use crate::gripper::UartLine;
use crate::register::ResetCause;

#[cfg(feature = "defmt")]
macro_rules! log {
    ($level:ident, $($message:tt)+) => { defmt::$level!($($message)+) };
}

#[cfg(not(feature = "defmt"))]
macro_rules! log {
    ($($any:tt)+) => {{}};
}

pub(crate) fn boot(cause: ResetCause) {
    match cause {
        ResetCause::Watchdog => log!(error, "boot: reset by the watchdog, the main loop stalled"),
        ResetCause::Firmware => log!(error, "boot: reset by the firmware, a fault or a panic"),
        ResetCause::PowerOn => log!(info, "boot: power on"),
        ResetCause::Pin => log!(info, "boot: reset pin"),
        ResetCause::Unknown => log!(info, "boot: unknown reset cause"),
    }
}

pub(crate) fn no_clock() {
    log!(error, "clock: start failed, waiting for the watchdog");
}

pub(crate) fn wrong_settings() {
    log!(error, "settings: image out of range, waiting for the watchdog");
}

pub(crate) fn running() {
    log!(info, "clock, watchdog and lines started");
}

/// Logs bytes from the gripper that were lost since the last call.
pub(crate) fn lost<U>(line: &UartLine<U>) {
    #[cfg(feature = "defmt")]
    {
        use crate::atomic::{AtomicU32, Ordering};

        static LOGGED: AtomicU32 = AtomicU32::new(0);
        let crate::gripper::LostBytes { overrun, framing, queue_full } = line.lost();
        let all = overrun.wrapping_add(framing).wrapping_add(queue_full);
        if all != LOGGED.load(Ordering::Relaxed) {
            LOGGED.store(all, Ordering::Relaxed);
            log!(
                warn,
                "gripper line: {=u32} overruns, {=u32} framing errors, {=u32} lost to a full queue",
                overrun,
                framing,
                queue_full
            );
        }
    }
}

pub(crate) fn sent(command: &Command<'_>) {
    log!(debug, "-> {}", command);
}

pub(crate) fn noticed(event: &Event<'_>) {
    log!(debug, "<- {}", event);
}
