"""ROS 2 on the manager's side: the graph, the processes, and the services of other nodes."""

PUBLIC = (
    "BringUpSystem Graph LIFECYCLE PARAMETERS Ros2Backend RosNodeServices observer probed_page seen_answers seen_nodes "
    "seen_writes"
)
