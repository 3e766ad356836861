"""An independent replay of plans, and an independent search for their lower bounds: no code of the planners."""
