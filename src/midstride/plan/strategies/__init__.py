"""The planning strategies by name, and what they build plans with."""

PUBLIC = "PlanBuilder minimal planner restore set_parameters"
