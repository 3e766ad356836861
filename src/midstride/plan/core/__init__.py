"""The conflict core of a change: the search for the least loss, its lower bound, and the check of that bound."""
