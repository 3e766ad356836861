"""The conflict core of a change: the search for the least loss, its lower bound, and the check of that bound."""

PUBLIC = (
    "Budget CoreResult MOST SearchState describe full_topics further moves plans_along play scarce_resources "
    "search_core with_detours"
)
