"""The control thread of a component: it answers the manager and never runs the author's code."""

PUBLIC = (
    "Agent Answering Attachments HEARTBEAT LONG_FLOOR READY_AFTER RateWatch ResponseWatch StateHooks latest_responses "
    "not_matched tolerated_periods"
)
