"""For tests, Midstride's own and its users': puppets, virtual time, and the checks any back end must pass."""
