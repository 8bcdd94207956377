//! Event streams for open pages and programs, bounded in number and backlog. Each event has the form of a server-sent event;
//! a page receives it as one message of its WebSocket.

use hyper::body::{Body, Bytes, Frame};
use std::cell::{Cell, RefCell};
use std::convert::Infallible;
use std::future::poll_fn;
use std::pin::Pin;
use std::rc::Rc;
use std::task::{Context, Poll};
use tokio::sync::Notify;
use tokio::sync::mpsc::{Receiver, Sender, channel};
use tokio::time::{Duration, Instant};

/// Maximum number of simultaneous streams.
pub(super) const MAX_STREAMS: usize = 64;
/// Maximum number of unread events per reader. With more, a reader loses its stream. It connects again and receives
/// everything, so that it never lacks a part of a log, or the end of a script.
const MAX_WAITING: usize = 32;
/// Time-out of a reader that reads nothing. Events are sent far more often.
const PATIENCE: Duration = Duration::from_secs(10);

/// The event streams that are open.
#[derive(Debug, Default)]
pub(super) struct Watchers {
    open: RefCell<Vec<Sender<Bytes>>>,
    came: Notify,
}

impl Watchers {
    /// Opens a stream that begins with `first`; `None` if there are too many.
    pub(super) fn open(&self, first: Bytes, link: Rc<Link>) -> Option<Events> {
        let mut open = self.open.borrow_mut();
        open.retain(|watcher| !watcher.is_closed());
        if open.len() >= MAX_STREAMS {
            return None;
        }
        let (sender, waiting) = channel(MAX_WAITING);
        // The new queue has room.
        let _ = sender.try_send(first);
        open.push(sender);
        self.came.notify_one();
        link.stream();
        Some(Events { waiting, link })
    }

    /// Ready when a page is open.
    pub(super) async fn opened(&self) {
        while self.are_none() {
            self.came.notified().await;
        }
    }

    pub(super) fn are_none(&self) -> bool {
        self.open.borrow().iter().all(Sender::is_closed)
    }

    /// Queues an event for each reader, and ends the streams of readers without room.
    pub(super) fn send(&self, event: &Bytes) {
        self.open.borrow_mut().retain(|watcher| watcher.try_send(event.clone()).is_ok());
    }
}

/// Encodes an event of this kind; `json` must not contain line breaks.
pub(super) fn event(kind: &str, json: &str) -> Bytes {
    Bytes::from(format!("event: {kind}\ndata: {json}\n\n"))
}

/// State shared by a connection and the stream in its answer.
#[derive(Debug)]
pub(super) struct Link {
    streams: Cell<bool>,
    taken_at: Cell<Instant>,
}

impl Link {
    pub(super) fn new() -> Rc<Self> {
        Rc::new(Self { streams: Cell::new(false), taken_at: Cell::new(Instant::now()) })
    }

    fn stream(&self) {
        self.streams.set(true);
        self.taken_at.set(Instant::now());
    }

    /// Returns whether the answer is a stream, which has no end.
    pub(super) fn streams(&self) -> bool {
        self.streams.get()
    }

    /// Ready when the reader has read nothing for too long.
    pub(super) async fn is_given_up(&self) {
        while self.taken_at.get().elapsed() < PATIENCE {
            tokio::time::sleep_until(self.taken_at.get() + PATIENCE).await;
        }
    }
}

/// The body of an answer without an end.
#[derive(Debug)]
pub(super) struct Events {
    waiting: Receiver<Bytes>,
    link: Rc<Link>,
}

impl Events {
    /// Returns the next event.
    pub(super) async fn next(&mut self) -> Option<Bytes> {
        poll_fn(|context| self.poll_next(context)).await
    }

    fn poll_next(&mut self, context: &mut Context<'_>) -> Poll<Option<Bytes>> {
        self.link.taken_at.set(Instant::now());
        self.waiting.poll_recv(context)
    }
}

impl Body for Events {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        self.poll_next(context).map(|event| event.map(|bytes| Ok(Frame::data(bytes))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn streams_are_bounded_in_number_and_one_that_ends_makes_room() {
        let watchers = Watchers::default();
        let open = || watchers.open(event("hello", "{}"), Link::new());
        let mut all: Vec<Events> = (0..MAX_STREAMS).map(|_| open().unwrap()).collect();
        assert!(open().is_none());
        all.pop();
        assert!(open().is_some());
    }

    #[tokio::test]
    async fn only_a_slow_reader_loses_its_stream() {
        let watchers = Watchers::default();
        let open = || watchers.open(event("hello", "{}"), Link::new()).unwrap();
        let (mut slow, mut quick) = (open(), open());
        assert!(quick.next().await.unwrap().starts_with(b"event: hello\n"));
        for number in 0..100 {
            watchers.send(&event("state", &number.to_string()));
            assert_eq!(quick.next().await.unwrap(), event("state", &number.to_string()));
        }
        assert!(slow.next().await.unwrap().starts_with(b"event: hello\n"));
        for number in 1..MAX_WAITING {
            assert_eq!(slow.next().await.unwrap(), event("state", &(number - 1).to_string()));
        }
        assert_eq!(slow.next().await, None, "no event is missing before the end");
        drop(quick);
        assert!(watchers.are_none());
    }

    #[tokio::test(start_paused = true)]
    async fn reader_that_takes_nothing_for_ten_seconds_is_given_up() {
        let link = Link::new();
        let watchers = Watchers::default();
        let mut events = watchers.open(event("hello", "{}"), Rc::clone(&link)).unwrap();
        assert!(link.streams());
        let start = Instant::now();
        tokio::time::advance(Duration::from_secs(9)).await;
        events.next().await.unwrap();
        link.is_given_up().await;
        assert!(start.elapsed() >= Duration::from_secs(19), "{:?}", start.elapsed());
    }
}
