"""Everything that may be said about the work of a system: what was kept, what was lost, and what cannot be known here.

A plan, the report of a change, the status, the history and the exit status of a command say it through this package
alone (docs/decisions/one-verdict.md). Facts go in: what was measured, what a gate or a hand-over enforces, and what
nothing measures (:mod:`.change_facts`, :mod:`.unmeasured`). Each becomes an assessment with its sentence, and the
headline is the weakest of them (:mod:`.assessment`): a system is only said to have kept its levels where something
would have shown the contrary. :mod:`.conditions` says what runs, and what is missing.
"""

PUBLIC = (
    "Assessment Assessments Continuity EXIT_STATUS SystemCondition assessment change_facts conditions listed "
    "not_yet_judged seconds_in_words silence_in_words system_condition unmeasured"
)
