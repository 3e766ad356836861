"""One change of the running system, from its request to its report or its roll-back."""

PUBLIC = "ChangePhase ChangeSession NO_OVERRIDE Override Reconciler ReconciliationObserver RunningChange Verifier"
