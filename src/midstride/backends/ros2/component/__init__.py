"""ROS 2 inside a component's process: its nodes, endpoints, parameters and timers."""
