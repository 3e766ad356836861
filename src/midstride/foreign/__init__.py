"""Gates in nodes that do not use Midstride's API: a preloaded C library, and what the manager does with it."""
