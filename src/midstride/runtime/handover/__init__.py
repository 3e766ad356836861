"""The hand-over from one publisher to another on live components, and the fence for one that hangs."""

PUBLIC = (
    "ATTACH_TIMEOUT CutTurn CutTurns DEFAULT_WAIT DETACH_TIMEOUT Fences GivenUp LEASE LiveHandover RESUME_PERIODS "
    "StateMoves StateTransfers StepBudget WATCHED_WINDOW WatchedOutput WatchedServer hanging has_left_state "
    "import_state keeps_state only_turn own_state require_arbiters watch_after watch_servers_after"
)
