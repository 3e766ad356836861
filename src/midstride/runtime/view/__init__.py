"""The running system as clients see it: its status, and why a functionality is in its mode."""

PUBLIC = (
    "Baseline EntryShape Explainer Programs WatchedSystem condition endpoints instance_status is_sound namespace_of "
    "parameters port_statuses status system_values topic_status"
)
