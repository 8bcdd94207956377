//! Streams of set-points to the virtual gripper: with the project's script, with UMI's message format, and without a script.

use std::io;
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use wsg_protocol::driver::blocking::Gripper;
use wsg_protocol::driver::host::{self, StdClock, Tcp};
use wsg_protocol::driver::stream::{Backend, Cause, Config, End, Rejected, Sample, SetPointStream};
use wsg_protocol::driver::{self, Error, Mm, MmPerS, N, StopKind};
use wsg_protocol::{HomingDirection, Status, SystemFlags, session};
use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config as Sim, Part, VirtualRig};

/// Maximum time that a test waits for an expected event.
const PATIENCE: Duration = Duration::from_secs(30);
/// Permitted distance of the fingers from a set-point, in mm.
const CLOSE: f32 = 0.3;
const ENDED_BY_CALLER: End = End { cause: Cause::Requested, is_stop_confirmed: true };

type Stream = SetPointStream<Tcp, StdClock>;

fn script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

fn ours() -> Option<PathBuf> {
    Some(script("../protocol/scripts/wsg_stream.lua"))
}

/// Returns both back-ends of the project.
fn scripts() -> [Option<PathBuf>; 2] {
    [ours(), None]
}

fn serve(script: Option<PathBuf>, part: Option<Part>) -> (ServerThread, SocketAddr) {
    let config = Sim { part, homing_speed: Some(400.0), ..Sim::default() };
    let tcp = Some("127.0.0.1:0".parse().unwrap());
    let server = ServerThread::start(config, &Lines { tcp, script, ..Lines::default() }, None).unwrap();
    let address = server.tcp_address().unwrap();
    (server, address)
}

fn until(what: &str, mut is_reached: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !is_reached() {
        assert!(begin.elapsed() < PATIENCE, "not in time: {what}");
        thread::park_timeout(Duration::from_millis(1));
    }
}

/// On a busy machine, the server may pause longer than a real gripper.
const PATIENT: driver::Config = driver::Config {
    session: session::Config { reply_timeout_ms: 2_000, ..driver::Config::DEFAULT.session },
    ..driver::Config::DEFAULT
};

/// Returns a homed and open gripper.
fn homed(address: SocketAddr) -> Gripper<Tcp, StdClock> {
    let mut gripper = Gripper::<_, _>::with_config(Tcp::connect(address).unwrap(), StdClock::new(), PATIENT);
    gripper.connect().unwrap();
    gripper.home(HomingDirection::Positive).unwrap();
    gripper
}

fn stream_at(address: SocketAddr, backend: Backend) -> Stream {
    let mut gripper = homed(address);
    let id = if backend == Backend::Script { 0xA5 } else { 0xB0 };
    if backend != Backend::PrePosition {
        // The script registers its command soon after its start.
        until("a script", || gripper.raw(id, &[], &mut [0; 32]).is_ok());
    }
    let stream = SetPointStream::start(gripper, Config::default()).unwrap();
    assert_eq!(stream.backend(), backend);
    stream
}

fn start(address: SocketAddr, script: &Option<PathBuf>) -> Stream {
    stream_at(address, if script.is_some() { Backend::Script } else { Backend::PrePosition })
}

fn reach(stream: &Stream, position: f32) {
    until("the position", || {
        assert_eq!(stream.ended(), None);
        (latest(stream).position - position).abs() < CLOSE
    });
}

/// Returns the latest sample of a stream that runs.
fn latest(stream: &Stream) -> Sample {
    stream.latest().unwrap()
}

fn samples(stream: &Stream, count: u32) {
    let begin = latest(stream).number;
    until("samples", || latest(stream).number - begin >= count);
}

fn ended(stream: &Stream) -> End {
    until("the end", || stream.ended().is_some());
    stream.ended().unwrap()
}

/// Checks over a separate connection that the fingers are at rest and stay there.
fn assert_standing(address: SocketAddr) -> SystemFlags {
    let mut other = host::connect(address).unwrap();
    let before = other.width().unwrap();
    thread::park_timeout(Duration::from_millis(50));
    let flags = other.system_state().unwrap();
    assert!(!flags.contains(SystemFlags::MOVING), "{flags}");
    assert_eq!(other.width().unwrap(), before);
    flags
}

#[test]
fn fingers_follow_and_hold_set_points_with_or_without_a_script() {
    for script in scripts() {
        let (_server, address) = serve(script.clone(), None);
        let stream = start(address, &script);
        samples(&stream, 5);
        let begin: Vec<Sample> = stream.history();
        assert!(begin.iter().all(|sample| sample.position == 110.0 && sample.set_point.is_none()));

        let now = stream.now();
        stream.schedule(Mm(100.0), now.plus(200)).unwrap();
        stream.schedule(Mm(60.0), now.plus(600)).unwrap();
        reach(&stream, 60.0);
        samples(&stream, 20);
        reach(&stream, 60.0);
        let history = stream.history();
        assert!(history.windows(2).all(|pair| pair[1].number == pair[0].number + 1));
        assert!(history.iter().all(|sample| sample.received_at.has_reached(sample.measured_at)));
        assert_eq!(stream.line().clock_offset_ms.is_some(), script.is_some());

        let (mut gripper, end) = stream.end();
        assert_eq!(end, ENDED_BY_CALLER);
        assert!((gripper.width().unwrap().0 - 60.0).abs() < CLOSE);
        gripper.release(Mm(70.0), MmPerS(100.0)).unwrap();
    }
}

/// Fingers that stop because the machine pauses prove nothing, so such an attempt is repeated.
#[test]
fn later_target_replaces_the_one_before_without_a_stop() {
    for _ in 0..20 {
        let (_server, address) = serve(ours(), None);
        let stream = start(address, &ours());
        stream.set_speed_limit(MmPerS(100.0)).unwrap();
        stream.set_target(Mm(80.0)).unwrap();
        until("the start of the motion", || latest(&stream).position < 95.0);
        let is_set = stream.set_target(Mm(40.0)).is_ok();
        // Without a gap, this sample is at most 100 ms old, in which the fingers move 10 mm.
        let is_in_time = is_set && latest(&stream).position > 91.0;
        let has_arrived = || stream.latest().is_ok_and(|sample| (sample.position - 40.0).abs() < CLOSE);
        until("the position", || stream.ended().is_some() || has_arrived());
        if is_in_time && stream.ended().is_none() && stream.gaps().is_empty() {
            let under_way = stream.history();
            let mut under_way = under_way.iter().filter(|sample| (60.0..100.0).contains(&sample.position));
            assert!(under_way.all(|sample| (-101.0..-20.0).contains(&sample.speed)));
            return;
        }
    }
    panic!("the machine paused in each attempt");
}

#[test]
fn fast_stop_by_another_client_ends_the_stream_for_good() {
    for script in scripts() {
        let (_server, address) = serve(script.clone(), None);
        let stream = start(address, &script);
        stream.set_speed_limit(MmPerS(20.0)).unwrap();
        stream.set_target(Mm(10.0)).unwrap();
        until("the start of the motion", || latest(&stream).position < 108.0);
        let mut other = host::connect(address).unwrap();
        other.fast_stop().unwrap();
        assert_eq!(ended(&stream).cause, Cause::FastStop);
        assert_eq!(stream.set_target(Mm(20.0)), Err(Rejected::Ended(Cause::FastStop)));
        other.acknowledge().unwrap();
        assert_standing(address);
    }
}

#[test]
fn acknowledged_stream_homes_and_waits_for_set_points() {
    for script in scripts() {
        let (_server, address) = serve(script.clone(), None);
        let stream = start(address, &script);
        let mut reader = stream.samples();
        stream.set_speed_limit(MmPerS(50.0)).unwrap();
        stream.set_target(Mm(20.0)).unwrap();
        until("motion", || latest(&stream).position < 105.0);
        stream.stop_handle().fast_stop().unwrap();
        let cause = ended(&stream).cause;
        assert_eq!(cause, Cause::Stopped(StopKind::FastStop));
        assert_eq!(stream.home(HomingDirection::Positive).err(), Some(Rejected::Ended(cause)));
        until("the end for the reader", || reader.next_within(PATIENCE) == Err(cause));

        stream.acknowledge().unwrap().recv_timeout(PATIENCE).unwrap().unwrap();
        samples(&stream, 20);
        assert_eq!((stream.ended(), latest(&stream).set_point), (None, None));
        assert!(reader.next_within(PATIENCE).unwrap().unwrap().position < 106.0);
        assert_standing(address);

        stream.set_target(Mm(20.0)).unwrap();
        until("motion", || latest(&stream).position < 95.0);
        let outcome = stream.home(HomingDirection::Positive).unwrap();
        assert_eq!(stream.set_target(Mm(50.0)), Err(Rejected::Busy));
        outcome.recv_timeout(PATIENCE).unwrap().unwrap();
        samples(&stream, 20);
        assert_eq!((latest(&stream).position, latest(&stream).set_point), (110.0, None));
        stream.set_target(Mm(100.0)).unwrap();
        reach(&stream, 100.0);
        assert_eq!(stream.end().1, ENDED_BY_CALLER);
    }
}

#[test]
fn stop_by_another_client_ends_the_stream() {
    for script in scripts() {
        let (_server, address) = serve(script.clone(), None);
        let stream = start(address, &script);
        stream.set_speed_limit(MmPerS(20.0)).unwrap();
        stream.set_target(Mm(10.0)).unwrap();
        let mut other = host::connect(address).unwrap();
        until("a Stop during a motion", || {
            // Without a script, a Stop between two motions ends nothing because the fingers are at rest.
            other.stop().unwrap();
            stream.ended().is_some()
        });
        assert_eq!(ended(&stream), End { cause: Cause::StoppedByOther, is_stop_confirmed: true });
        assert_standing(address);
    }
}

#[test]
fn stop_handle_or_drop_ends_the_stream_with_fingers_at_rest() {
    for script in scripts() {
        let (_server, address) = serve(script.clone(), None);
        let stream = start(address, &script);
        stream.set_target(Mm(10.0)).unwrap();
        stream.stop_handle().fast_stop().unwrap();
        assert_eq!(ended(&stream).cause, Cause::Stopped(StopKind::FastStop));
        let (mut gripper, _) = stream.end();
        gripper.acknowledge().unwrap();

        let stream = SetPointStream::start(gripper, Config::default()).unwrap();
        stream.set_target(Mm(100.0)).unwrap();
        samples(&stream, 3);
        drop(stream);
        assert!(!assert_standing(address).contains(SystemFlags::FAST_STOP));
    }
}

/// Returns a connection to the gripper that breaks without an announcement when the returned function is called.
fn breakable(address: SocketAddr) -> (SocketAddr, impl FnOnce()) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let (near_address, (sender, ends)) = (listener.local_addr().unwrap(), std::sync::mpsc::channel());
    thread::spawn(move || {
        let near = listener.accept().unwrap().0;
        let far = TcpStream::connect(address).unwrap();
        for socket in [&near, &far] {
            socket.set_nodelay(true).unwrap();
        }
        sender.send([near.try_clone().unwrap(), far.try_clone().unwrap()]).unwrap();
        let mut back = [far.try_clone().unwrap(), near.try_clone().unwrap()];
        thread::spawn(move || {
            let [from, to] = &mut back;
            io::copy(from, to)
        });
        io::copy(&mut &near, &mut &far)
    });
    let cut = move || ends.recv().unwrap().iter().for_each(|end| drop(end.shutdown(Shutdown::Both)));
    (near_address, cut)
}

#[test]
fn broken_connection_ends_the_stream_and_the_gripper_stops() {
    for script in scripts() {
        let (_server, address) = serve(script.clone(), None);
        let (near, cut) = breakable(address);
        let stream = start(near, &script);
        stream.set_speed_limit(MmPerS(20.0)).unwrap();
        stream.set_target(Mm(10.0)).unwrap();
        until("the start of the motion", || latest(&stream).position < 108.0);
        cut();
        let end = ended(&stream);
        assert!(matches!(end.cause, Cause::Closed | Cause::Transport(_)), "{end:?}");
        assert!(!end.is_stop_confirmed);
        until("FAST STOP", || assert_standing(address).contains(SystemFlags::FAST_STOP));
    }
}

#[test]
fn silent_line_ends_the_stream_at_the_end_of_a_segment() {
    let rig = VirtualRig::new(Sim::default());
    let mut gripper = Gripper::new(rig.line(), rig.clock());
    gripper.connect().unwrap();
    gripper.home(HomingDirection::Positive).unwrap();
    let stream = SetPointStream::start(gripper, Config::default()).unwrap();
    rig.cut_line();
    // Thread timing decides whether it is sent; it is never executed.
    let _ = stream.set_target(Mm(10.0));
    until("the end", || stream.ended().is_some());
    assert_eq!(stream.ended(), Some(End { cause: Cause::Unanswered, is_stop_confirmed: false }));
    assert_eq!(rig.state().width, 110.0);
}

#[test]
fn gripper_that_is_not_referenced_refuses_the_first_set_point() {
    for script in scripts() {
        let (_server, address) = serve(script.clone(), None);
        let mut gripper = host::connect(address).unwrap();
        if script.is_some() {
            until("a script", || gripper.raw(0xA5, &[], &mut [0; 32]).is_ok());
        }
        let stream = SetPointStream::start(gripper, Config::default()).unwrap();
        stream.set_target(Mm(10.0)).unwrap();
        assert_eq!(ended(&stream).cause, Cause::Refused(Status::NotInitialized));
    }
}

#[test]
fn script_error_ends_the_stream_with_the_fingers_standing() {
    let source = std::fs::read_to_string(ours().unwrap()).unwrap();
    let failing = "local position = mc.position\n\
        mc.position = function() if position() < 100 then error('no position') end return position() end\n";
    let file = std::env::temp_dir().join(format!("wsg-stream-{}.lua", std::process::id()));
    std::fs::write(&file, format!("{failing}{source}")).unwrap();
    let (_server, address) = serve(Some(file.clone()), None);
    let stream = start(address, &ours());
    std::fs::remove_file(file).unwrap();
    stream.set_target(Mm(50.0)).unwrap();
    assert_eq!(ended(&stream), End { cause: Cause::Script, is_stop_confirmed: true });
    assert_standing(address);
}

#[test]
fn script_stops_the_fingers_when_set_points_cease() {
    let (_server, address) = serve(ours(), None);
    let (mut gripper, _) = start(address, &ours()).end();
    let answer = &mut [0; 32];
    let set_point: Vec<u8> = [0.0_f32, 20.0, 10.0].iter().flat_map(|value| value.to_le_bytes()).collect();
    gripper.raw(0xA5, &[0], answer).unwrap();
    gripper.raw(0xA5, &set_point, answer).unwrap();
    until("the watchdog", || {
        let flags = gripper.system_state().unwrap();
        flags.contains(SystemFlags::AXIS_STOPPED) && !flags.contains(SystemFlags::MOVING)
    });
    assert!((90.0..109.0).contains(&gripper.width().unwrap().0));
    // Neither a late set-point nor a delay resumes it.
    let late = gripper.raw(0xA5, &set_point, answer);
    assert!(matches!(late, Err(Error::Refused(Status::Timeout))), "{late:?}");
    assert_standing(address);
    gripper.raw(0xA5, &[0], answer).unwrap();
    gripper.raw(0xA5, &set_point, answer).unwrap();
}

#[test]
fn script_holds_during_a_gap_until_the_next_set_point_or_stop() {
    let source = std::fs::read_to_string(ours().unwrap()).unwrap();
    let times = "local HOLD, WATCHDOG = 0.5, 1\n";
    assert!(source.contains(times));
    let file = std::env::temp_dir().join(format!("wsg-hold-{}.lua", std::process::id()));
    // The watchdog must not end the test on a slow machine.
    std::fs::write(&file, source.replace(times, "local HOLD, WATCHDOG = 0.1, 3600\n")).unwrap();
    let (_server, address) = serve(Some(file.clone()), None);
    let (mut gripper, _) = start(address, &ours()).end();
    std::fs::remove_file(file).unwrap();
    let answer = &mut [0; 32];
    let set_point: Vec<u8> = [0.0_f32, 20.0, 10.0].iter().flat_map(|value| value.to_le_bytes()).collect();
    gripper.raw(0xA5, &[0], answer).unwrap();
    for _ in 0..2 {
        gripper.raw(0xA5, &set_point, answer).unwrap();
        until("a motion", || gripper.system_state().unwrap().contains(SystemFlags::MOVING));
        until("the hold", || !gripper.system_state().unwrap().contains(SystemFlags::MOVING));
        assert!(!assert_standing(address).contains(SystemFlags::AXIS_STOPPED));
        assert!(gripper.width().unwrap().0 > 10.0);
    }
    host::connect(address).unwrap().stop().unwrap();
    let stopped = gripper.raw(0xA5, &set_point, answer);
    assert!(matches!(stopped, Err(Error::Refused(Status::CmdAborted))), "{stopped:?}");
    assert_standing(address);
}

#[test]
fn contact_is_limited_in_force_with_a_script() {
    let (_server, address) = serve(ours(), Part::of_width(20.0));
    let stream = start(address, &ours());
    stream.set_force_limit(N(20.0)).unwrap();
    stream.set_target(Mm(10.0)).unwrap();
    until("the force", || latest(&stream).force > 19.9);
    samples(&stream, 20);
    let contact = latest(&stream);
    assert!((19.9..20.1).contains(&contact.force), "{contact:?}");
    assert!(contact.flags.contains(SystemFlags::BLOCKED_MINUS) && contact.position > 15.0);

    stream.set_force_limit(N(40.0)).unwrap();
    until("more force", || latest(&stream).force > 39.9);
    assert!(stream.history().iter().all(|sample| sample.force < 40.1));
    stream.set_target(Mm(60.0)).unwrap();
    reach(&stream, 60.0);
    assert_eq!(latest(&stream).force, 0.0);
}

#[test]
fn contact_turns_the_motor_off_without_a_script() {
    let (_server, address) = serve(None, Part::of_width(20.0));
    let stream = start(address, &None);
    stream.set_force_limit(N(20.0)).unwrap();
    stream.set_target(Mm(10.0)).unwrap();
    until("contact", || latest(&stream).flags.contains(SystemFlags::BLOCKED_MINUS));
    samples(&stream, 20);
    let contact = latest(&stream);
    assert!((18.0..20.1).contains(&contact.position) && contact.force == 0.0, "{contact:?}");
    assert!(stream.history().iter().all(|sample| sample.force < 20.1));
    stream.set_target(Mm(60.0)).unwrap();
    reach(&stream, 60.0);
}

#[test]
fn script_with_the_messages_of_umi_is_recognised() {
    let example = script("examples/remote.lua");
    let (_server, address) = serve(Some(example), None);
    let stream = stream_at(address, Backend::UmiScript);
    stream.set_force_limit(N(20.0)).unwrap();
    stream.set_target(Mm(60.0)).unwrap();
    reach(&stream, 60.0);
    let mut other = host::connect(address).unwrap();
    other.fast_stop().unwrap();
    assert_eq!(ended(&stream).cause, Cause::FastStop);
    other.acknowledge().unwrap();
    assert_standing(address);
}

#[test]
fn two_grippers_stream_at_once_each_at_its_rate() {
    let served = [ours(), ours()].map(|script| serve(script, None));
    let streams = [0, 1].map(|at| start(served[at].1, &ours()));
    for (stream, position) in streams.iter().zip([30.0, 80.0]) {
        stream.set_target(Mm(position)).unwrap();
    }
    for (stream, position) in streams.iter().zip([30.0, 80.0]) {
        reach(stream, position);
        samples(stream, 100);
        let history = stream.history();
        let (now, last) = (stream.now(), history.last().unwrap().received_at);
        assert!(now.has_reached(last) && now.since(last) < PATIENCE.as_millis() as u32, "one clock for both");
        let mut periods: Vec<u32> =
            history.windows(2).map(|pair| pair[1].received_at.since(pair[0].received_at)).collect();
        periods.sort_unstable();
        // Require only half of them, because a busy machine may delay any of them.
        assert!((8..15).contains(&periods[periods.len() / 2]), "{periods:?}");
    }
}

#[test]
fn out_of_range_values_are_rejected_by_name_without_effect() {
    let (_server, address) = serve(ours(), None);
    let stream = start(address, &ours());
    let at = |ms| stream.now().plus(ms);
    for (rejected, text) in [
        (stream.set_target(Mm(110.5)), "width 110.5 mm is outside the gripper's limits, 0 to 110 mm"),
        (stream.set_target(Mm(-0.1)), "width -0.1 mm is"),
        (stream.set_target(Mm(f32::NAN)), "width NaN mm is"),
        (stream.schedule(Mm(f32::INFINITY), at(0)), "width inf mm is"),
        (stream.schedule(Mm(111.0), at(100)), "0 to 110 mm"),
        (stream.set_speed_limit(MmPerS(0.0)), "speed 0 mm/s is outside the gripper's limits, 5 to 420 mm/s"),
        (stream.set_speed_limit(MmPerS(500.0)), "speed 500 mm/s is"),
        (stream.set_force_limit(N(-1.0)), "force -1 N is outside the gripper's limits, 5 to 80 N"),
        (stream.set_force_limit(N(500.0)), "force 500 N is"),
        (stream.schedule(Mm(60.0), at(4_000_000)), "at most 3600 s "),
        (stream.schedule(Mm(60.0), at(1 << 31)), "at most 3600 s "),
    ] {
        let rejected = rejected.unwrap_err().to_string();
        assert!(rejected.contains(text), "{rejected}");
    }
    samples(&stream, 10);
    let sample = latest(&stream);
    assert_eq!((sample.position, sample.set_point), (110.0, None));
    let (mut gripper, end) = stream.end();
    assert_eq!((end, gripper.force_limit().unwrap()), (ENDED_BY_CALLER, N(40.0)));
}

#[test]
fn sample_is_current_or_reading_it_fails() {
    for script in scripts() {
        let (_server, address) = serve(script.clone(), None);
        let (near, cut) = breakable(address);
        let stream = start(near, &script);
        samples(&stream, 2);
        let sample = latest(&stream);
        assert!(sample.age_ms(stream.now()) < PATIENCE.as_millis() as u32);
        assert!(sample.age_ms(stream.now().plus(250)) >= 250);
        cut();
        let end = ended(&stream);
        assert_eq!(stream.latest(), Err(end.cause));
        // The recorded samples remain, with their times.
        assert!(stream.history().len() >= 2);
    }
}
