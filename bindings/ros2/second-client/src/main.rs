//! Reads `joint_states` of a gripper node and calls one of its services, with ros2-client and RustDDS.
//!
//! `second-client DOMAIN NAMESPACE SERVICE` prints the joints and positions of three messages, then the service's answer.

use std::{env, error::Error, thread};

use futures::executor::block_on;
use ros2_client::{
    Context, ContextOptions, Message, MessageTypeName, Name, NodeName, NodeOptions, QosProfile,
    ServiceMapping, ServiceTypeName, builtin_interfaces::Time, qos::History,
};
use serde::{Deserialize, Serialize};

/// `std_msgs/Header`.
#[derive(Deserialize)]
struct Header {
    stamp: Time,
    _frame_id: String,
}

/// `sensor_msgs/JointState`.
#[derive(Deserialize)]
struct JointState {
    header: Header,
    name: Vec<String>,
    position: Vec<f64>,
    _velocity: Vec<f64>,
    _effort: Vec<f64>,
}

/// The request of `std_srvs/Trigger`, which has the one byte of an empty structure.
#[derive(Clone, Default, Serialize, Deserialize)]
struct Request {
    structure_needs_at_least_one_member: u8,
}
impl Message for Request {}

/// The response of `std_srvs/Trigger`.
#[derive(Clone, Serialize, Deserialize)]
struct Response {
    success: bool,
    message: String,
}
impl Message for Response {}

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<_> = env::args().skip(1).collect();
    let [domain, namespace, service] = &words[..] else {
        return Err("expected DOMAIN NAMESPACE SERVICE".into());
    };
    let context = Context::with_options(ContextOptions::new().domain_id(domain.parse()?))?;
    let mut node = context.new_node(NodeName::new("/", "second_client")?, NodeOptions::new())?;
    // Reliable, as most subscribers of ROS 2.
    let qos = QosProfile::publisher_default().history(History::KeepLast { depth: 10 });
    let kind = MessageTypeName::new("sensor_msgs", "JointState");
    let topic = node.create_topic(&Name::new(namespace, "joint_states")?, kind, &qos)?;
    let joint_states = node.create_subscription::<JointState>(&topic, None)?;
    let name = Name::parse(&format!("{namespace}/gripper/{service}"))?;
    let kind = ServiceTypeName::new("std_srvs", "Trigger");
    let client =
        node.create_client::<Request, Response>(ServiceMapping::Enhanced, &name, &kind, qos.clone(), qos)?;
    let spinner = node.spinner()?;
    thread::spawn(move || block_on(spinner.spin()));
    block_on(async {
        for _ in 0..3 {
            let (message, _) = joint_states.async_take().await?;
            println!("{} {:?} {:?}", message.header.stamp.to_nanos(), message.name, message.position);
        }
        client.wait_for_service(&node).await;
        let response =
            client.async_call_service(Request::default()).await.map_err(|error| format!("{error:?}"))?;
        println!("{} {}", response.success, response.message);
        Ok(())
    })
}
