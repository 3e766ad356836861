"""The model: what there is, what must hold, and what may be done to it. Pure: no I/O, no clock.

`contract` (predicates and their satisfaction), `component` (declarations), `configuration` (what is
live, attached, in which mode), `rules` (validity), `best` (the best modes of a structure), `action`
(the reconfiguration actions), `why` (chains of reasons), `specification` (a whole system as declared),
`document` (its JSON form, read by `reading` and `decoding`), `wellformed` (its design-time check, with
`names` and `declared`), `problems` (the catalogue of what can be wrong).
"""
