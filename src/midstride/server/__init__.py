"""The manager's operations over HTTP: the only way in, for the command line and for every other client."""

PUBLIC = "LOOPBACK ServiceNotice Tcp listen new_token run_gateway serve"
