"""Deterministic simulation: the manager's and the nodes' real code in virtual time, with faults drawn from a seed."""

PUBLIC = (
    "BRANCHES Life Scenario SeedRun SeededLoop SimulatedDisk Summary ThreadlessOnceStarted ThreadlessProcess "
    "rehearsal_of rehearsed rehearsed_seed run simulate_many"
)
