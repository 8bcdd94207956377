//! Values outside the limits of the gripper are refused before anything is sent, and known values end with the connection.

use std::mem::MaybeUninit;
use std::ptr;

use wsg::config::{wsg_config_default, wsg_config_t};
use wsg::known::*;
use wsg::request::*;
use wsg::session::*;
use wsg::wsg_error;
use wsg_protocol::CommandId;
use wsg_sim::{Config, MAX_FRAME_LEN, PortId, PortKind, Time, VirtualGripper};

/// Time without a line after which a lost connection must show, in milliseconds.
const LOST_MS: u32 = 1_000;

/// A session and a virtual gripper, in virtual time.
struct Rig {
    wsg: Box<MaybeUninit<wsg_t>>,
    gripper: VirtualGripper,
    port: PortId,
    now: u32,
    /// Ids of the messages from the session.
    sent: Vec<u8>,
}

impl Rig {
    fn connected() -> Self {
        let mut wsg = Box::new(MaybeUninit::uninit());
        let mut config = MaybeUninit::uninit();
        assert_eq!(wsg_config_default(Some(&mut config)), 0);
        // Otherwise the force limit is not known.
        let config = wsg_config_t { verify_settings: 1, ..unsafe { config.assume_init() } };
        assert_eq!(unsafe { wsg_init(Some(&mut wsg), Some(&config), None, ptr::null_mut()) }, 0);
        let mut gripper = VirtualGripper::new(Config::default());
        let port = gripper.connect(PortKind::Serial).unwrap();
        let mut rig = Self { wsg, gripper, port, now: 0, sent: vec![] };
        rig.pass(1_000);
        assert_eq!(rig.known().connected, 1);
        rig
    }

    fn wsg(&mut self) -> Option<&mut wsg_t> {
        Some(unsafe { self.wsg.assume_init_mut() })
    }

    fn known(&mut self) -> wsg_known_t {
        let mut known = MaybeUninit::uninit();
        assert_eq!(wsg_known(self.wsg().as_deref(), Some(&mut known)), 0);
        unsafe { known.assume_init() }
    }

    /// Returns the next message to send, or nothing.
    fn transmit(&mut self) -> Vec<u8> {
        let (mut message, now) = ([0; WSG_TRANSMIT_LEN], self.now);
        let length = unsafe { wsg_transmit(self.wsg.as_mut_ptr(), now, message.as_mut_ptr(), message.len()) };
        message[..usize::try_from(length).unwrap()].to_vec()
    }

    fn pass(&mut self, ms: u32) {
        for _ in 0..ms {
            self.now += 1;
            let now = Time::from_millis(self.now.into());
            assert_eq!(unsafe { wsg_tick(self.wsg.as_mut_ptr(), self.now) }, 0);
            loop {
                let message = self.transmit();
                let Some(id) = message.get(3) else { break };
                self.sent.push(*id);
                self.gripper.receive(self.port, now, &message);
            }
            self.gripper.advance(now);
            let mut buffer = [0; MAX_FRAME_LEN];
            while let Some(frame) = self.gripper.transmit(self.port, &mut buffer) {
                let taken =
                    unsafe { wsg_receive(self.wsg.as_mut_ptr(), self.now, frame.as_ptr(), frame.len()) };
                assert_eq!(taken, 0);
            }
        }
    }

    /// Lets time pass without a line.
    fn pass_cut(&mut self, ms: u32) {
        for _ in 0..ms {
            self.now += 1;
            assert_eq!(unsafe { wsg_tick(self.wsg.as_mut_ptr(), self.now) }, 0);
            while !self.transmit().is_empty() {}
        }
    }
}

type Request = fn(Option<&mut wsg_t>) -> i32;

#[test]
fn value_outside_the_limits_is_refused_and_nothing_is_sent() {
    let mut rig = Rig::connected();
    let limits = rig.known().limits;
    assert_eq!((limits.stroke, limits.min_speed, limits.max_speed), (110.0, 5.0, 420.0));
    assert_eq!((limits.min_force, limits.nominal_force, limits.overdrive_force), (5.0, 80.0, 120.0));
    assert_eq!(wsg_set_force_limit(rig.wsg(), 40.0), 0);
    rig.pass(100);
    let refused: [(&str, Request); 16] = [
        ("force 500 N", |wsg| wsg_set_force_limit(wsg, 500.0)),
        ("force 81 N without overdrive", |wsg| wsg_set_force_limit(wsg, 81.0)),
        ("force -1 N", |wsg| wsg_set_force_limit(wsg, -1.0)),
        ("force 4 N", |wsg| wsg_set_force_limit(wsg, 4.0)),
        ("acceleration 99999", |wsg| wsg_set_acceleration(wsg, 99_999.0)),
        ("acceleration 0", |wsg| wsg_set_acceleration(wsg, 0.0)),
        ("grip at 111 mm", |wsg| wsg_grip_part(wsg, 111.0, 100.0)),
        ("grip at 500 mm/s", |wsg| wsg_grip_part(wsg, 20.0, 500.0)),
        ("release at -1 mm", |wsg| wsg_release_part(wsg, -1.0, 100.0)),
        ("release at 1 mm/s", |wsg| wsg_release_part(wsg, 50.0, 1.0)),
        ("move to 200 mm", |wsg| wsg_pre_position(wsg, 0, 200.0, 100.0)),
        ("move at -50 mm/s", |wsg| wsg_pre_position(wsg, 0, 50.0, -50.0)),
        ("move by 111 mm", |wsg| wsg_pre_position(wsg, WSG_RELATIVE, 111.0, 100.0)),
        ("move by -111 mm", |wsg| wsg_pre_position(wsg, WSG_RELATIVE, -111.0, 100.0)),
        ("soft limits -5 to 90 mm", |wsg| wsg_set_soft_limits(wsg, -5.0, 90.0)),
        ("soft limits 90 to 20 mm", |wsg| wsg_set_soft_limits(wsg, 90.0, 20.0)),
    ];
    for (what, request) in refused {
        rig.sent.clear();
        assert_eq!(request(rig.wsg()), wsg_error::OutOfLimits as i32, "{what}");
        rig.pass(100);
        for id in [0x21, 0x25, 0x26, 0x30, 0x32, 0x34] {
            assert!(!rig.sent.contains(&id), "{what}: {}", CommandId::from_code(id).name());
        }
        assert_eq!(rig.known().force_limit, 40.0, "{what}");
    }
    assert_eq!(wsg_set_force_limit(rig.wsg(), f32::NAN), wsg_error::NotFinite as i32);
}

#[test]
fn values_at_the_limits_are_sent() {
    let accepted: [(u8, Request); 8] = [
        (0x32, |wsg| wsg_set_force_limit(wsg, 80.0)),
        (0x32, |wsg| wsg_set_force_limit(wsg, 5.0)),
        (0x30, |wsg| wsg_set_acceleration(wsg, 5_000.0)),
        (0x25, |wsg| wsg_grip_part(wsg, 110.0, 420.0)),
        (0x26, |wsg| wsg_release_part(wsg, 0.0, 5.0)),
        (0x21, |wsg| wsg_pre_position(wsg, WSG_RELATIVE, 50.0, 100.0)),
        (0x34, |wsg| wsg_set_soft_limits(wsg, 0.0, 110.0)),
        (0x22, |wsg| wsg_stop(wsg)),
    ];
    let mut rig = Rig::connected();
    for (id, request) in accepted {
        rig.sent.clear();
        assert_eq!(request(rig.wsg()), 0, "{id:02X}h");
        rig.pass(100);
        assert!(rig.sent.contains(&id), "{id:02X}h");
    }
    assert_eq!(wsg_overdrive_mode(rig.wsg(), 1), 0);
    rig.pass(500);
    assert_eq!(wsg_set_force_limit(rig.wsg(), 120.0), 0);
    rig.pass(500);
    assert_eq!(rig.known().force_limit, 120.0);
    assert_eq!(wsg_set_force_limit(rig.wsg(), 121.0), wsg_error::OutOfLimits as i32);
}

#[test]
fn relative_motion_to_a_target_outside_the_stroke_is_refused() {
    let mut rig = Rig::connected();
    assert_eq!(wsg_subscribe(rig.wsg(), 0x43, 10, 0), 0);
    assert_eq!(wsg_homing(rig.wsg(), WSG_HOMING_DEFAULT), 0);
    rig.pass(10_000);
    assert_eq!(wsg_pre_position(rig.wsg(), 0, 60.0, 400.0), 0);
    rig.pass(2_000);
    let width = rig.known().width;
    assert!((59.0..61.0).contains(&width), "{width}");
    for offset in [110.0 - width + 1.0, -width - 1.0] {
        let moved = wsg_pre_position(rig.wsg(), WSG_RELATIVE, offset, 100.0);
        assert_eq!(moved, wsg_error::OutOfLimits as i32, "{offset}");
    }
    assert_eq!(wsg_pre_position(rig.wsg(), WSG_RELATIVE, 110.0 - width, 100.0), 0);
}

#[test]
fn known_values_end_with_the_connection() {
    let mut rig = Rig::connected();
    assert_eq!(wsg_subscribe(rig.wsg(), 0x43, 10, 0), 0);
    rig.pass(200);
    let all = WSG_KNOWN_LIMITS | WSG_KNOWN_FLAGS | WSG_KNOWN_STATE | WSG_KNOWN_WIDTH;
    assert_eq!(rig.known().valid & all, all);
    rig.pass_cut(LOST_MS);
    let lost = rig.known();
    assert_eq!((lost.connected, lost.valid), (0, 0));
    assert_eq!(wsg_get_opening_width(rig.wsg()), wsg_error::NotConnected as i32);
    assert_eq!(wsg_set_force_limit(rig.wsg(), 40.0), wsg_error::NotConnected as i32);
}

#[test]
fn updates_faster_than_the_gripper_permits_are_refused() {
    let mut rig = Rig::connected();
    for period_ms in [1, 9] {
        assert_eq!(wsg_subscribe(rig.wsg(), 0x43, period_ms, 0), wsg_error::Argument as i32);
    }
    assert_eq!(wsg_subscribe(rig.wsg(), 0x43, 10, 1), 0);
}
