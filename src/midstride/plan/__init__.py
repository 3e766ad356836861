"""Plans: from a running configuration to a wanted one, with the least functionality lost on the way.

`change` (what differs), `registry` (the strategies: `minimal`, `replace`, `quiesce`), `plan` (steps and
costs), `draft`, `lowering` (the mode changes a structural change needs), `core`, `moves` (what caps,
capacities and orders tie together), `constraints`, `disruption`, `schedule`, `explain`, `document`
(the JSON form), `validate` (an independent replay).
"""
