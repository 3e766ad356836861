PUBLIC = (
    "Backend Clock DescribedProcess Endpoints Exited Handle Launch Manager RELAY_SUFFIX RemainingProcess SystemClock "
    "SystemOptions Workspace within"
)
