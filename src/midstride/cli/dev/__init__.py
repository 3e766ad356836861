"""``midstride dev``: what is saved is swapped into the running system."""

PUBLIC = "Changes DevSession WatchedSpecification saves worst"
