"""One change of the running system, from its request to its report or its roll-back."""

PUBLIC = (
    "ChangePhase ChangeSession NO_OVERRIDE Override PLAN_LOOK ParameterTransfer Reconciler ReconciliationObserver "
    "RunningChange Verifier look_at_managers unread_parameters unseen_endpoints what_ended"
)
