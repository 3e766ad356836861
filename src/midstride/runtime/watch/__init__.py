"""Observation of the running system: silences, degradations, and what the subscribers of a topic receive."""

PUBLIC = (
    "DegradationTimer DiscoveryWatch OtherNodesWatch OutputTallies Recording ReportedValues SilenceMonitor "
    "changed_attachments degradations_in_words differs left_closed observe own_degradations own_degradations_in "
    "recorded_topics remaining_degradations reported_modes stretch_of unsupported_modes with_attachments"
)
