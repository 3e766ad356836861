"""A look at a running ROS graph, and what it proposes for a specification: ports, types, QoS and rates."""

PUBLIC = (
    "Count Dependences MAX_TIMES MOST_ROUNDS ObservedEndpoint ObservedGraph ProbedGates ProbedPort ROUNDS draft "
    "drafted_nodes drafted_services duration insert nodes_without_ports not_stated note_managers "
    "observed_processes probe probed_inputs words_on"
)
