"""ROS 2 on the manager's side: the graph, the processes, and the services of other nodes."""
