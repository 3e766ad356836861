"""Gates in nodes that do not use Midstride's API: a preloaded C library, and what the manager does with it."""

PUBLIC = (
    "ForeignAgent ForeignRecord GATES_FOLDER Gates GraphEndpoint KILLED LifecycleManager LifecycleManagers "
    "LifecyclePeers NoAnswer NodeServices OUTPUT PAGE Page PagePort PortFlag RelayOrder RelayPlatform ReportedStates "
    "SETTLED Served build differing endpoints_seconds order_file private_topics run_relay typed"
)
