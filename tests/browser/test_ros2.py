"""The dashboard's page while a talker is replaced on ROS 2."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect

from tests.browser.conftest import Opened, system
from tests.cli.conftest import EXAMPLES

pytestmark = [pytest.mark.browser, pytest.mark.ros2, pytest.mark.full, pytest.mark.timeout(300)]


def test_a_talker_is_replaced_before_the_eyes(opened: Opened) -> None:
    with system("talker", EXAMPLES / "talker" / "talker.json", backend="ros2") as talker:
        page = opened(talker)
        expect(page.locator('.component[data-name="listener"] .port-row')).to_have_attribute("data-state", "met")
        done = talker.midstride("replace", "talker", "NewTalker", "--yes")
        assert done.status == 0, done.err
        expect(page.locator(".component .type", has_text="NewTalker")).to_be_visible()
        expect(page.locator(".component")).to_have_count(2)
        expect(page.locator(".event-list")).to_contain_text("measured at 1 subscriber")
        expect(page.locator("#connection")).to_have_text("● live")
