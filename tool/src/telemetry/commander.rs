//! Carries out the commands of hosts that were taken, beside the reading of values.
//!
//! Each order has one outcome, whatever becomes of it, and is sent once.

use std::{fmt::Display, time::Duration};

use tokio::{sync::watch, time::timeout};
use wsg_protocol::{
    HomingDirection,
    driver::{
        Error, Grip, Mm, MmPerS, N, OnBlock, Pending,
        asynch::{Gripper, Transport},
        tokio::TokioTimer,
    },
};

use super::{
    command::{Action, Order, Queue},
    metrics::OfCommand,
    report::{Reporter, What, now_ms, stopped},
};

/// How often it is looked whether a motion is over, in ms.
pub(super) const LOOK_MS: u32 = 20;

#[derive(Debug)]
pub(super) struct Commander {
    queue: Queue,
    reporter: Reporter,
    running: Option<Running>,
    /// The time of the latest Stop or Fast Stop: what was asked for before is not done any more.
    stopped_at: u64,
    /// How often the gripper has been found.
    life: u64,
}

/// A motion that has begun.
#[derive(Clone, Copy, Debug)]
struct Running {
    of: OfCommand,
    pending: Motion,
}

#[derive(Clone, Copy, Debug)]
enum Motion {
    Plain(Pending<()>),
    Grip(Pending<Grip>),
}

impl Commander {
    pub(super) const fn new(queue: Queue, reporter: Reporter) -> Self {
        Self { queue, reporter, running: None, stopped_at: 0, life: 0 }
    }

    /// The gripper was found for the time with this number.
    pub(super) const fn found(&mut self, life: u64) {
        self.life = life;
    }

    /// The gripper was lost.
    pub(super) async fn lost(&mut self) {
        if let Some(Running { of, .. }) = self.running.take() {
            self.tell(of, "the connection to the gripper was lost; what became of it is not known").await;
        }
    }

    pub(super) const fn is_moving(&self) -> bool {
        self.running.is_some()
    }

    /// The next order. May be given up: none is lost.
    pub(super) async fn next(&mut self) -> Option<Order> {
        self.queue.next().await
    }

    /// Carries out an order, a motion up to its begin. An error of the line, the gripper's next call has, too.
    pub(super) async fn carry_out<IO: Transport>(
        &mut self,
        gripper: &mut Gripper<IO, TokioTimer>,
        order: Order,
        stop: &mut watch::Receiver<bool>,
    ) where
        IO::Error: Display,
    {
        let of = order.action.of();
        if order.life != self.life {
            self.tell(of, "dropped: the connection to the gripper was lost meanwhile").await;
            return;
        }
        if order.action.is_urgent() {
            self.urge(gripper, order).await;
            return;
        }
        if order.at <= self.stopped_at {
            self.tell(of, "dropped: a stop was asked for since").await;
            return;
        }
        let left = Duration::from_millis(order.expires_at.saturating_sub(now_ms()));
        if left.is_zero() {
            self.tell(of, "dropped: it waited for too long").await;
            return;
        }
        // The driver's calls may be given up: what has not left by then does not leave any more.
        let begun = tokio::select! {
            biased;
            () = stopped(stop) => return,
            urgent = self.queue.urgent.recv() => Err(urgent),
            begun = timeout(left, begin(gripper, order.action)) => Ok(begun),
        };
        match begun {
            Err(Some(urgent)) => {
                self.tell(of, &format!("dropped or ended by {}", urgent.action.of().title())).await;
                self.urge(gripper, urgent).await;
            }
            // The program ends.
            Err(None) => {}
            Ok(Ok(Ok(Some(pending)))) => self.running = Some(Running { of, pending }),
            Ok(Ok(Ok(None))) => self.tell(of, "done").await,
            Ok(Ok(Err(error))) => self.tell(of, &reason(&error)).await,
            Ok(Err(_)) => self.tell(of, "no answer in time; what became of it is not known").await,
        }
    }

    /// Stops the fingers; FAST STOP waits for no Stop.
    async fn urge<IO: Transport>(&mut self, gripper: &mut Gripper<IO, TokioTimer>, mut order: Order)
    where
        IO::Error: Display,
    {
        let stopped = loop {
            self.stopped_at = self.stopped_at.max(order.at);
            if order.action == Action::FastStop {
                break gripper.fast_stop().await;
            }
            let of = order.action.of();
            tokio::select! {
                biased;
                stopped = gripper.stop() => break stopped,
                Some(next) = self.queue.urgent.recv() => {
                    self.tell(of, &format!("overtaken by {}", next.action.of().title())).await;
                    order = next;
                }
            }
        };
        // The motion that it ended is told first.
        self.look(gripper).await;
        let text = stopped.map_or_else(|error| reason(&error), |()| "done".to_owned());
        self.tell(order.action.of(), &text).await;
    }

    /// Tells what the motion that runs came to, if it is over.
    pub(super) async fn look<IO: Transport>(&mut self, gripper: &mut Gripper<IO, TokioTimer>)
    where
        IO::Error: Display,
    {
        let Some(Running { of, pending }) = self.running else { return };
        let ended = match pending {
            Motion::Plain(pending) => gripper.poll(&pending).await.map(|ended| ended.map(|()| "done")),
            Motion::Grip(pending) => gripper.poll(&pending).await.map(|ended| {
                ended.map(|grip| match grip {
                    Grip::Held => "held",
                    Grip::NoPart => "no part",
                })
            }),
        };
        let text = match ended {
            // Of a line that is gone, `lost` tells.
            Ok(None) | Err(Error::Closed | Error::Transport(_)) => return,
            Ok(Some(text)) => text.to_owned(),
            Err(error) => reason(&error),
        };
        self.running = None;
        self.tell(of, &text).await;
    }

    async fn tell(&self, of: OfCommand, text: &str) {
        let text = format!("{}: {text}", of.title());
        self.reporter.tell(What::Outcome { of, text }).await;
    }
}

/// Begins a motion; `None`: it was no motion, and is done.
async fn begin<IO: Transport>(
    gripper: &mut Gripper<IO, TokioTimer>,
    action: Action,
) -> Result<Option<Motion>, Error<IO::Error>> {
    if let Action::Move { force: Some(force), .. } | Action::Grip { force: Some(force), .. } = action {
        gripper.set_force_limit(N(force)).await?;
    }
    Ok(Some(match action {
        Action::Home => Motion::Plain(gripper.begin_home(HomingDirection::Default).await?),
        Action::Move { width, speed, .. } => {
            Motion::Plain(gripper.begin_move_to(Mm(width), MmPerS(speed), OnBlock::Stop).await?)
        }
        Action::Grip { width, speed, .. } => {
            Motion::Grip(gripper.begin_grip(Mm(width), MmPerS(speed)).await?)
        }
        Action::Release { width, speed } => {
            Motion::Plain(gripper.begin_release(Mm(width), MmPerS(speed)).await?)
        }
        Action::Acknowledge => {
            gripper.acknowledge().await?;
            return Ok(None);
        }
        // They are urged.
        Action::Stop | Action::FastStop => return Ok(None),
    }))
}

/// Why nothing came of it, in the gripper's words.
fn reason<E: Display>(error: &Error<E>) -> String {
    match error {
        Error::Refused(status) => format!("refused, {status}: {}", status.meaning()),
        Error::Failed(status) => format!("failed, {status}: {}", status.meaning()),
        Error::Closed | Error::Transport(_) => format!("{error}; what became of it is not known"),
        error => error.to_string(),
    }
}

#[cfg(test)]
mod tests;
