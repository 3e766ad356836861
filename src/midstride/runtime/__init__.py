PUBLIC = (
    "Backend Clock DescribedProcess Endpoints Exited Handle HeardMessage Launch Manager NAMES_ALL OtherNode OtherNodes "
    "RELAY_SUFFIX RemainingProcess SystemClock SystemOptions Workspace within"
)
