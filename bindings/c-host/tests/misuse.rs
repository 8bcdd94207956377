//! Null pointers, impossible sizes and the kind of a stop.

use std::mem::MaybeUninit;
use std::ptr;
use std::thread;

use wsg_host::error::wsg_host_error_text;
use wsg_host::gripper::*;
use wsg_host::stop::*;
use wsg_host::stream::*;
use wsg_host::wsg_host_error;
use wsg_protocol::{GripperState, Status, SystemFlags};
use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, Part};

const NULL: i32 = wsg_host_error::NullPointer as i32;

/// Starts a virtual gripper and connects to it.
fn open() -> (ServerThread, *mut wsg_host_t) {
    open_with(Config { time_scale: 10.0, ..Config::default() })
}

fn open_with(config: Config) -> (ServerThread, *mut wsg_host_t) {
    let lines = Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() };
    let server = ServerThread::start(config, &lines, None).unwrap();
    let port = server.tcp_address().unwrap().port();
    let mut gripper = MaybeUninit::uninit();
    assert_eq!(unsafe { wsg_host_open_tcp(c"127.0.0.1".as_ptr(), port, Some(&mut gripper)) }, 0);
    (server, unsafe { gripper.assume_init() })
}

fn flags(gripper: *mut wsg_host_t) -> SystemFlags {
    let mut flags = MaybeUninit::uninit();
    assert_eq!(wsg_host_flags(unsafe { gripper.as_mut() }, Some(&mut flags)), 0);
    SystemFlags::from_bits_retain(unsafe { flags.assume_init() })
}

#[test]
fn handle_stops_by_stop_or_fast_stop_as_requested() {
    let (_server, gripper) = open_with(Config::default());
    let mut handle = MaybeUninit::uninit();
    unsafe {
        assert_eq!(wsg_host_home(gripper.as_mut(), 0), 0);
        assert_eq!(wsg_host_stop_handle(gripper.as_mut(), Some(&mut handle)), 0);
    }
    let handle: *mut wsg_host_stop_t = unsafe { handle.assume_init() };
    for (fast, error, is_locked) in
        [(0, wsg_host_error::Stopped, false), (1, wsg_host_error::FastStopped, true)]
    {
        let moved = thread::scope(|scope| {
            let handle = unsafe { &*handle };
            scope.spawn(move || assert_eq!(wsg_host_stop_now(Some(handle), fast), 0));
            // It takes 20 s. A stop before it also ends it.
            wsg_host_move(unsafe { gripper.as_mut() }, 5.0, 5.0)
        });
        assert_eq!(moved, error as i32, "fast = {fast}");
        assert_eq!(flags(gripper).contains(SystemFlags::FAST_STOP), is_locked, "fast = {fast}");
    }
    let locked = wsg_host_move(unsafe { gripper.as_mut() }, 50.0, 100.0);
    assert_eq!(locked, i32::from(Status::AccessDenied.code()));
    let argument = wsg_host_error::Argument as i32;
    assert_eq!(wsg_host_stop_now(unsafe { handle.as_ref() }, 2), argument);
    unsafe {
        wsg_host_stop_free(handle);
        wsg_host_close(gripper);
    }
}

#[test]
fn closed_gripper_is_not_locked_and_a_locked_one_stays_locked() {
    let (server, gripper) = open();
    let again = |gripper: *mut wsg_host_t| {
        unsafe { wsg_host_close(gripper) };
        let (port, mut again) = (server.tcp_address().unwrap().port(), MaybeUninit::uninit());
        assert_eq!(unsafe { wsg_host_open_tcp(c"127.0.0.1".as_ptr(), port, Some(&mut again)) }, 0);
        unsafe { again.assume_init() }
    };
    assert_eq!(wsg_host_home(unsafe { gripper.as_mut() }, 0), 0);
    let gripper = again(gripper);
    assert!(!flags(gripper).contains(SystemFlags::FAST_STOP));
    assert_eq!(wsg_host_fast_stop(unsafe { gripper.as_mut() }), 0);
    let gripper = again(gripper);
    assert!(flags(gripper).contains(SystemFlags::FAST_STOP));
    unsafe { wsg_host_close(gripper) };
}

#[test]
fn value_outside_the_limits_is_refused_and_changes_nothing() {
    let (_server, gripper) = open();
    let it = || unsafe { gripper.as_mut() };
    assert_eq!(wsg_host_home(it(), 0), 0);
    assert_eq!(wsg_host_set_force_limit(it(), 40.0), 0);
    let mut held = MaybeUninit::uninit();
    let refused = [
        ("force 500 N", wsg_host_set_force_limit(it(), 500.0)),
        ("force 81 N without overdrive", wsg_host_set_force_limit(it(), 81.0)),
        ("force -1 N", wsg_host_set_force_limit(it(), -1.0)),
        ("acceleration 99999", wsg_host_set_acceleration(it(), 99_999.0)),
        ("move to 111 mm", wsg_host_move(it(), 111.0, 100.0)),
        ("move at 500 mm/s", wsg_host_move(it(), 50.0, 500.0)),
        ("grip at 1 mm/s", wsg_host_grip(it(), 20.0, 1.0, Some(&mut held))),
        ("release to -1 mm", wsg_host_release(it(), -1.0, 100.0)),
    ];
    for (what, returned) in refused {
        assert_eq!(returned, wsg_host_error::OutOfLimits as i32, "{what}");
    }
    assert_eq!(wsg_host_set_force_limit(it(), f32::NAN), wsg_host_error::Argument as i32);
    // Get Force Limit.
    let (mut reply, mut length) = ([0; 4], 4);
    let asked = unsafe { wsg_host_raw(it(), 0x33, ptr::null(), 0, reply.as_mut_ptr(), Some(&mut length)) };
    assert_eq!((asked, f32::from_le_bytes(reply)), (0, 40.0));
    let mut width = MaybeUninit::uninit();
    assert_eq!(wsg_host_width(it(), Some(&mut width)), 0);
    assert!(unsafe { width.assume_init() } > 100.0, "the fingers have moved");
    unsafe { wsg_host_close(gripper) };
}

#[test]
fn each_query_returns_its_own_value() {
    let config = Config { time_scale: 10.0, part: Part::of_width(20.0), ..Config::default() };
    let (_server, gripper) = open_with(config);
    let it = || unsafe { gripper.as_mut() };
    let mut held = MaybeUninit::uninit();
    assert_eq!(wsg_host_home(it(), 0), 0);
    assert_eq!(wsg_host_set_force_limit(it(), 40.0), 0);
    assert_eq!(wsg_host_grip(it(), 20.0, 100.0, Some(&mut held)), 0);
    assert_eq!(unsafe { held.assume_init() }, 1);
    let number = |query: extern "C" fn(Option<&mut wsg_host_t>, Option<&mut MaybeUninit<f32>>) -> i32| {
        let mut value = MaybeUninit::uninit();
        assert_eq!(query(it(), Some(&mut value)), 0);
        unsafe { value.assume_init() }
    };
    let (width, speed, force) = (number(wsg_host_width), number(wsg_host_speed), number(wsg_host_force));
    assert!(
        (width - 20.0).abs() < 1.0 && speed.abs() < 1.0 && (force - 40.0).abs() < 5.0,
        "{width} {speed} {force}"
    );
    let mut state = MaybeUninit::uninit();
    assert_eq!(wsg_host_state(it(), Some(&mut state)), 0);
    assert_eq!(unsafe { state.assume_init() }, GripperState::Holding.code());
    let mut limits = MaybeUninit::uninit();
    assert_eq!(wsg_host_limits(it(), Some(&mut limits)), 0);
    let limits = unsafe { limits.assume_init() };
    assert_eq!((limits.stroke, limits.min_force, limits.nominal_force), (110.0, 5.0, 80.0));
    let acceleration = wsg_host_set_acceleration(it(), 1_000.0);
    assert_eq!(acceleration, 0);
    assert_eq!(wsg_host_release(it(), 60.0, 200.0), 0);
    assert!((number(wsg_host_width) - 60.0).abs() < 1.0);
    unsafe { wsg_host_close(gripper) };
}

#[test]
fn queries_fail_once_the_connection_is_lost() {
    let (server, gripper) = open();
    drop(server);
    let it = || unsafe { gripper.as_mut() };
    for _ in 0..2 {
        assert!(wsg_host_width(it(), Some(&mut MaybeUninit::uninit())) < 0);
        assert!(wsg_host_state(it(), Some(&mut MaybeUninit::uninit())) < 0);
        assert!(wsg_host_flags(it(), Some(&mut MaybeUninit::uninit())) < 0);
        assert!(wsg_host_force(it(), Some(&mut MaybeUninit::uninit())) < 0);
        assert!(wsg_host_limits(it(), Some(&mut MaybeUninit::uninit())) < 0);
    }
    unsafe { wsg_host_close(gripper) };
}

#[test]
fn each_null_pointer_is_named() {
    let (server, gripper) = open();
    let port = server.tcp_address().unwrap().port();
    let host = c"127.0.0.1".as_ptr();
    let mut other = MaybeUninit::uninit();
    unsafe {
        assert_eq!(wsg_host_open_tcp(ptr::null(), port, Some(&mut other)), NULL);
        assert!(other.assume_init().is_null());
        assert_eq!(wsg_host_open_tcp(host, port, None), NULL);
        assert_eq!(wsg_host_open_udp(ptr::null(), port, 0, Some(&mut other)), NULL);
        assert_eq!(wsg_host_open_udp(host, port, 0, None), NULL);
        assert_eq!(wsg_host_open_serial(ptr::null(), 115_200, Some(&mut other)), NULL);
        assert_eq!(wsg_host_open_serial(host, 115_200, None), NULL);
        wsg_host_close(ptr::null_mut());
        wsg_host_stop_free(ptr::null_mut());
    }

    let without_gripper: [(&str, i32); 20] = [
        ("home", wsg_host_home(None, 0)),
        ("move", wsg_host_move(None, 50.0, 100.0)),
        ("grip", wsg_host_grip(None, 50.0, 100.0, Some(&mut MaybeUninit::uninit()))),
        ("release", wsg_host_release(None, 50.0, 100.0)),
        ("stop", wsg_host_stop(None)),
        ("fast_stop", wsg_host_fast_stop(None)),
        ("acknowledge", wsg_host_acknowledge(None)),
        ("set_force_limit", wsg_host_set_force_limit(None, 40.0)),
        ("set_acceleration", wsg_host_set_acceleration(None, 1_000.0)),
        ("width", wsg_host_width(None, Some(&mut MaybeUninit::uninit()))),
        ("speed", wsg_host_speed(None, Some(&mut MaybeUninit::uninit()))),
        ("force", wsg_host_force(None, Some(&mut MaybeUninit::uninit()))),
        ("state", wsg_host_state(None, Some(&mut MaybeUninit::uninit()))),
        ("flags", wsg_host_flags(None, Some(&mut MaybeUninit::uninit()))),
        ("limits", wsg_host_limits(None, Some(&mut MaybeUninit::uninit()))),
        ("info", wsg_host_info(None, Some(&mut MaybeUninit::uninit()))),
        ("stop_handle", wsg_host_stop_handle(None, Some(&mut MaybeUninit::uninit()))),
        ("raw", unsafe { wsg_host_raw(None, 0xA0, ptr::null(), 0, ptr::null_mut(), Some(&mut 0)) }),
        ("stop_now", wsg_host_stop_now(None, 0)),
        ("stream_start", unsafe {
            wsg_host_stream_start(ptr::null_mut(), 100, Some(&mut MaybeUninit::uninit()))
        }),
    ];
    for (function, returned) in without_gripper {
        assert_eq!(returned, NULL, "{function}");
    }

    let it = || unsafe { gripper.as_mut() };
    let without_result = [
        ("grip", wsg_host_grip(it(), 50.0, 100.0, None)),
        ("width", wsg_host_width(it(), None)),
        ("speed", wsg_host_speed(it(), None)),
        ("force", wsg_host_force(it(), None)),
        ("state", wsg_host_state(it(), None)),
        ("flags", wsg_host_flags(it(), None)),
        ("limits", wsg_host_limits(it(), None)),
        ("info", wsg_host_info(it(), None)),
        ("stop_handle", wsg_host_stop_handle(it(), None)),
        ("raw, payload", raw(it(), (ptr::null(), 1), (ptr::null_mut(), 0))),
        ("raw, reply", raw(it(), (ptr::null(), 0), (ptr::null_mut(), 1))),
        ("raw, length", unsafe { wsg_host_raw(it(), 0xA0, ptr::null(), 0, ptr::null_mut(), None) }),
    ];
    for (function, returned) in without_result {
        assert_eq!(returned, NULL, "{function}");
    }

    let without_stream = [
        ("set_target", wsg_host_stream_set_target(None, 50.0)),
        ("schedule", wsg_host_stream_schedule(None, 50.0, 0)),
        ("set_speed_limit", wsg_host_stream_set_speed_limit(None, 50.0)),
        ("set_force_limit", wsg_host_stream_set_force_limit(None, 50.0)),
        ("now", wsg_host_stream_now(None, Some(&mut MaybeUninit::uninit()))),
        ("latest", wsg_host_stream_latest(None, Some(&mut MaybeUninit::uninit()))),
        ("stop_handle", wsg_host_stream_stop_handle(None, Some(&mut MaybeUninit::uninit()))),
        ("end", unsafe { wsg_host_stream_end(ptr::null_mut(), None) }),
    ];
    for (function, returned) in without_stream {
        assert_eq!(returned, NULL, "stream_{function}");
    }
    // The stream takes over the gripper even after an error, and closes it.
    assert_eq!(unsafe { wsg_host_stream_start(gripper, 100, None) }, NULL);
}

/// Calls the function with these addresses and lengths.
fn raw(gripper: Option<&mut wsg_host_t>, payload: (*const u8, usize), reply: (*mut u8, usize)) -> i32 {
    let mut length = reply.1;
    unsafe { wsg_host_raw(gripper, 0xA0, payload.0, payload.1, reply.0, Some(&mut length)) }
}

#[test]
fn size_that_no_memory_has_is_too_long() {
    let (_server, gripper) = open();
    let too_long = wsg_host_error::TooLong as i32;
    let mut byte = 0u8;
    for size in [usize::MAX, isize::MAX as usize + 1] {
        let it = || unsafe { gripper.as_mut() };
        assert_eq!(raw(it(), (&raw const byte, size), (ptr::null_mut(), 0)), too_long);
        assert_eq!(raw(it(), (ptr::null(), 0), (&raw mut byte, size)), too_long);
    }
    unsafe { wsg_host_close(gripper) };
}

#[test]
fn each_error_has_a_text_of_its_own() {
    let text = |error: i32| unsafe { std::ffi::CStr::from_ptr(wsg_host_error_text(error)) };
    let mut texts: Vec<_> = (-28..=-20).chain([0, -1, -6, -7, -10, -11, -12, -15, -100]).map(text).collect();
    texts.sort_unstable();
    let count = texts.len();
    texts.dedup();
    assert_eq!(texts.len(), count);
    assert_eq!(text(-99), text(-100));
}
