use tokio::{
    io::{AsyncReadExt, DuplexStream, duplex},
    sync::mpsc,
};
use wsg_protocol::driver::tokio::Stream;

use super::*;
use crate::telemetry::{
    command::{Orders, queue},
    report::Report,
};

/// A commander for a gripper that was found once, with access to its orders, reports and line.
struct Rig {
    commander: Commander,
    gripper: Gripper<Stream<DuplexStream>, TokioTimer>,
    line: DuplexStream,
    orders: Orders,
    reports: mpsc::Receiver<Report>,
    stop: watch::Sender<bool>,
}

impl Rig {
    fn new() -> Self {
        let ((near, line), (orders, queue)) = (duplex(1_024), queue());
        let (sender, reports) = mpsc::channel(16);
        let reporter = Reporter { device: 0, name: "left".to_owned(), reports: sender };
        let mut commander = Commander::new(queue, reporter);
        commander.found(1);
        let gripper = Gripper::new(Stream::new(near), TokioTimer::new());
        Self { commander, gripper, line, orders, reports, stop: watch::channel(false).0 }
    }

    async fn carry_out(&mut self, order: Order) {
        let mut stop = self.stop.subscribe();
        self.commander.carry_out(&mut self.gripper, order, &mut stop).await;
    }

    /// Returns the outcomes reported since the last call.
    fn outcomes(&mut self) -> Vec<String> {
        let reports = std::iter::from_fn(|| self.reports.try_recv().ok());
        let text = reports.map(|report| match report.what {
            What::Outcome { text, .. } => text,
            other => panic!("{other:?}"),
        });
        text.collect()
    }
}

fn order(action: Action, at: u64) -> Order {
    Order { action, at, expires_at: u64::MAX, life: 1 }
}

#[tokio::test(start_paused = true)]
async fn expired_and_disconnected_orders_are_dropped_and_reported() {
    let mut rig = Rig::new();

    rig.carry_out(Order { life: 0, ..order(Action::Home, 5) }).await;
    rig.carry_out(Order { life: 0, ..order(Action::FastStop, 6) }).await;
    rig.carry_out(Order { expires_at: 1, ..order(Action::Home, 7) }).await;

    let outcomes = rig.outcomes();
    assert_eq!(outcomes[0], "Home: dropped: the connection to the gripper was lost in the meantime");
    assert_eq!(outcomes[1], "Fast Stop: dropped: the connection to the gripper was lost in the meantime");
    assert_eq!(outcomes[2], "Home: dropped: it expired while waiting");
    drop(rig.gripper);
    assert_eq!(rig.line.read(&mut [0; 64]).await.unwrap(), 0, "no bytes were sent to the gripper");
}

#[tokio::test(start_paused = true)]
async fn orders_given_before_a_stop_are_dropped_after_it() {
    let mut rig = Rig::new();
    for (number, action) in [Action::Home, Action::Acknowledge, Action::FastStop].into_iter().enumerate() {
        assert!(rig.orders.push(order(action, 10 + number as u64)));
    }

    for _ in 0..3 {
        let next = rig.commander.next().await.unwrap();
        rig.carry_out(next).await;
    }

    let outcomes = rig.outcomes();
    assert!(outcomes[0].starts_with("Fast Stop: "), "{outcomes:?}");
    assert_eq!(outcomes[1], "Home: dropped: superseded by a later stop");
    assert_eq!(outcomes[2], "Acknowledge: dropped: superseded by a later stop");
    rig.carry_out(order(Action::Home, 13)).await;
    assert!(!rig.outcomes()[0].contains("dropped"));
}

#[tokio::test(start_paused = true)]
async fn stop_received_before_a_motion_starts_replaces_the_motion() {
    let mut rig = Rig::new();
    assert!(rig.orders.push(order(Action::FastStop, 11)));

    rig.carry_out(order(Action::Home, 10)).await;

    let outcomes = rig.outcomes();
    assert_eq!(outcomes[0], "Home: dropped or stopped by Fast Stop");
    assert!(outcomes[1].starts_with("Fast Stop: "), "{outcomes:?}");
    drop(rig.gripper);
    let mut sent = Vec::new();
    rig.line.read_to_end(&mut sent).await.unwrap();
    assert!(!sent.is_empty());
    assert!(sent.chunks(8).all(|frame| frame.starts_with(&[0xAA, 0xAA, 0xAA, 0x23])), "{sent:02X?}");
}
