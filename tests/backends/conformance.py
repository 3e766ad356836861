"""The conformance checks as parameters of tests on real ROS: those that `make test` leaves out are marked."""

from __future__ import annotations

from typing import Any

import pytest

from tests.conformance import CHECKS, SERVICE_CHECKS, Check

# `make test` runs these: start and stop, attach, carry over state, hand over, and what some do when something fails.
# The simulator runs all checks every time, and `make test-all` runs all of them on every ROS, of the
# walks one of each kind.
ESSENTIAL = {
    "starts_registers_and_waits",
    "stops_in_order",
    "ends_what_does_not_end",
    "refuses_a_name_in_use",
    "finds_what_an_earlier_manager_started",
    "obeys_its_manager_only",
    "answers_a_repeat_as_before",
    "attaches_and_detaches",
    "carries_state_over",
    "degrades_where_user_code_raises",
    "hands_over_on_the_grid",
    "hands_over_what_messages_drive",
    "hands_over_a_latched_topic",
    "cancels_a_cut",
}
assert {check.__name__ for check in CHECKS} >= ESSENTIAL

# All but the essential ones cost a second or two each, and those that are among the long tests more.
ESSENTIAL_OF_SERVICES = {"hands_over_requests"}
LONG = {"has_the_results_that_its_predecessor_has_left"}
FIRST_WALKS = {"walks_at_random_1", "walks_at_random_with_services_1"}


def _on_ros(check: Check) -> Any:
    """With its mark: the walks with further seeds are among the long tests, which have many more."""
    name = check.__name__
    if name in ESSENTIAL | ESSENTIAL_OF_SERVICES:
        return pytest.param(check, id=name)
    further = name.startswith("walks_at_random_") and name not in FIRST_WALKS
    return pytest.param(check, id=name, marks=pytest.mark.long if further or name in LONG else pytest.mark.full)


assert {check.__name__ for check in SERVICE_CHECKS} >= LONG
CHECKS_ON_ROS = [_on_ros(check) for check in CHECKS]
SERVICE_CHECKS_ON_ROS = [_on_ros(check) for check in SERVICE_CHECKS]
