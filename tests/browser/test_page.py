"""The dashboard's page in Chromium: what it shows of a running system, and how it is used."""

from __future__ import annotations

import os
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import pytest
from playwright.sync_api import Browser, expect

from midstride.runtime.records.status_forms import CrashedInstance, ParameterStatus
from midstride.verdicts.conditions import system_condition
from tests.browser.conftest import Opened, System
from tests.browser.synthetic import Synthetic, component, functionality, serving

pytestmark = [pytest.mark.browser, pytest.mark.full]

AXE = Path(__file__).parents[2] / ".cache" / "browser" / "axe-4.11.0.min.js"


def test_the_graph_shows_components_topics_modes_and_rates(talker: System, opened: Opened) -> None:
    page = opened(talker)
    expect(page.locator(".component")).to_have_count(2)
    expect(page.locator('.component[data-name="listener"] .functionality')).to_contain_text("listen")
    expect(page.locator('.component[data-name="listener"] .functionality .mode-name')).to_have_text("normal")
    expect(page.locator('.topic[data-topic="/chatter"]')).to_be_visible()
    expect(page.locator('.component[data-name="listener"] .figures-text')).to_contain_text("/ 10 Hz")
    expect(page.locator(".link")).to_have_count(2)
    expect(page.locator("#system")).to_have_text("talker")
    expect(page.locator("#connection")).to_have_text("● live")


def test_details_of_the_selected_component_say_why(talker: System, opened: Opened) -> None:
    page = opened(talker)
    page.locator('.component[data-name="listener"]').click()
    details = page.locator("#details")
    expect(details.locator("h2")).to_have_text("listener")
    expect(details.locator('.modes [aria-current="true"]')).to_contain_text("normal")
    expect(details).to_contain_text("10 Hz")
    details.get_by_role("button", name="why?").click()
    expect(details.locator(".chain li").first).not_to_be_empty()
    details.get_by_role("button", name="/chatter").click()
    expect(details.locator("h2")).to_have_text("/chatter")
    details.get_by_role("button", name="talker.out").click()
    expect(details.locator("h2")).to_have_text("talker")
    page.keyboard.press("Escape")
    expect(details).to_contain_text("Choose a component")


def test_the_page_shows_the_present_also_where_nothing_has_changed_for_long(browser: Browser) -> None:
    """The view's time is since when it is so: to a page that is opened an hour later, that is not the present."""
    mode = msgspec.structs.replace(functionality("work"), since=time.time() - 7_300)
    synthetic = Synthetic([component("worker", [mode], [])])
    synthetic.quiet = 3_600.0
    with serving(synthetic), closing(browser.new_context()) as context:
        page = context.new_page()
        page.goto(synthetic.url)
        page.locator('.component[data-name="worker"]').click()
        expect(page.locator("#details .because")).to_contain_text("for 2 h 1 min.")


def test_numbers_that_are_not_finite_are_shown_and_texts_that_look_like_them_stay_texts(browser: Browser) -> None:
    values: list[tuple[str, Any, Any, bool]] = [
        ("gain", {"float": "nan"}, 1.5, True),
        ("label", "inf", "nan", True),
        ("limits", [1.0, {"float": "-inf"}], [1.0, {"float": "inf"}], True),
        ("top", {"float": "inf"}, {"float": "inf"}, False),
    ]
    synthetic = Synthetic([component("worker", [], [], parameters=[ParameterStatus(*each) for each in values])])
    with serving(synthetic), closing(browser.new_context()) as context:
        page = context.new_page()
        page.goto(synthetic.url)
        page.locator('.component[data-name="worker"]').click()
        rows = page.locator("#details tbody tr")
        expect(rows).to_have_text(
            [
                "gain.nanset at run time; started with 1.5",
                "labelinfset at run time; started with nan",
                "limits[1,-.inf]set at run time; started with [1,.inf]",
                "top.inf",
            ]
        )


def test_a_robot_that_came_up_in_part_is_not_shown_as_up(browser: Browser) -> None:
    """A program that is done counts as up; a node that could not be started is shown with its reason."""
    because = "camera exited with status 1 before it registered: no device"
    done = component("spawner", [], [], pid=None, reachable=False, answers=False, done=True, node=None)
    synthetic = Synthetic(
        [component("worker", [functionality("work")], []), done],
        [CrashedInstance("camera", 1, "no device", "`midstride restart camera` restores it", None, "camera", because)],
    )
    synthetic.condition = system_condition(3, 2, [because])
    with serving(synthetic), closing(browser.new_context()) as context:
        page = context.new_page()
        page.goto(synthetic.url)
        expect(page.locator("#summary")).to_contain_text("▲ degraded")
        expect(page.locator("#summary")).to_contain_text("✕ 1 crashed")
        expect(page.locator("#summary")).not_to_contain_text("not answering")
        spawner, camera = (page.locator(f'.component[data-name="{name}"]') for name in ("spawner", "camera"))
        expect(spawner).to_have_attribute("data-kind", "normal")
        expect(spawner.locator(".type")).to_have_text("done")
        expect(spawner.locator(".glyph")).to_have_text("✓")
        spawner.click()
        expect(page.locator("#details")).to_contain_text("Its program has ended as it should")
        expect(camera).to_have_attribute("data-kind", "gone")
        name, words = (camera.locator(which).bounding_box() for which in (".name", ".type"))
        assert name is not None and words is not None and name["y"] < words["y"], "neither is on the other"
        expect(camera.locator(".type")).to_have_text("crashed")
        camera.click()
        expect(page.locator("#details")).to_contain_text(because)
        synthetic.crashed, synthetic.condition = [], system_condition(3, 2, ["camera does not run"])
        page.reload()
        expect(page.locator("#summary")).to_contain_text("▲ degraded, 2 of 3 nodes run: camera does not run")
        synthetic.condition = system_condition(2, 0, ["worker does not run"])
        page.reload()
        expect(page.locator("#summary")).to_contain_text("▲ down")


def test_the_keyboard_reaches_everything(talker: System, opened: Opened) -> None:
    page = opened(talker)
    page.locator('.component[data-name="talker"]').focus()
    page.keyboard.press("ArrowRight")
    assert page.evaluate("document.activeElement.dataset.topic") == "/chatter"
    page.keyboard.press("ArrowRight")
    assert page.evaluate("document.activeElement.dataset.name") == "listener"
    page.keyboard.press("Enter")
    expect(page.locator("#details h2")).to_have_text("listener")
    page.keyboard.press("/")
    page.keyboard.type("talk")
    expect(page.locator("#found [aria-selected=true]")).to_contain_text("talker")
    page.keyboard.press("Enter")
    expect(page.locator("dialog")).to_have_count(0)
    expect(page.locator("#details h2")).to_have_text("talker")
    page.keyboard.press("?")
    expect(page.get_by_role("dialog")).to_contain_text("Keys and signs")
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    page.keyboard.press("l")
    assert page.evaluate("document.documentElement.dataset.size") == "large"


def test_colours_follow_the_system_and_the_switch(talker: System, opened: Opened) -> None:
    paper = "getComputedStyle(document.body).backgroundColor"
    light, dark = opened(talker, color_scheme="light"), opened(talker, color_scheme="dark")
    assert light.evaluate(paper) != dark.evaluate(paper)
    light.get_by_role("button", name="Dark colours").click()
    assert light.evaluate(paper) == dark.evaluate(paper)
    light.reload()
    expect(light.locator(".component").first).to_be_visible()
    assert light.evaluate(paper) == dark.evaluate(paper)


def test_a_phone_shows_the_graph_and_needs_no_sideways_scrolling(talker: System, opened: Opened) -> None:
    page = opened(talker, viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    box = page.locator('.component[data-name="talker"] .box').bounding_box()
    assert box is not None and box["x"] >= 0 and box["x"] + box["width"] <= 390
    page.locator('.component[data-name="talker"]').tap()
    expect(page.locator("#details h2")).to_have_text("talker")


def test_the_picture_can_be_saved(talker: System, opened: Opened, tmp_path: Path) -> None:
    page = opened(talker)
    with page.expect_download() as download:
        page.get_by_role("button", name="Save the picture").click()
    saved = tmp_path / "talker.svg"
    download.value.save_as(saved)
    text = saved.read_text()
    assert "listener" in text and "--panel:rgb" in text and "light-dark" not in text.split("svg{")[1].split("}")[0]


# A graph like the page's, beside it, with the plan that the manager makes.
GHOSTS = """async (request) => {
  const { createGraph } = await import("/dashboard/graph/graph.js");
  const { byName } = await import("/dashboard/store.js");
  const { ask } = await import("/dashboard/api.js");
  const element = document.createElement("div");
  element.id = "planned";
  document.querySelector("#graph").replaceChildren(element);
  const graph = createGraph(element);
  graph.draw(byName(await ask("GET", "/view")));
  graph.ghosts(await ask("POST", "/plan", request));
  window.planned = graph;
}"""


def test_a_plan_is_drawn_as_ghosts(talker: System, opened: Opened) -> None:
    page = opened(talker)
    page.evaluate(GHOSTS, {"replace": [["talker", "NewTalker"]]})
    new = page.locator('#planned .component[data-planned="true"]')
    expect(new).to_have_count(1)
    expect(new).to_contain_text("+ planned")
    expect(new).to_contain_text("NewTalker")
    expect(page.locator('#planned .component[data-fate="removed"]')).to_contain_text("− will be removed")
    expect(page.locator('#planned .link[data-fate="created"]')).to_have_count(1)
    expect(page.locator('#planned .link[data-fate="removed"]')).to_have_count(1)
    page.evaluate("window.planned.ghosts(null)")
    expect(page.locator("#planned .component")).to_have_count(2)
    expect(page.locator('#planned .component[data-fate="removed"]')).to_have_count(0)


@pytest.mark.parametrize("colours", ["light", "dark"])
def test_axe_finds_no_barrier(talker: System, opened: Opened, colours: str) -> None:
    if not AXE.is_file():
        reason = "axe-core is not installed (tools/browser)"
        assert os.environ.get("CI") != "true", reason
        pytest.skip(reason)
    page = opened(talker, color_scheme=colours, bypass_csp=True)
    page.locator('.component[data-name="listener"]').click()
    page.get_by_label("What to do").select_option("add")
    page.add_script_tag(path=AXE)
    found = page.evaluate("axe.run().then(({violations}) => violations)")
    assert [(each["id"], [node["html"][:200] for node in each["nodes"]]) for each in found] == []


def test_a_replacement_appears_in_two_tabs_without_reloading_them(own_talker: System, opened: Opened) -> None:
    talker = own_talker
    pages = [opened(talker), opened(talker)]
    for page in pages:
        page.evaluate("window.notReloaded = true")
    done = talker.midstride("replace", "talker", "NewTalker", "--yes")
    assert done.status == 0, done.err
    for page in pages:
        expect(page.locator(".component .type", has_text="NewTalker")).to_be_visible()
        expect(page.locator(".component")).to_have_count(2)
        expect(page.locator(".event-list")).to_contain_text("done")
        assert page.evaluate("window.notReloaded") is True
    done = talker.midstride("rollback", "--yes")
    assert done.status == 0, done.err
    for page in pages:
        expect(page.locator(".component .type", has_text="NewTalker")).to_have_count(0)


def test_a_killed_manager_is_said_plainly_and_found_again(own_talker: System, opened: Opened) -> None:
    talker = own_talker
    page = opened(talker)
    talker.kill_manager()
    stale = page.locator("#stale")
    expect(stale).to_be_visible()
    expect(stale).to_contain_text("No connection")
    expect(stale).to_contain_text("since")
    expect(page.locator("#connection")).to_have_text("✕ connection lost")
    expect(page.locator(".component")).to_have_count(2)
    talker.up()  # with a new token, as any manager
    page.context.set_extra_http_headers({"Authorization": f"Bearer {talker.token}"})
    expect(page.locator("#connection")).to_have_text("● live")
    expect(stale).to_be_hidden()
    expect(page.locator(".component")).to_have_count(2)
