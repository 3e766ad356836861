"""A look at a running ROS graph, and what it proposes for a specification: ports, types, QoS and rates."""
