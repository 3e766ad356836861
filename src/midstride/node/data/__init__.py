"""The data thread of a component: it runs the author's code, one call after another."""
