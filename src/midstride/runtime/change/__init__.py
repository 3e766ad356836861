"""One change of the running system, from its request to its report or its roll-back."""

PUBLIC = "ChangePhase ChangeSession Reconciler ReconciliationObserver RunningChange Verifier"
