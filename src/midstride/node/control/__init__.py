"""The control thread of a component: it answers the manager and never runs the author's code."""
