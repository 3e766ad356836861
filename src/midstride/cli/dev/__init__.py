"""``midstride dev``: what is saved is swapped into the running system."""
