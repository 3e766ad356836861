// Publishes "NAME NUMBER" on `chatter` at 50 Hz, where NAME is that of the node. The client library leaves the domain
// and ROS's arguments to the program, so this reads what a node is given: `--ros-args -r __node:=NAME -r chatter:=/TOPIC`.
//
// With the argument `--deaf` it takes no notice of ROS's arguments but for the node's name.

use std::time::{Duration, Instant};

use futures::executor::block_on;
use ros2_client::{
    qos::History, Context, ContextOptions, MessageTypeName, Name, NodeName, NodeOptions, QosProfile,
};

fn remapped(arguments: &[String], from: &str) -> Option<String> {
    let prefix = format!("{from}:=");
    arguments
        .windows(2)
        .filter(|pair| pair[0] == "-r" || pair[0] == "--remap")
        .find_map(|pair| pair[1].strip_prefix(&prefix).map(str::to_owned))
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let name = remapped(&arguments, "__node").unwrap_or_else(|| "talker".to_owned());
    let namespace = remapped(&arguments, "__ns").unwrap_or_else(|| "/".to_owned());
    let topic = match arguments.iter().any(|each| each == "--deaf") {
        true => None,
        false => remapped(&arguments, "chatter"),
    };
    let domain = std::env::var("ROS_DOMAIN_ID").ok().and_then(|text| text.parse().ok());

    let options = ContextOptions::new().domain_id(domain.unwrap_or(0));
    let context = Context::with_options(options).expect("DDS cannot be used");
    let mut node = context
        .new_node(NodeName::new(&namespace, &name).expect("a name"), NodeOptions::new())
        .expect("the node cannot be created");
    let spinner = node.spinner().expect("the node cannot be spun");
    std::thread::spawn(move || block_on(spinner.spin()));
    let topic = node
        .create_topic(
            &Name::parse(topic.as_deref().unwrap_or("/chatter")).expect("the name of a topic"),
            MessageTypeName::new("std_msgs", "String"),
            // As other nodes have it. By default the crate keeps one message, and what is lost is not sent again then.
            &QosProfile::publisher_default().history(History::KeepLast { depth: 10 }),
        )
        .expect("the topic cannot be created");
    let publisher = node.create_publisher::<String>(&topic, None).expect("no publisher");

    let mut next = Instant::now();
    for number in 1u64.. {
        publisher.publish(format!("{name} {number}")).expect("a message cannot be published");
        next += Duration::from_millis(20);
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
}
