"""ROS 2 inside a component's process: its nodes, endpoints, parameters and timers."""

PUBLIC = "Ros2Host SERVICES as_json early_join for_rclpy hidden_node host port_endpoints profile_of qos_of seconds_of"
