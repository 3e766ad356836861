PUBLIC = "Backend Clock Endpoints Exited Handle Launch Manager RELAY_SUFFIX SystemClock SystemOptions Workspace within"
