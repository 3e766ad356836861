"""Observation of the running system: silences, degradations, and what the subscribers of a topic receive."""
