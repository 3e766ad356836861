"""The tallies of the goals of ROS actions during a change, from the counts of the two instances of each role."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from midstride.model.wording import counted
from midstride.plan.plan import Plan
from midstride.runtime.records.reports import GoalTally
from midstride.verdicts.assessment import listed
from midstride.wire.state import GoalCounts


def goal_tallies(
    plan: Plan,
    before: Mapping[str, GoalCounts],
    now: Mapping[str, GoalCounts],
    has_ended: Callable[[str], bool],
) -> dict[str, GoalTally]:
    """By role that ``plan`` replaces, where its instances had goals.

    ``before`` and ``now``: what each instance had reported when the change began, and has reported last, also where it
    ``has_ended`` since.
    """
    found: dict[str, GoalTally] = {}
    for old, new in plan.change.replaced.items():
        begun = before.get(old, GoalCounts())
        counts = [now.get(name, GoalCounts()) for name in (old, new)]
        if begun.in_progress or any(each != before for each, before in zip(counts, (begun, GoalCounts()), strict=True)):
            gone = (has_ended(old), has_ended(new))
            found[plan.change.role_of(old)] = _tally(old, new, begun, counts[0], counts[1], gone)
    return found


def _tally(
    old: str, new: str, begun: GoalCounts, before: GoalCounts, after: GoalCounts, gone: tuple[bool, bool]
) -> GoalTally:
    accepted = before.accepted - begun.ended - begun.cancelled + after.accepted
    left = (before.in_progress, after.in_progress)
    ended_at_old, ended_at_new = before.ended - begun.ended, after.ended
    cancelled = before.cancelled - begun.cancelled + after.cancelled
    in_progress = sum(number for number, is_gone in zip(left, gone, strict=True) if not is_gone)
    lost = sum(number for number, is_gone in zip(left, gone, strict=True) if is_gone)
    unknown = before.unknown - begun.unknown + after.unknown
    parts = [f"{ended_at_old} ended at {old}", f"{ended_at_new} at {new}", f"{cancelled} cancelled"]
    parts += [f"{in_progress} in progress"] if in_progress else []
    parts += [f"{lost} lost with their instance"] if lost else []
    words = f"{counted(accepted, 'goal')} of ROS actions of {old} and {new}: {listed(parts)}"
    if unknown:
        words += f"; {counted(unknown, 'request')} about goals that neither knew"
    return GoalTally(
        old=old,
        new=new,
        accepted=accepted,
        ended_at_old=ended_at_old,
        ended_at_new=ended_at_new,
        cancelled=cancelled,
        in_progress=in_progress,
        lost=lost,
        unknown=unknown,
        words=words,
    )
