"""Gates in nodes that do not use Midstride's API: a preloaded C library, and what the manager does with it."""

PUBLIC = (
    "EXPORT_STATE ForeignAgent ForeignRecord GATES_FOLDER Gates GraphEndpoint IMPORT_STATE KILLED LifecycleManager "
    "LifecycleManagers LifecyclePeers NODE NODE_LOOK NamedServer NoAnswer NodeServices OUTPUT OfferedState "
    "OwnNodeSearch PAGE PRELOAD Page PagePort PortFlag RelayOrder RelayPlatform ReportedStates SEND_GOAL SERVER STATE "
    "Served StartedPrograms StatePeers WRITES Within build differing endpoints_seconds forget_component kept_results "
    "of_services of_topics order_file private_topics require_usable run_relay share_requests total typed"
)
