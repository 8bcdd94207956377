//! The drivers in Rust and C.

use std::ffi::CString;
use std::fmt::Display;
use std::mem::MaybeUninit;
use std::net::SocketAddr;

use wsg_host::gripper::{
    wsg_host_acknowledge, wsg_host_close, wsg_host_fast_stop, wsg_host_grip, wsg_host_home, wsg_host_move,
    wsg_host_open_tcp, wsg_host_set_force_limit, wsg_host_t, wsg_host_width,
};
use wsg_host::stop::{wsg_host_stop_handle, wsg_host_stop_now, wsg_host_stop_t};
use wsg_protocol::HomingDirection;
use wsg_protocol::driver::stream::{self, SetPointStream};
use wsg_protocol::driver::{Mm, MmPerS, N, OnBlock, StopHandle, host, tokio as asynchronous};

use crate::surface::{InTurn, Outcome, SPEED, Surface, Verb};

fn outcome_of<T, E: Display>(result: Result<T, E>) -> Result<T, String> {
    result.map_err(|error| error.to_string())
}

/// Returns an outcome without a value.
fn outcome<T, E: Display>(result: Result<T, E>) -> Outcome {
    outcome_of(result).map(|_| String::new())
}

fn stopped(handle: StopHandle) -> impl Fn() -> Outcome + Send {
    move || outcome(handle.fast_stop())
}

pub(crate) fn blocking(address: SocketAddr) -> Box<dyn Surface> {
    Box::new(InTurn::new(move || {
        let mut gripper = host::connect(address).expect("the gripper answers");
        let handle = gripper.stop_handle().expect("a descriptor");
        let act = move |verb| match verb {
            Verb::Home => outcome(gripper.home(HomingDirection::Positive)),
            Verb::Move(width) => outcome(gripper.move_to(Mm(width), MmPerS(SPEED), OnBlock::Stop)),
            Verb::Grip(width, force) => outcome(gripper.grip_with_force(Mm(width), MmPerS(SPEED), N(force))),
            Verb::FastStop => outcome(gripper.fast_stop()),
            Verb::Acknowledge => acknowledge(|| outcome(gripper.acknowledge())),
            Verb::Read => gripper.width().map(|width| width.0.to_string()).map_err(|error| error.to_string()),
        };
        (act, Some(stopped(handle)))
    }))
}

/// The first call after a stop handle's stop reports the stop.
fn acknowledge(mut ask: impl FnMut() -> Outcome) -> Outcome {
    ask().or_else(|_| ask())
}

pub(crate) fn asynchronous(address: SocketAddr) -> Box<dyn Surface> {
    Box::new(InTurn::new(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let mut gripper = runtime.block_on(asynchronous::connect(address)).expect("the gripper answers");
        let handle = runtime.block_on(async { gripper.stop_handle() }).expect("a descriptor");
        let act = move |verb| {
            runtime.block_on(async {
                match verb {
                    Verb::Home => outcome(gripper.home(HomingDirection::Positive).await),
                    Verb::Move(width) => {
                        outcome(gripper.move_to(Mm(width), MmPerS(SPEED), OnBlock::Stop).await)
                    }
                    Verb::Grip(width, force) => {
                        outcome(gripper.grip_with_force(Mm(width), MmPerS(SPEED), N(force)).await)
                    }
                    Verb::FastStop => outcome(gripper.fast_stop().await),
                    Verb::Acknowledge => {
                        let first = outcome(gripper.acknowledge().await);
                        if first.is_ok() { first } else { outcome(gripper.acknowledge().await) }
                    }
                    Verb::Read => gripper
                        .width()
                        .await
                        .map(|width| width.0.to_string())
                        .map_err(|error| error.to_string()),
                }
            })
        };
        (act, Some(stopped(handle)))
    }))
}

/// Set-points. The stream begins after homing and ends with an acknowledgement.
pub(crate) fn streaming(address: SocketAddr) -> Box<dyn Surface> {
    Box::new(InTurn::new(move || {
        let mut gripper = host::connect(address).expect("the gripper answers");
        let handle = gripper.stop_handle().expect("a descriptor");
        let (mut free, mut running) = (Some(gripper), None);
        let act = move |verb| {
            if matches!(verb, Verb::Home | Verb::Acknowledge)
                && let Some(stream) = running.take()
            {
                free = Some(SetPointStream::end(stream).0);
            }
            match (verb, &running, &mut free) {
                (Verb::Home, None, Some(gripper)) => {
                    outcome(gripper.home(HomingDirection::Positive))?;
                    let gripper = free.take().expect("it is there");
                    running = Some(outcome_of(SetPointStream::start(gripper, stream::Config::default()))?);
                    Ok(String::new())
                }
                (Verb::Move(width), Some(stream), _) => outcome(stream.set_speed_limit(MmPerS(SPEED)))
                    .and_then(|_| outcome(stream.set_target(Mm(width)))),
                (Verb::Grip(width, force), Some(stream), _) => outcome(stream.set_force_limit(N(force)))
                    .and_then(|_| outcome(stream.set_target(Mm(width)))),
                (Verb::Read, Some(stream), _) => {
                    outcome_of(stream.latest()).map(|it| it.position.to_string())
                }
                (Verb::Read, None, Some(gripper)) => outcome_of(gripper.width()).map(|it| it.0.to_string()),
                (Verb::Acknowledge, None, Some(gripper)) => acknowledge(|| outcome(gripper.acknowledge())),
                _ => Err("there is no stream before homing".to_owned()),
            }
        };
        (act, Some(stopped(handle)))
    }))
}

/// A gripper of the library, which is closed on drop.
struct CGripper(*mut wsg_host_t);

impl CGripper {
    fn get(&mut self) -> Option<&mut wsg_host_t> {
        // SAFETY: it is open, and only its owner uses it.
        unsafe { self.0.as_mut() }
    }
}

impl Drop for CGripper {
    fn drop(&mut self) {
        // SAFETY: it is open, and not used afterwards.
        unsafe { wsg_host_close(self.0) };
    }
}

/// A stop handle, which any thread may use and which is never freed.
struct CHandle(*const wsg_host_stop_t);

// SAFETY: the library's documentation permits the use of a handle in any thread.
unsafe impl Send for CHandle {}

impl CHandle {
    fn fast_stop(&self) -> Outcome {
        // SAFETY: the handle is never freed.
        code(wsg_host_stop_now(unsafe { self.0.as_ref() }, 1))
    }
}

fn code(outcome: i32) -> Outcome {
    if outcome == 0 { Ok(String::new()) } else { Err(format!("error {outcome}")) }
}

/// The functions of `wsg_host.h`.
pub(crate) fn c(address: SocketAddr) -> Box<dyn Surface> {
    Box::new(InTurn::new(move || {
        let host = CString::new(address.ip().to_string()).expect("no zero byte");
        let (mut gripper, mut handle) = (MaybeUninit::uninit(), MaybeUninit::uninit());
        // SAFETY: the library initializes each pointer if it returns 0.
        let (mut gripper, handle) = unsafe {
            assert_eq!(wsg_host_open_tcp(host.as_ptr(), address.port(), Some(&mut gripper)), 0);
            let mut gripper = CGripper(gripper.assume_init());
            assert_eq!(wsg_host_stop_handle(gripper.get(), Some(&mut handle)), 0);
            (gripper, CHandle(handle.assume_init()))
        };
        let act = move |verb| match verb {
            Verb::Home => code(wsg_host_home(gripper.get(), 1)),
            Verb::Move(width) => code(wsg_host_move(gripper.get(), width, SPEED)),
            Verb::Grip(width, force) => code(wsg_host_set_force_limit(gripper.get(), force)).and_then(|_| {
                code(wsg_host_grip(gripper.get(), width, SPEED, Some(&mut MaybeUninit::uninit())))
            }),
            Verb::FastStop => code(wsg_host_fast_stop(gripper.get())),
            Verb::Acknowledge => acknowledge(|| code(wsg_host_acknowledge(gripper.get()))),
            Verb::Read => {
                let mut width = MaybeUninit::uninit();
                let read = code(wsg_host_width(gripper.get(), Some(&mut width)));
                // SAFETY: the library initializes the width if it returns 0.
                read.map(|_| unsafe { width.assume_init() }.to_string())
            }
        };
        (act, Some(move || handle.fast_stop()))
    }))
}
