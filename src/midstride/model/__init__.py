"""The model: what there is, what must hold, and what may be done to it. Pure: no I/O, no clock.

`contract` (predicates and their satisfaction), `component` (declarations), `configuration` (what is
live, attached, in which mode), `rules` (validity), `best` (the best modes of a structure), `action`
(the reconfiguration actions), `diagnosis` (chains of reasons), `specification` (a whole system as declared),
`specification_checks` (its design-time check, with `name_checks` and `component_rules`), `diagnostics` (the
catalogue of what can be wrong). Their JSON forms are in :mod:`midstride.codec`.
"""
