"""Strategy ``stop``: everything stops, and everything starts again, for comparison (docs/semantics.md section 6).

What is done to a robot whose software can only be changed as a whole. The request renews every role
(:meth:`~midstride.plan.request.PlanRequest.renewed`); the rest is the paper's six steps, after degrading everything.
"""

from __future__ import annotations

from midstride.plan.change import Change
from midstride.plan.plan import Plan
from midstride.plan.strategies.paper import six_steps


def stop(change: Change) -> Plan:
    """The plan that stops everything first. Raises PlanRefused where it does not meet the user's constraints."""
    return six_steps("stop", change, sorted(change.start.modes) if change.instances() else ())
