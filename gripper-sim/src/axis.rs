//! The mechanics: two fingers on one axis, a trapezoidal speed profile, end stops, and a part that yields like a
//! spring, from outside and, if it is hollow, from inside. Independent of commands and states.
//!
//! Widths are opening widths in mm, from 0 (closed) to the stroke. Speeds are their rate of change in mm/s, negative
//! while the fingers close. Forces are in N, summed over both fingers.

/// Tolerance in mm below which a distance counts as zero.
const NOTHING: f64 = 1e-9;
/// Seconds in which the drive builds up its force against a rigid obstacle. Assumed.
const BUILD_UP_S: f64 = 0.05;

/// A moving direction of the fingers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Negative: the fingers close.
    Minus,
    /// Positive: the fingers open.
    Plus,
}

impl Direction {
    /// Returns the direction of a change in width.
    pub(crate) fn of(change: f64) -> Self {
        if change > 0.0 { Self::Plus } else { Self::Minus }
    }

    pub(crate) const fn sign(self) -> f64 {
        match self {
            Self::Minus => -1.0,
            Self::Plus => 1.0,
        }
    }
}

/// A part, with its width and stiffness, and the inner width of a hollow one. It is gripped from outside, or by outward
/// fingers from inside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    width: f32,
    stiffness: f32,
    inner_width: Option<f32>,
}

impl Part {
    /// Default stiffness in N/mm.
    pub const DEFAULT_STIFFNESS: f32 = 100.0;

    /// Returns a part of this width in mm and this stiffness in N/mm; `None` unless both are finite and above 0.
    #[must_use]
    pub fn new(width: f32, stiffness: f32) -> Option<Self> {
        let sensible = |value: f32| value.is_finite() && value > 0.0;
        (sensible(width) && sensible(stiffness)).then_some(Self { width, stiffness, inner_width: None })
    }

    /// Returns the same part with a hole of this width in mm; `None` unless it is above 0 and below the part's own width.
    ///
    /// ```
    /// use wsg_sim::Part;
    ///
    /// let ring = Part::of_width(80.0).and_then(|part| part.with_inner_width(60.0)).unwrap();
    /// assert_eq!((ring.width(), ring.inner_width()), (80.0, Some(60.0)));
    /// assert_eq!(ring.with_inner_width(80.0), None);
    /// ```
    #[must_use]
    pub fn with_inner_width(self, inner_width: f32) -> Option<Self> {
        let fits = inner_width > 0.0 && inner_width < self.width;
        fits.then_some(Self { inner_width: Some(inner_width), ..self })
    }

    /// Returns a part of this width in mm and the [default stiffness](Self::DEFAULT_STIFFNESS).
    #[must_use]
    pub fn of_width(width: f32) -> Option<Self> {
        Self::new(width, Self::DEFAULT_STIFFNESS)
    }

    /// Returns the width in mm, not squeezed.
    #[must_use]
    pub const fn width(&self) -> f32 {
        self.width
    }

    /// Returns the stiffness in N/mm.
    #[must_use]
    pub const fn stiffness(&self) -> f32 {
        self.stiffness
    }

    /// Returns the width of the hole in mm, not widened; `None` for a solid part.
    #[must_use]
    pub const fn inner_width(&self) -> Option<f32> {
        self.inner_width
    }

    /// Returns by how much `force` in N squeezes or widens the part, in mm.
    fn yields(&self, force: f64) -> f64 {
        force / f64::from(self.stiffness)
    }
}

/// A command to the drive: target, speed profile and force limits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Travel {
    pub(crate) target: f64,
    pub(crate) speed: f64,
    pub(crate) acceleration: f64,
    /// Force limit in N against a rigid obstacle.
    pub(crate) force: f64,
    /// Force limit in N against a part.
    pub(crate) squeeze: f64,
}

/// The kind of obstacle in the way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Obstacle {
    EndStop,
    Part,
    Jam,
}

/// A block: the fingers push against an obstacle and make no progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Block {
    pub(crate) direction: Direction,
    pub(crate) obstacle: Obstacle,
}

/// Where the part is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// It waits: it is wider than the opening, and its hole, if any, is narrower.
    Away,
    /// The fingers are outside of the part and can close on it.
    Between,
    /// The fingers are in its hole and can open against it.
    Around,
}

/// The axis with the part between its fingers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Axis {
    stroke: f64,
    /// Speed in mm/s at which a squeezed part pushes idle fingers open.
    spring_back_speed: f64,
    width: f64,
    speed: f64,
    /// The active travel; `None` while the motor is off.
    drive: Option<Travel>,
    part: Option<Part>,
    place: Place,
    jammed: bool,
    block: Option<Block>,
    /// Force in N against an end stop or a jam, rising to the force limit.
    push: f64,
}

impl Axis {
    /// Returns an axis at half of its stroke with its motor off.
    pub(crate) fn new(stroke: f64, spring_back_speed: f64, part: Option<Part>) -> Self {
        let mut axis = Self {
            stroke,
            spring_back_speed,
            width: stroke / 2.0,
            speed: 0.0,
            drive: None,
            part: None,
            place: Place::Away,
            jammed: false,
            block: None,
            push: 0.0,
        };
        axis.set_part(part);
        axis
    }

    /// Returns the real opening width in mm.
    pub(crate) const fn width(&self) -> f64 {
        self.width
    }

    /// Returns the change of the opening width in mm/s.
    pub(crate) const fn speed(&self) -> f64 {
        self.speed
    }

    pub(crate) const fn part(&self) -> Option<Part> {
        self.part
    }

    pub(crate) const fn part_is_between(&self) -> bool {
        !matches!(self.place, Place::Away)
    }

    pub(crate) const fn part_is_around(&self) -> bool {
        matches!(self.place, Place::Around)
    }

    pub(crate) const fn block(&self) -> Option<Block> {
        self.block
    }

    /// Returns the force on the fingers in N, summed over both: 0 while the motor is off, when the fingers yield to a squeezed part.
    pub(crate) fn force(&self) -> f64 {
        match (self.drive, self.block) {
            (None, _) => 0.0,
            (_, Some(Block { obstacle: Obstacle::EndStop | Obstacle::Jam, .. })) => self.push,
            _ => self.penetration() * self.part.map_or(0.0, |part| f64::from(part.stiffness)),
        }
    }

    /// Starts a travel from rest. A block in the same direction stays known unless the new force overcomes it.
    pub(crate) fn start(&mut self, travel: Travel) {
        self.push = self.force().min(travel.force);
        self.drive = Some(travel);
        self.speed = 0.0;
        let direction = Direction::of(travel.target - self.width);
        let is_blocked = !self.has_arrived() && self.room().is_some_and(|room| room <= NOTHING);
        self.block = self.block.filter(|block| is_blocked && block.direction == direction);
    }

    /// Sets the speed at which the active travel begins, if it has this direction: it replaces another travel.
    pub(crate) fn keep_speed(&mut self, speed: f64) {
        if self.drive.is_some_and(|travel| (travel.target - self.width) * speed > 0.0) {
            self.speed = speed;
        }
    }

    /// Changes the target of the active travel.
    pub(crate) fn retarget(&mut self, target: f64) {
        if let Some(travel) = &mut self.drive {
            travel.target = target;
        }
    }

    /// Ends all motion and force but keeps the block known.
    pub(crate) const fn switch_off(&mut self) {
        self.drive = None;
        self.speed = 0.0;
    }

    /// Ends all motion and force, and forgets the block.
    pub(crate) const fn halt(&mut self) {
        self.switch_off();
        self.block = None;
    }

    /// Ends all motion and force exactly at `width`, which lies between the previous position and the current one.
    pub(crate) fn halt_at(&mut self, width: f64) {
        self.halt();
        self.width = width.max(0.0).min(self.stroke);
    }

    /// Returns whether the drive is at its target.
    pub(crate) fn has_arrived(&self) -> bool {
        self.drive.is_some_and(|travel| (travel.target - self.width).abs() <= NOTHING)
    }

    /// Returns whether the drive moves the fingers.
    pub(crate) fn is_moving(&self) -> bool {
        self.drive.is_some() && self.block.is_none() && !self.has_arrived()
    }

    /// Returns whether the drive is still building up its force against an obstacle.
    pub(crate) fn builds_up(&self) -> bool {
        let is_rigid = self.block.is_some_and(|block| block.obstacle != Obstacle::Part);
        is_rigid && self.drive.is_some_and(|travel| self.push < travel.force)
    }

    /// Returns whether a step changes anything.
    pub(crate) fn is_active(&self) -> bool {
        self.is_moving() || self.builds_up() || self.room().unwrap_or(-self.penetration()) < -NOTHING
    }

    /// Places a part between the fingers, or removes it. A part wider than the opening enters once the fingers have
    /// opened far enough, or closed enough to enter its hole.
    pub(crate) fn set_part(&mut self, part: Option<Part>) {
        self.part = part;
        self.place = Place::Away;
        self.seat_part();
        self.forget_block_that_is_gone();
    }

    pub(crate) fn set_jammed(&mut self, jammed: bool) {
        self.jammed = jammed;
        self.forget_block_that_is_gone();
    }

    /// Advances the mechanics by `seconds`, at most a few milliseconds.
    pub(crate) fn step(&mut self, seconds: f64) {
        match self.drive {
            Some(travel) => self.travel(travel, seconds),
            None => self.spring_back(self.penetration(), seconds),
        }
        self.seat_part();
    }

    fn travel(&mut self, travel: Travel, seconds: f64) {
        let distance = (travel.target - self.width).abs();
        if distance <= NOTHING {
            self.speed = 0.0;
            return;
        }
        let direction = Direction::of(travel.target - self.width);
        let (limit, obstacle) = self.limit(direction, &travel);
        let room = (limit - self.width) * direction.sign();
        if room <= NOTHING {
            if room < 0.0 {
                self.spring_back(-room, seconds);
            } else {
                self.width = limit;
            }
            self.meet(Block { direction, obstacle }, &travel);
            self.push = (self.push + travel.force * seconds / BUILD_UP_S).min(travel.force);
            return;
        }
        let (advance, speed) = profile(distance, self.speed.abs(), &travel, seconds);
        if advance >= room && room < distance - NOTHING {
            self.width = limit;
            self.meet(Block { direction, obstacle }, &travel);
        } else if advance >= distance - NOTHING {
            self.width = travel.target;
            self.speed = 0.0;
        } else {
            self.width += direction.sign() * advance;
            self.speed = direction.sign() * speed;
        }
    }

    /// Records a block. The force on a rigid obstacle starts from the present force.
    fn meet(&mut self, block: Block, travel: &Travel) {
        if self.block.is_none_or(|before| before.obstacle != block.obstacle) {
            self.push = self.force().min(travel.force);
        }
        self.block = Some(block);
        self.speed = 0.0;
    }

    /// Lets the part push the fingers out of it, by `distance` at most.
    fn spring_back(&mut self, distance: f64, seconds: f64) {
        let outwards = if self.place == Place::Around { Direction::Minus } else { Direction::Plus };
        self.width += outwards.sign() * distance.min(self.spring_back_speed * seconds);
    }

    /// Returns the furthest width in this direction that the drive reaches with its force, and the obstacle there.
    fn limit(&self, direction: Direction, travel: &Travel) -> (f64, Obstacle) {
        if self.jammed {
            return (self.width, Obstacle::Jam);
        }
        let end = match direction {
            Direction::Plus => self.stroke,
            Direction::Minus => 0.0,
        };
        let part = self.surface().filter(|(facing, ..)| *facing == direction);
        let held = part.map(|(_, surface, part)| surface + direction.sign() * part.yields(travel.squeeze));
        match held.filter(|held| (end - held) * direction.sign() > 0.0) {
            Some(held) => (held, Obstacle::Part),
            None => (end, Obstacle::EndStop),
        }
    }

    /// Returns the part's surface that the fingers face: the direction in which they push against it, its width in mm, and
    /// the part.
    fn surface(&self) -> Option<(Direction, f64, Part)> {
        let part = self.part?;
        match self.place {
            Place::Away => None,
            Place::Between => Some((Direction::Minus, part.width.into(), part)),
            Place::Around => Some((Direction::Plus, part.inner_width?.into(), part)),
        }
    }

    /// Returns the remaining travel in mm; negative when the fingers are deeper in the part than the force allows.
    fn room(&self) -> Option<f64> {
        let travel = self.drive?;
        let direction = Direction::of(travel.target - self.width);
        Some((self.limit(direction, &travel).0 - self.width) * direction.sign())
    }

    /// Returns how deep the fingers are in the part, in mm.
    pub(crate) fn penetration(&self) -> f64 {
        // Not `max`, whose result for -0.0 and 0.0 depends on the processor, and would be a different byte in a frame.
        self.depth().filter(|depth| *depth > 0.0).unwrap_or(0.0)
    }

    /// Returns how far the fingers are beyond the part's surface, in mm; negative while they do not touch it.
    fn depth(&self) -> Option<f64> {
        let (direction, surface, _) = self.surface()?;
        Some((self.width - surface) * direction.sign())
    }

    fn seat_part(&mut self) {
        let Some(part) = self.part.filter(|_| self.place == Place::Away) else { return };
        if self.width >= f64::from(part.width) {
            self.place = Place::Between;
        } else if part.inner_width.is_some_and(|inner| self.width <= f64::from(inner)) {
            self.place = Place::Around;
        }
    }

    fn forget_block_that_is_gone(&mut self) {
        let Some(block) = self.block else { return };
        let still_there = match block.obstacle {
            Obstacle::EndStop => true,
            Obstacle::Jam => self.jammed,
            Obstacle::Part => match self.room() {
                // A jammed axis has no room in either direction.
                Some(room) => room <= NOTHING && self.penetration() > 0.0,
                None => self.depth().is_some_and(|depth| depth >= 0.0),
            },
        };
        if !still_there {
            self.block = None;
        }
    }
}

/// Returns how far the fingers get in `seconds` with `distance` to go, and their speed then. They accelerate, hold
/// their speed, or brake to come to rest at the target.
fn profile(distance: f64, speed: f64, travel: &Travel, seconds: f64) -> (f64, f64) {
    let can_stop =
        |speed: f64, advance: f64| speed * speed <= 2.0 * travel.acceleration * (distance - advance);
    let faster = (speed + travel.acceleration * seconds).min(travel.speed);
    for next in [faster, speed] {
        let advance = (speed + next) / 2.0 * seconds;
        if next > 0.0 && can_stop(next, advance) {
            return (advance, next);
        }
    }
    // Braking that ends exactly at the target: v² / 2d, without a square root.
    let next = speed - speed * speed / (2.0 * distance) * seconds;
    if next <= 0.0 || speed <= 0.0 {
        return (distance, 0.0);
    }
    (((speed + next) / 2.0 * seconds).min(distance), next)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f64 = 0.001;
    const TRAVEL: Travel =
        Travel { target: 10.0, speed: 100.0, acceleration: 1_000.0, force: 40.0, squeeze: 40.0 };

    fn axis(part: Option<Part>) -> Axis {
        Axis::new(110.0, 420.0, part)
    }

    fn run(axis: &mut Axis) -> u32 {
        let mut steps = 0;
        while axis.is_active() {
            axis.step(STEP);
            steps += 1;
            assert!(steps < 100_000, "the axis did not come to rest: {axis:?}");
        }
        steps
    }

    fn travel(axis: &mut Axis, travel: Travel) {
        axis.start(travel);
        run(axis);
    }

    #[test]
    fn speed_and_acceleration_stay_within_their_limits() {
        let mut axis = axis(None);
        axis.start(TRAVEL);
        let mut before = 0.0;
        while axis.is_moving() {
            axis.step(STEP);
            assert!(axis.speed().abs() <= TRAVEL.speed);
            assert!(
                (axis.speed() - before).abs() <= TRAVEL.acceleration * STEP * 1.1 + 1e-6 || !axis.is_moving()
            );
            before = axis.speed();
        }
    }

    #[test]
    fn force_grows_with_penetration_up_to_the_limit() {
        let mut axis = axis(Part::new(20.0, 50.0));
        axis.start(TRAVEL);
        let mut forces = [0.0; 3];
        while axis.is_active() {
            axis.step(STEP);
            forces = [forces[1], forces[2], axis.force()];
        }
        assert!(forces[0] < forces[1] && forces[1] < forces[2], "{forces:?}");
        assert!((axis.force() - 40.0).abs() < 1e-9);
        assert!((axis.width() - 19.2).abs() < 1e-9);
        assert_eq!(axis.block(), Some(Block { direction: Direction::Minus, obstacle: Obstacle::Part }));
    }

    #[test]
    fn idle_fingers_yield_to_the_part_without_force() {
        let mut axis = axis(Part::new(20.0, 10.0));
        travel(&mut axis, TRAVEL);
        axis.halt();
        assert_eq!((axis.width(), axis.force()), (16.0, 0.0));
        let steps = run(&mut axis);
        assert!(steps <= 12, "{steps} ms");
        assert_eq!((axis.width(), axis.force()), (20.0, 0.0));
    }

    const OPENING: Travel = Travel { target: 100.0, ..TRAVEL };

    /// A part of 80 mm with a hole of 60 mm, which the fingers at half stroke are in.
    fn ring(stiffness: f32) -> Option<Part> {
        Part::new(80.0, stiffness).and_then(|part| part.with_inner_width(60.0))
    }

    #[test]
    fn hollow_part_is_held_from_inside_and_pushes_idle_fingers_back() {
        let mut axis = axis(ring(10.0));
        travel(&mut axis, OPENING);
        assert_eq!((axis.width(), axis.force()), (64.0, 40.0));
        assert_eq!(axis.block(), Some(Block { direction: Direction::Plus, obstacle: Obstacle::Part }));
        axis.halt();
        assert_eq!(axis.force(), 0.0);
        run(&mut axis);
        assert_eq!((axis.width(), axis.force()), (60.0, 0.0));
        // Nothing is in the way of closing fingers.
        travel(&mut axis, Travel { target: 0.0, ..TRAVEL });
        assert_eq!((axis.width(), axis.block()), (0.0, None));
    }

    #[test]
    fn only_narrower_fingers_enter_the_hole_of_a_part() {
        let mut wide = axis(None);
        travel(&mut wide, OPENING);
        wide.set_part(ring(10.0));
        travel(&mut wide, TRAVEL);
        assert_eq!((wide.width(), wide.force()), (76.0, 40.0));

        let mut waiting = axis(None);
        travel(&mut waiting, Travel { target: 70.0, ..TRAVEL });
        waiting.set_part(ring(10.0));
        assert!(!waiting.part_is_between(), "neither in its hole nor outside of it");
        travel(&mut waiting, Travel { target: 50.0, ..TRAVEL });
        assert!(waiting.part_is_between() && wide.part_is_between());
        assert!(waiting.part_is_around() && !wide.part_is_around());
        travel(&mut waiting, OPENING);
        assert_eq!((waiting.width(), waiting.force()), (64.0, 40.0));
    }

    #[test]
    fn removed_or_soft_hollow_part_does_not_block_the_fingers() {
        let mut axis = axis(ring(10.0));
        travel(&mut axis, OPENING);
        axis.set_part(None);
        assert_eq!((axis.block(), axis.force()), (None, 0.0));
        run(&mut axis);
        assert_eq!(axis.width(), 100.0);
        let mut axis = self::axis(ring(0.5));
        travel(&mut axis, Travel { target: 500.0, ..TRAVEL });
        assert_eq!(axis.block(), Some(Block { direction: Direction::Plus, obstacle: Obstacle::EndStop }));
    }

    #[test]
    fn part_wider_than_the_opening_waits_outside() {
        let mut axis = axis(Part::of_width(80.0));
        assert_eq!((axis.width(), axis.force()), (55.0, 0.0));
        travel(&mut axis, Travel { target: 100.0, ..TRAVEL });
        travel(&mut axis, TRAVEL);
        assert!((axis.width() - 79.6).abs() < 1e-9, "{}", axis.width());
    }

    #[test]
    fn end_stops_hold_the_fingers_inside_the_stroke() {
        for (target, stop) in [(-50.0, 0.0), (500.0, 110.0)] {
            let mut axis = axis(None);
            travel(&mut axis, Travel { target, ..TRAVEL });
            assert_eq!(axis.width(), stop);
            assert_eq!(axis.force(), 40.0);
        }
    }
}
