"""The conformance checks as parameters of tests on real ROS: those that `make test` leaves out are marked."""

from __future__ import annotations

import pytest

from tests.conformance import CHECKS, SERVICE_CHECKS

# `make test` runs these: start and stop, attach, carry over state, hand over, and what each does when something fails.
# The simulator runs all checks every time, and `make test-all` runs all of them on every ROS.
ESSENTIAL = {
    "starts_registers_and_waits",
    "stops_in_order",
    "ends_what_does_not_end",
    "refuses_a_name_in_use",
    "finds_what_an_earlier_manager_started",
    "obeys_its_manager_only",
    "answers_a_repeat_as_before",
    "attaches_and_detaches",
    "counts_behind_a_closed_gate",
    "carries_state_over",
    "degrades_where_user_code_raises",
    "hands_over_on_the_grid",
    "hands_over_what_messages_drive",
    "hands_over_a_latched_topic",
    "resumes_unless_confirmed",
    "cancels_a_cut",
}
assert {check.__name__ for check in CHECKS} >= ESSENTIAL

CHECKS_ON_ROS = [
    pytest.param(check, id=check.__name__, marks=() if check.__name__ in ESSENTIAL else pytest.mark.full)
    for check in CHECKS
]
# All but the essential ones cost a second or two each.
SERVICE_CHECKS_ON_ROS = [
    pytest.param(check, id=check.__name__, marks=() if check.__name__ == "hands_over_requests" else pytest.mark.full)
    for check in SERVICE_CHECKS
]
