"""A swap of the talker on real ROS 2, carried out on the page and watched there."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import expect

from tests.browser.conftest import Opened, System, system
from tests.browser.test_changes import choose, counts, press
from tests.cli.conftest import EXAMPLES

pytestmark = [pytest.mark.ros2, pytest.mark.browser, pytest.mark.full, pytest.mark.timeout(240)]


@pytest.fixture
def ros_talker() -> Iterator[System]:
    with system("talker", EXAMPLES / "talker" / "talker.json", "--backend", "ros2") as found:
        yield found


def test_a_swap_on_ros2_is_watched_and_its_gap_is_shown(ros_talker: System, opened: Opened) -> None:
    assert ros_talker.midstride("status", "--json").json["backend"] == "ros2"
    page = opened(ros_talker)
    expect(page.locator('.component[data-name="listener"] .figures-text')).to_contain_text("10 Hz")
    choose(page, "talker", "NewTalker")
    press(page, "Plan")
    expect(page.locator('.component[data-name="talker_2"]')).to_be_visible()
    press(page, "Execute")
    expect(page.locator(".change-progress .step")).to_have_count(4)
    expect(page.locator("#change .outcome")).to_contain_text("Done in", timeout=60_000)
    expect(page.locator("#change .counts")).to_have_text(counts(ros_talker))
    expect(page.locator("#change .axis-heading")).to_contain_text("/chatter → listener.in")
    expect(page.locator('.component[data-name="talker"]')).to_have_count(0)
