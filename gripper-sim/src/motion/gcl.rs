//! GRIP and RELEASE of the text protocol, which differ from Grip Part and Release Part (GCL, 2.2.3 and 2.2.4).

use super::{BEYOND_THE_END, EarlyBlock, Grip, MotionControl};
use crate::axis::Direction;
use crate::port::Request;
use wsg_protocol::{GripperState, Status};

/// A GRIP request with its defaults filled in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GripOrder {
    /// Force in N, summed over both fingers.
    pub(crate) force: f32,
    /// Nominal width of the part in mm; `None`: close the fingers until they meet an obstacle.
    pub(crate) width: Option<f32>,
    /// Speed of the fingers in mm/s.
    pub(crate) speed: f32,
    /// Part width tolerance in mm.
    pub(crate) tolerance: f32,
    /// Clamping travel in mm.
    pub(crate) clamping_travel: f32,
}

impl MotionControl {
    /// Executes GRIP (GCL, 2.2.3). A block before the tolerance is a separate error. Without a width, any block counts
    /// as a part, the end stop included.
    pub(crate) fn start_grip_by(&mut self, request: Request, order: GripOrder) -> Status {
        if let Err(refused) = self.may_move() {
            return refused;
        }
        // A GRIP cannot follow another one whose outcome stands; RELEASE must come first (GCL, 2.2.3).
        if matches!(self.state, GripperState::Holding | GripperState::NoPart | GripperState::PartLost) {
            return Status::AlreadyRunning;
        }
        let least = self.settings.soft_limits().map_or(0.0, |limits| f64::from(limits.minus).max(0.0));
        let nominal = order.width.map_or(least, f64::from);
        if let Err(refused) = self.may_go_to(nominal) {
            return refused;
        }
        let nominal = nominal.max(0.0).min(self.stroke());
        let clamping_travel = f64::from(order.clamping_travel);
        let (direction, tolerance, end) = match order.width {
            Some(_) => {
                let direction = Direction::of(nominal - self.width());
                let end = self.clamping_end(direction, nominal, clamping_travel);
                (direction, order.tolerance.into(), end)
            }
            // The target lies in the end stop, so that the drive pushes against it, but never beyond a soft limit.
            None if self.settings.soft_limits().is_none() => {
                (Direction::Minus, f64::INFINITY, -BEYOND_THE_END)
            }
            None => (Direction::Minus, f64::INFINITY, least),
        };
        let travel = self.travel(end, order.speed, order.force.into());
        let grip = Grip {
            direction,
            nominal,
            end,
            met: false,
            tolerance,
            clamping_travel,
            early_block: EarlyBlock::AxisBlocked,
        };
        self.start_gripping(request, grip, travel)
    }

    /// Executes RELEASE (GCL, 2.2.4): moves by a distance away from the part, and only after a grip.
    pub(crate) fn start_release_by(&mut self, request: Request, distance: f32, speed: f32) -> Status {
        if let Err(refused) = self.may_move() {
            return refused;
        }
        let Some(direction) = self.grip_direction else { return Status::NotAvailable };
        if distance < 0.0 {
            return Status::RangeError;
        }
        let target = self.width() - direction.sign() * f64::from(distance);
        self.release_to(request, target, speed)
    }
}
