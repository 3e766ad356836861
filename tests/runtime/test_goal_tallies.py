"""What the report of a change says of goals, from what both instances of a node have counted."""

from __future__ import annotations

from midstride.runtime.change.goal_tallies import goal_tallies
from midstride.wire.state import GoalCounts
from tests.plan.test_estimates import replacement

PLAN = replacement()  # of a by a_2


def test_goals_are_counted_from_the_beginning_of_the_change_on() -> None:
    before = {"a": GoalCounts(accepted=10, ended=6, cancelled=1)}  # so 3 are in progress
    ended = GoalCounts(accepted=12, ended=9, cancelled=2)
    now = {"a": ended, "a_2": GoalCounts(accepted=5, ended=2, cancelled=1, unknown=1)}
    found = goal_tallies(PLAN, before, now, lambda name: name == "a")["a"]
    assert (found.old, found.new, found.accepted) == ("a", "a_2", 3 + 2 + 5)
    assert (found.ended_at_old, found.ended_at_new, found.cancelled) == (3, 2, 2)
    assert (found.in_progress, found.lost, found.unknown) == (2, 1, 1)
    assert found.words == (
        "10 goals of ROS actions of a and a_2: 3 ended at a, 2 at a_2, 2 cancelled, 2 in progress and 1 lost with "
        "their instance; 1 request about goals that neither knew"
    )


def test_after_a_roll_back_the_old_instance_goes_on() -> None:
    now = {"a": GoalCounts(accepted=2, ended=1), "a_2": GoalCounts()}
    found = goal_tallies(PLAN, {"a": GoalCounts(accepted=1)}, now, lambda name: name == "a_2")["a"]
    assert (found.accepted, found.ended_at_old, found.in_progress, found.lost) == (2, 1, 1, 0)
    assert found.words == "2 goals of ROS actions of a and a_2: 1 ended at a, 0 at a_2, 0 cancelled and 1 in progress"


def test_nothing_is_said_of_nodes_without_goals_meanwhile() -> None:
    counts = GoalCounts(accepted=3, ended=3)
    assert goal_tallies(PLAN, {"a": counts}, {"a": counts, "a_2": GoalCounts()}, lambda name: name == "a") == {}
    assert goal_tallies(PLAN, {}, {}, lambda name: False) == {}
