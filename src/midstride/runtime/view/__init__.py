"""The running system as clients see it: its status, and why a functionality is in its mode."""
