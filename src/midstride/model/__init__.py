"""The model of a robot's software and of safe changes to it. Pure: no I/O, no clock.

Start with these five modules, in this order: `contract` (what messages are like, and when one promise is good enough
for another), `component` (what a component type declares), `configuration` (what runs right now), `rules` (when that
is valid) and `action` (the steps that change it safely).

Beyond them: `specification` (a whole system as its author declares it) and its design-time check
`specification_checks` (with `name_checks` and `component_rules`), which finds `diagnostics`; `best` (the best modes
that a structure allows), `diagnosis` (why a mode is out of reach), `wording` (actions in words).
The JSON forms are in :mod:`midstride.codec`.
"""
