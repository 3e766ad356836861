"""The health of a system as Prometheus reads it: on the manager's sockets, and in a file for node_exporter."""

PUBLIC = "MetricsFile metrics_answer"
