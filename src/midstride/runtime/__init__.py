PUBLIC = (
    "Backend Clock DescribedProcess Endpoints Exited Handle HeardMessage Launch Manager RELAY_SUFFIX RemainingProcess "
    "SystemClock SystemOptions Workspace within"
)
