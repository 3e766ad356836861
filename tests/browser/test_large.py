"""Many components: groups are collapsed, and what deviates is visible nevertheless."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import pytest
from playwright.sync_api import Browser, Page, expect

from midstride.runtime.records.status_forms import InstanceStatus
from tests.browser.conftest import PATIENCE
from tests.browser.synthetic import Synthetic, component, functionality, large, port, serving

pytestmark = [pytest.mark.browser, pytest.mark.full]


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    context = browser.new_context(viewport={"width": 1600, "height": 960})
    context.set_default_timeout(PATIENCE)
    faults: list[str] = []
    context.on("weberror", lambda error: faults.append(str(error.error)))
    yield context.new_page()
    context.close()
    assert faults == []


def show(page: Page, synthetic: Synthetic) -> None:
    page.goto(synthetic.url)
    page.wait_for_selector(".graph .component[transform], .graph .collapsed[transform]")


def in_mode(found: InstanceStatus, mode: str) -> InstanceStatus:
    return msgspec.structs.replace(found, functionalities=[functionality("work", mode)])


def test_groups_are_collapsed_above_fifty_components_and_open_on_demand(page: Page) -> None:
    with serving(Synthetic(large(60, 90, groups=3))) as synthetic:
        show(page, synthetic)
        expect(page.locator(".collapsed")).to_have_count(3)
        expect(page.locator(".component")).to_have_count(0)
        expect(page.locator('.collapsed[data-group="g:/area_00"] .square')).to_have_count(20)
        page.locator('.collapsed[data-group="g:/area_00"]').click()
        expect(page.locator(".component")).to_have_count(20)
        expect(page.locator(".collapsed")).to_have_count(2)
        page.locator('.handle[data-group="g:/area_00"]').focus()
        page.keyboard.press("Enter")
        expect(page.locator(".collapsed")).to_have_count(3)
        expect(page.locator(".component")).to_have_count(0)


def test_fifty_components_are_shown_one_by_one(page: Page) -> None:
    with serving(Synthetic(large(50, 60, groups=2))) as synthetic:
        show(page, synthetic)
        expect(page.locator(".component")).to_have_count(50)


def test_a_collapsed_group_lists_a_topic_whose_contract_is_not_satisfied(page: Page) -> None:
    synthetic = Synthetic([in_mode(each, "normal") for each in large(60, 90, groups=3)])
    synthetic.topics = [msgspec.structs.replace(each, satisfied=each.name != "/topic_0") for each in synthetic.topics]
    with serving(synthetic):
        show(page, synthetic)
        expect(page.locator('.collapsed[data-group="g:/area_00"]')).to_contain_text("▲ /topic_0: contract")
        expect(page.locator(".collapsed .listed", has_text="contract")).to_have_count(1)


def test_a_collapsed_group_shows_and_lists_what_deviates(page: Page) -> None:
    calm = [in_mode(each, "normal") for each in large(60, 90, groups=3)]
    with serving(Synthetic(calm)) as synthetic:
        show(page, synthetic)
        group = page.locator('.collapsed[data-group="g:/area_01"]')
        expect(group.locator(".counts")).to_have_text("20 components")
        place = group.get_attribute("transform")
        synthetic.patch([in_mode(synthetic.components["area_01/node_07"], "degraded")])
        expect(group.locator('.square[data-kind="degraded"]')).to_have_count(1)
        expect(group.locator(".counts")).to_have_text("20 components · 1 not as specified")
        expect(group).to_contain_text("○ area_01/node_07: degraded")
        expect(page.locator("#summary")).to_contain_text("1 degraded")
        assert group.get_attribute("transform") == place  # only a mode has changed: the layout is as before


def test_search_opens_the_group_of_what_was_sought(page: Page) -> None:
    with serving(Synthetic(large(60, 90, groups=3))) as synthetic:
        show(page, synthetic)
        page.keyboard.press("/")
        page.keyboard.type("area_02/node_13")
        page.keyboard.press("Enter")
        expect(page.locator('.component[data-name="area_02/node_13"]')).to_be_in_viewport()
        expect(page.locator("#details h2")).to_have_text("area_02/node_13")


def test_a_new_component_moves_the_others_and_keeps_them(page: Page) -> None:
    talker = component("talker", [functionality("work")], [port("out", "out", "/chatter")])
    with serving(Synthetic([talker])) as synthetic:
        show(page, synthetic)
        page.locator('.component[data-name="talker"]').evaluate("element => { element.isTheSame = true; }")
        synthetic.patch([component("listener", [functionality("work")], [port("in", "in", "/chatter", 4.0)])])
        expect(page.locator(".component")).to_have_count(2)
        expect(page.locator('.component[data-name="listener"] .figures-text')).to_have_text("▼ 4 / 10 Hz")
        assert page.locator('.component[data-name="talker"]').evaluate("element => element.isTheSame") is True
