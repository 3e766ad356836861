"""What a manager keeps and reports: the journal, the saved state, events, and their JSON forms."""
