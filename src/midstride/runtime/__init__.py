PUBLIC = (
    "Backend Clock DescribedProcess Endpoints Exited Handle HeardMessage Launch Manager OtherNode OtherNodes "
    "RELAY_SUFFIX RemainingProcess SystemClock SystemOptions Workspace within"
)
