"""Deterministic simulation: the manager's and the nodes' real code in virtual time, with faults drawn from a seed."""
