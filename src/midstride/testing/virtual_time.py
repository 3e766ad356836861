"""Virtual time for tests: a coroutine that would take minutes is run in none, and the same way every time."""

from __future__ import annotations

from midstride.backends.simulator.virtual_loop import VirtualLoop, run

__all__ = ["VirtualLoop", "run"]
