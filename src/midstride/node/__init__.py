"""What runs inside a component's process: the author's API, mode switching, and the agent that obeys the manager."""
