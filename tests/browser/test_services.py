"""Services and ROS actions that are declared: drawn and described as such, from their servers to their clients."""

from __future__ import annotations

import pytest
from playwright.sync_api import Browser, expect

from tests.browser.conftest import PATIENCE
from tests.browser.synthetic import Synthetic, component, functionality, port, service_port, serving

pytestmark = [pytest.mark.browser, pytest.mark.full]

MAP, DOCK = "nav_msgs/srv/GetMap", "nav2_msgs/action/DockRobot"


def system() -> Synthetic:
    work = [functionality("work")]
    return Synthetic(
        [
            component("maps", work, [service_port("map", "out", "/map", MAP), port("scan", "out", "/scan")]),
            component(
                "docking",
                work,
                [
                    service_port("map", "in", "/map", MAP),
                    service_port("dock", "out", "/dock", DOCK),
                    port("scan", "in", "/scan"),
                ],
            ),
            component("mission", work, [service_port("dock", "in", "/dock", DOCK)]),
        ]
    )


def test_services_differ_from_topics(browser: Browser) -> None:
    with serving(system()) as served:
        page = browser.new_page()
        page.set_default_timeout(PATIENCE)
        page.goto(served.url)
        shape = page.locator('.topic[data-topic="/map"]')
        expect(shape).to_have_class("topic service")
        expect(shape).to_have_attribute("aria-label", f"service /map; {MAP}; contract satisfied")
        dock = page.locator('.topic[data-topic="/dock"]')
        expect(dock).to_have_attribute("aria-label", f"ROS action /dock; {DOCK}; contract satisfied")
        expect(page.locator('.topic[data-topic="/scan"]')).to_have_class("topic")
        expect(page.locator(".link.service")).to_have_count(4)
        expect(page.locator(".link:not(.service)")).to_have_count(2)
        expect(page.locator(".port-name", has_text="⇄ map")).to_have_count(2)
        expect(page.locator("header")).to_contain_text("3 components · 1 topic · 2 services")

        shape.click()
        details = page.locator("#details")
        expect(details).to_contain_text(f"service · {MAP}")
        expect(details.locator("h3")).to_have_text(["Server (1)", "Clients (1)"])
        details.get_by_role("button", name="docking.map").click()
        rows = details.locator("table tbody tr:first-child")
        expect(rows).to_have_text(["⇄ mapclient", "⇄ dockaction server", "→ scan10 Hz10 Hz"])
        for word in ("Hz", "ublish", "ubscri"):
            expect(details.locator("tbody", has_text="⇄").first).not_to_contain_text(word)
        page.close()
