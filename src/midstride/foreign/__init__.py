"""Gates in nodes that do not use Midstride's API: a preloaded C library, and what the manager does with it."""

PUBLIC = (
    "ForeignAgent ForeignRecord GATES_FOLDER Gates GraphEndpoint KILLED NODE_LOOK LifecycleManager LifecycleManagers "
    "LifecyclePeers NamedServer NoAnswer NodeServices OUTPUT OwnNodeSearch PAGE Page PagePort PortFlag RelayOrder "
    "RelayPlatform ReportedStates Served build differing endpoints_seconds of_topics order_file private_topics "
    "run_relay typed"
)
