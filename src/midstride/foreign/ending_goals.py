"""The end of a node with a preloaded library that has goals of ROS actions: they end first, and results are kept.

``goals.h`` has the states of a goal.
"""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from collections.abc import Callable
from typing import Final

from midstride.errors import BackendError
from midstride.foreign.gates import Gates
from midstride.foreign.node import ForeignNode
from midstride.foreign.page import KnownGoal
from midstride.foreign.page_layout import GOALS, GoalState
from midstride.model.component import CANCELLING

# A process whose helper thread has not looked for so long is stopped (s): its goals do not go on.
STOPPED: Final = 3.0
UNENDED: Final = (GoalState.RESERVED, GoalState.ASKED, GoalState.ACCEPTED)


class EndingGoals:
    """The goals of ``node``, behind ``gates``. ``hangs``: why the node is not waited for any longer, or None."""

    def __init__(self, node: ForeignNode, gates: Gates, hangs: Callable[[], str | None]) -> None:
        self._node, self._gates, self._hangs = node, gates, hangs

    async def end(self) -> list[str]:
        """Wait until each goal has ended, and cancel the rest; results that no client fetches are kept.

        Returns, in words, which are not known to have ended, and whose results are lost. A node that hangs is not
        waited for.
        """
        gates, node, begun = self._gates, self._node, time.monotonic()
        looked, since = gates.page.beat(gates.index), begun
        if node.record.draining_since is None:
            node.change_record(draining_since=begun)
        waited = begun - (node.record.draining_since or begun)  # by a manager that was killed

        def ended() -> bool:
            return not gates.goals(*UNENDED) and not gates.goals_beyond

        def over() -> bool:
            nonlocal looked, since
            if (beat := gates.page.beat(gates.index)) != looked:
                looked, since = beat, time.monotonic()
            return ended() or time.monotonic() - since > STOPPED or self._hangs() is not None

        found = []
        await node.comes_true(over, max(0.0, node.component.stop_times.patience - waited))
        if not ended():
            unended, seconds = _unended(gates), time.monotonic() - begun + waited
            gates.cancel_goals()
            await node.comes_true(ended, CANCELLING)
            found.append(f"{unended} had not ended after {seconds:.0f} s (`patience`), and cancelling was asked for")
            if not ended():
                found.append(f"{_unended(gates)} had not ended {CANCELLING:g} s later")
        await node.comes_true(lambda: not (gates.goals(GoalState.ENDED) or gates.goals_apart), CANCELLING)
        if lost := await self._keep_results():
            is_one = lost.total() == 1
            found.append(
                f"the result{'' if is_one else 's'} of {_counted(lost)} that no client had fetched "
                f"{'is' if is_one else 'are'} lost"
            )
        return found

    async def _keep_results(self) -> Counter[str]:
        """Keep the results that no client has fetched; how many are lost all the same, by ROS action.

        Each that is kept makes room for one of a goal that the page had none for.
        """
        gates, lost = self._gates, Counter[str]()
        asked: set[bytes] = set()
        left: dict[KnownGoal, int] = {}

        def kept(goal: KnownGoal, number: int) -> bool:
            try:
                return gates.keep_result(goal, number)
            except BackendError:
                lost[goal.action] += 1
                return True

        def all_are_kept() -> bool:
            for goal in gates.unfetched():
                if goal.id not in asked:
                    left[goal] = gates.ask_for_result(goal)
                    asked.add(goal.id)
            for goal, number in list(left.items()):
                if kept(goal, number):
                    del left[goal]
            return not left and gates.goals_apart <= gates.goals_beyond

        with contextlib.suppress(BackendError):  # it cannot be asked any further
            await self._node.comes_true(all_are_kept, CANCELLING)
        for goal, number in left.items():
            gates.page.withdraw(gates.index, number)
            lost[goal.action] += 1
        lost.update(goal.action for goal in gates.unfetched() if goal.id not in asked)
        if (apart := gates.goals_apart - gates.goals_beyond) > 0:
            lost[""] += apart
        return lost


def _unended(gates: Gates) -> str:
    """The goals that have not ended, in words."""
    unended = gates.goals(*UNENDED)
    if beyond := gates.goals_beyond:
        unended[""] = beyond
    return _counted(unended)


def _counted(goals: Counter[str]) -> str:
    """The goals of each ROS action, in words. Of those that the page has no room for, it is not known of which one."""
    which = {name: f"of ROS action {name}" if name else f"beyond the {GOALS} that are listed" for name in goals}
    return ", ".join(f"{number} goal{'s' * (number != 1)} {which[name]}" for name, number in sorted(goals.items()))
