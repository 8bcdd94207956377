//! Which request or subscription a reply belongs to.

use super::{Engine, Link, Running, Upkeep};
use crate::command::Kind;
use crate::session::dialect::{Dialect, NameOf, Role};
use crate::session::message::{Message, Name};
use crate::session::subscriptions::List;
use crate::session::transaction::Request;
use crate::time::Instant;
use crate::types::Status;

/// The recipient of a reply and its meaning.
pub(super) enum Routed<M: Message> {
    /// No recipient: the reply is unsolicited or too late.
    Unsolicited,
    /// The session itself.
    Taken,
    /// The session; all setup steps are complete.
    Connected,
    /// A request that has begun.
    Pending(M::Name),
    /// A request; this is its final reply.
    Answered,
    /// This setting, which was read back by a query that was opened at this time.
    ReadBack(M, Instant),
    /// A subscriber, if the reply contains a value.
    Reported,
}

impl<D: Dialect> Engine<D> {
    /// Determines the recipient of a reply.
    pub(super) fn route(&mut self, now: Instant, answer: &D::Answer<'_>) -> Routed<D::Request> {
        let Some(name) = D::name(answer) else { return Routed::Unsolicited };
        let value = D::value(answer);
        if let Some(value) = value {
            self.learn(now, value);
        }
        let has_value = value.is_some();
        match D::role(answer) {
            Role::Update if self.wants(name, has_value) => {
                // Updates already arrive while the next setup step is in progress.
                if self.is_connected() { Routed::Reported } else { Routed::Taken }
            }
            Role::Update => Routed::Unsolicited,
            Role::Result if self.end_running(name) => Routed::Answered,
            // Without a preceding E_CMD_PENDING, this is the late result of an earlier motion.
            Role::Result => Routed::Unsolicited,
            Role::Answer => self.route_answer(now, name, answer).unwrap_or(Routed::Unsolicited),
            Role::Any => match self.route_answer(now, name, answer) {
                Some(routed) => routed,
                None if self.is_connected() && self.wants(name, has_value) => Routed::Reported,
                None => Routed::Unsolicited,
            },
        }
    }

    /// Returns whether a value is present and a subscription with this name exists.
    fn wants(&self, name: NameOf<D>, has_value: bool) -> bool {
        has_value && self.subscriptions.wants(name)
    }

    /// Matches a reply with the open requests; `None` if it matches none.
    fn route_answer(
        &mut self,
        now: Instant,
        name: NameOf<D>,
        answer: &D::Answer<'_>,
    ) -> Option<Routed<D::Request>> {
        let status = D::status(answer);
        let answers_fast_stop = name == D::Request::FAST_STOP.name() && self.fast_stop.was_sent();
        // A FAST STOP is complete only when the gripper confirms it.
        if answers_fast_stop && status != Status::Success {
            return Some(Routed::Unsolicited);
        }
        if answers_fast_stop || (self.stop.awaits_answer(name) && status.is_final()) {
            if answers_fast_stop {
                self.fast_stop.close();
            } else {
                self.stop.close();
            }
            if matches!(self.link, Link::Down { .. }) {
                self.link = Link::Down { retry_at: None };
            }
            return Some(Routed::Answered);
        }
        if D::UPKEEP == Some(name) && self.upkeep_is_sent() {
            // Before a setting's read-back, because the first reply may predate the setting.
            self.refresh.close();
            if let Upkeep::Queried { opened, .. } = self.upkeep {
                self.upkeep = Upkeep::Confirmed(opened);
            }
            if status != Status::Success {
                D::forget_settings(&mut self.known);
            }
            return Some(Routed::Taken);
        }
        if self.request.awaits_answer(name) && self.request.own().is_none_or(|own| D::fits(own, answer)) {
            return Some(self.route_first_answer(now, name, status));
        }
        if status.is_final() && self.end_running(name) {
            return Some(Routed::Answered);
        }
        let is_step = self.refresh.awaits_answer(name)
            && self.refresh.own().is_some_and(|own| D::fits(own, answer))
            && D::completes_step(name, status);
        is_step.then(|| self.route_refresh(now))
    }

    /// Processes the first reply to a request.
    fn route_first_answer(&mut self, now: Instant, name: NameOf<D>, status: Status) -> Routed<D::Request> {
        if D::is_late_result(name, status, self.given_up == Some(name)) {
            self.given_up = None;
            return Routed::Unsolicited;
        }
        if status != Status::CmdPending {
            return self.finish_request(now, name, status);
        }
        if !D::is_asynchronous(name) {
            return Routed::Unsolicited;
        }
        self.request.close();
        self.given_up = None;
        // A slot is free: only one motion is accepted, and the supply of each finger once.
        if let Some(place) = self.running.iter_mut().find(|place| place.is_none()) {
            *place = Some(Running { name, begun: now, still_since: None });
        }
        Routed::Pending(name)
    }

    /// Completes the current request, or starts the read-back of a setting.
    fn finish_request(&mut self, now: Instant, name: NameOf<D>, status: Status) -> Routed<D::Request> {
        let request = self.request.own().copied();
        self.doubled = self.request.doubled().or(self.doubled);
        self.request.close();
        if let Some((setting, opened)) = self.reading_back.take() {
            return Routed::ReadBack(setting, opened);
        }
        if status == Status::Success
            && let Some(setting) = request
            && let Some(query) = self.dialect.read_back(&setting)
        {
            self.reading_back = Some((setting, now));
            self.request.open(Request::Own(query), self.timing.reply_timeout(query.name()));
            return Routed::Taken;
        }
        if status == Status::Success && D::is_farewell(name) {
            self.link = Link::Closing { farewell: true };
        }
        Routed::Answered
    }

    /// Processes the reply to one of the session's own requests.
    fn route_refresh(&mut self, now: Instant) -> Routed<D::Request> {
        if let Some(request) = self.refresh.own() {
            self.subscriptions.confirm(request);
        }
        self.refresh.close();
        match self.link {
            Link::Connecting { step } => {
                let next = step.saturating_add(1);
                if self.dialect.setup(next, &self.subscriptions).is_some() {
                    self.link = Link::Connecting { step: next };
                    Routed::Taken
                } else {
                    self.link =
                        Link::Up { refresh_at: now.plus(self.refresh_interval_ms()), refresh_step: 0 };
                    Routed::Connected
                }
            }
            // Delivered to the subscriber if it contains a value.
            _ => Routed::Reported,
        }
    }

    /// Stores a reported value and updates the standstill time of a running motion. A FAST STOP that begins overtakes a
    /// motion that waits, which could otherwise follow somebody else's acknowledgement, and a setting, which may be that of a motion.
    fn learn(&mut self, now: Instant, value: &D::Value<'_>) {
        let was_fast_stopped = D::is_fast_stopped(&self.known);
        let Some(moves) = D::learn(&mut self.known, value) else { return };
        let is_overtaken = || self.waits(Kind::Motion) || self.waits(Kind::Setting);
        if !was_fast_stopped && D::is_fast_stopped(&self.known) && is_overtaken() {
            self.overtake();
        }
        for motion in self.running.iter_mut().flatten().filter(|running| running.name.kind() == Kind::Motion)
        {
            motion.still_since = if moves { None } else { motion.still_since.or(Some(now)) };
        }
    }

    /// Removes a running command and returns whether it was running.
    pub(super) fn end_running(&mut self, name: NameOf<D>) -> bool {
        let place = self.running.iter_mut().find(|place| place.is_some_and(|running| running.name == name));
        place.is_some_and(|place| place.take().is_some())
    }
}
