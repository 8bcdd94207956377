//! Executes accepted host commands while values are read.
//!
//! Each order is sent at most once and has exactly one outcome.

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

/// Polling interval for the end of a motion, in ms.
pub(super) const LOOK_MS: u32 = 20;

#[derive(Debug)]
pub(super) struct Commander {
    queue: Queue,
    reporter: Reporter,
    running: Option<Running>,
    /// Timestamp of the latest Stop or Fast Stop. Earlier orders are dropped.
    stopped_at: u64,
    /// Number of times the gripper was found.
    life: u64,
}

/// A motion in progress.
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

    /// Notes that the gripper was found. `life` is the number of times so far.
    pub(super) const fn found(&mut self, life: u64) {
        self.life = life;
    }

    /// Notes that the gripper was lost, and reports the outcome of a motion in progress.
    pub(super) async fn lost(&mut self) {
        if let Some(Running { of, .. }) = self.running.take() {
            self.report(of, "the connection to the gripper was lost; outcome unknown").await;
        }
    }

    pub(super) const fn is_moving(&self) -> bool {
        self.running.is_some()
    }

    /// Waits for the next order. Cancel safe.
    pub(super) async fn next(&mut self) -> Option<Order> {
        self.queue.next().await
    }

    /// Executes an order. A motion is only started. A line error is also returned by the next call to the gripper.
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
            self.report(of, "dropped: the connection to the gripper was lost in the meantime").await;
            return;
        }
        if order.action.is_urgent() {
            self.urge(gripper, order).await;
            return;
        }
        if order.at <= self.stopped_at {
            self.report(of, "dropped: superseded by a later stop").await;
            return;
        }
        let left = Duration::from_millis(order.expires_at.saturating_sub(now_ms()));
        if left.is_zero() {
            self.report(of, "dropped: it expired while waiting").await;
            return;
        }
        // The driver's calls are cancel safe: a request not sent by then is never sent.
        let begun = tokio::select! {
            biased;
            () = stopped(stop) => return,
            urgent = self.queue.urgent.recv() => Err(urgent),
            begun = timeout(left, begin(gripper, order.action)) => Ok(begun),
        };
        match begun {
            Err(Some(urgent)) => {
                self.report(of, &format!("dropped or stopped by {}", urgent.action.of().title())).await;
                self.urge(gripper, urgent).await;
            }
            // The program is about to exit.
            Err(None) => {}
            Ok(Ok(Ok(Some(pending)))) => self.running = Some(Running { of, pending }),
            Ok(Ok(Ok(None))) => self.report(of, "done").await,
            Ok(Ok(Err(error))) => self.report(of, &reason(&error)).await,
            Ok(Err(_)) => self.report(of, "no response in time; outcome unknown").await,
        }
    }

    /// Stops the fingers. A Fast Stop supersedes a pending Stop.
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
                    self.report(of, &format!("superseded by {}", next.action.of().title())).await;
                    order = next;
                }
            }
        };
        // Report the outcome of the stopped motion first.
        self.look(gripper).await;
        let text = stopped.map_or_else(|error| reason(&error), |()| "done".to_owned());
        self.report(order.action.of(), &text).await;
    }

    /// Reports the outcome of the motion in progress, if it has ended.
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
            // `lost` reports the outcome after a line error.
            Ok(None) | Err(Error::Closed | Error::Transport(_)) => return,
            Ok(Some(text)) => text.to_owned(),
            Err(error) => reason(&error),
        };
        self.running = None;
        self.report(of, &text).await;
    }

    async fn report(&self, of: OfCommand, text: &str) {
        let text = format!("{}: {text}", of.title());
        self.reporter.send(What::Outcome { of, text }).await;
    }
}

/// Starts a motion. Returns `None` for a command that is already complete.
async fn begin<IO: Transport>(
    gripper: &mut Gripper<IO, TokioTimer>,
    action: Action,
) -> Result<Option<Motion>, Error<IO::Error>> {
    Ok(Some(match action {
        Action::Home => Motion::Plain(gripper.begin_home(HomingDirection::Default).await?),
        Action::Move { width, speed, force } => {
            let (width, speed, block) = (Mm(width), MmPerS(speed), OnBlock::Stop);
            Motion::Plain(match force {
                Some(force) => gripper.begin_move_to_with_force(width, speed, block, N(force)).await?,
                None => gripper.begin_move_to(width, speed, block).await?,
            })
        }
        Action::Grip { width, speed, force } => {
            let (width, speed) = (Mm(width), MmPerS(speed));
            Motion::Grip(match force {
                Some(force) => gripper.begin_grip_with_force(width, speed, N(force)).await?,
                None => gripper.begin_grip(width, speed).await?,
            })
        }
        Action::Release { width, speed } => {
            Motion::Plain(gripper.begin_release(Mm(width), MmPerS(speed)).await?)
        }
        Action::Acknowledge => {
            gripper.acknowledge().await?;
            return Ok(None);
        }
        // Handled by `urge`.
        Action::Stop | Action::FastStop => return Ok(None),
    }))
}

/// Describes an error, including the gripper's status.
fn reason<E: Display>(error: &Error<E>) -> String {
    match error {
        Error::Refused(status) => format!("refused, {status}: {}", status.meaning()),
        Error::Failed(status) => format!("failed, {status}: {}", status.meaning()),
        Error::Closed | Error::Transport(_) => format!("{error}; outcome unknown"),
        error => error.to_string(),
    }
}

#[cfg(test)]
mod tests;
