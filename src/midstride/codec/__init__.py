"""The JSON forms of what the model has, and their one codec: reading, writing and JSON Schema.

`form` (the base classes), `reading` (with `fault_finder`: every fault at its path), `contract`, `parameter`,
`component`, `specification`, `configuration` (the forms), `schema`. The forms of plans are in :mod:`midstride.plan`,
those of what the manager reports in :mod:`midstride.runtime`; they are made of the same base classes.
"""
