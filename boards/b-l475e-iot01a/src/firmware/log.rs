//! What the board tells its log. Without the `defmt` feature all of it is nothing.

#[cfg(all(feature = "log-rtt", feature = "log-semihosting"))]
compile_error!("choose one of log-rtt and log-semihosting: a log goes to one place");

#[cfg(feature = "log-rtt")]
use defmt_rtt as _;
#[cfg(feature = "log-semihosting")]
use defmt_semihosting as _;

#[cfg(feature = "defmt")]
pub(crate) use defmt_log::{boot, line_errors, no_clock, running, wrong_settings};

#[cfg(not(feature = "defmt"))]
pub(crate) use no_log::{boot, line_errors, no_clock, running, wrong_settings};

#[cfg(feature = "defmt")]
mod defmt_log {
    use core::sync::atomic::{AtomicU32, Ordering};

    use wsg_bridge_fw::ResetCause;
    use wsg_bridge_fw::gripper::LostBytes;

    use wsg_stm32::gripper_line;

    use crate::clock;

    defmt::timestamp!("{=u32:ms}", crate::TICK.now_ms());

    /// Says why the MCU was reset.
    pub(crate) fn boot(cause: ResetCause) {
        match cause {
            ResetCause::Watchdog => {
                defmt::error!("boot: reset by the watchdog, the main loop did not come round")
            }
            ResetCause::Firmware => defmt::error!("boot: reset by the firmware, a fault or a panic"),
            ResetCause::PowerOn => defmt::info!("boot: power on"),
            ResetCause::Pin => defmt::info!("boot: reset pin"),
            ResetCause::Unknown => defmt::info!("boot: for an unknown reason"),
        }
    }

    pub(crate) fn no_clock() {
        defmt::error!("clock: PLL does not start, waiting for the watchdog");
    }

    pub(crate) fn wrong_settings() {
        defmt::error!("settings: those of this image go beyond their ranges, waiting for the watchdog");
    }

    pub(crate) fn running() {
        defmt::info!("clock: {=u32} Hz, watchdog and lines started", clock::HCLK_HZ);
    }

    /// Says so when bytes from the gripper have been lost since the last call.
    pub(crate) fn line_errors() {
        static SAID: AtomicU32 = AtomicU32::new(0);
        let LostBytes { overrun, framing, queue_full } = gripper_line::BUFFERS.lost();
        let all = overrun.wrapping_add(framing).wrapping_add(queue_full);
        if all != SAID.load(Ordering::Relaxed) {
            SAID.store(all, Ordering::Relaxed);
            defmt::warn!(
                "gripper line: {=u32} overruns, {=u32} framing errors, {=u32} lost to a full queue",
                overrun,
                framing,
                queue_full
            );
        }
    }
}

#[cfg(not(feature = "defmt"))]
mod no_log {
    use wsg_bridge_fw::ResetCause;

    pub(crate) fn boot(_: ResetCause) {}
    pub(crate) fn no_clock() {}
    pub(crate) fn wrong_settings() {}
    pub(crate) fn running() {}
    pub(crate) fn line_errors() {}
}
