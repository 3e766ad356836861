"""The JSON forms of plans, their steps, and requests for changes."""
