"""The report as a file from disk, without a network: what it says, and what hostile names do to it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from midstride.cli import main
from tests.browser.conftest import PATIENCE
from tests.cli.conftest import EXAMPLES
from tests.examples import json_form

pytestmark = [pytest.mark.browser, pytest.mark.full]

HOSTILE = "</script><img src=x onerror=fail()>"
PLANS = {
    "a swap that degrades nothing": ("talker/talker.stride", "--replace", "talker=NewTalker"),
    "a removal that degrades": ("obstacle/obstacle.stride", "--remove", "detector"),
    "a stop": ("filter/filter.stride", "--replace", "filter=MedianFilter", "--strategy", "stop"),
    "a capacity": ("patrol/patrol.stride", "--replace", "camera_detector=LargeDetector", "--explain"),
}


@pytest.fixture
def offline(browser: Browser) -> Iterator[Page]:
    faults: list[str] = []
    context = browser.new_context(viewport={"width": 1280, "height": 900}, offline=True)
    context.set_default_timeout(PATIENCE)
    context.on("weberror", lambda error: faults.append(str(error.error)))
    context.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
    requests: list[str] = []
    context.on("request", lambda request: requests.append(request.url))
    yield context.new_page()
    context.close()
    assert faults == [] and all(url.startswith(("file:", "data:")) for url in requests)


@pytest.mark.parametrize("words", PLANS.values(), ids=PLANS)
def test_a_plan_says_everything_that_the_command_line_prints(
    offline: Page, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    file = tmp_path / "plan.html"
    assert main(["plan", str(EXAMPLES / words[0]), *words[1:], "--html", str(file)]) == 0
    printed = capsys.readouterr().out
    offline.goto(file.as_uri())
    expect(offline.locator(".component[transform]").first).to_be_visible()
    shown = " ".join(offline.locator("#report").inner_text().split())
    title, _, *lines = printed.splitlines()  # without the heads of the table
    assert [word for line in [title, *lines] for word in line.split() if word not in shown] == []
    for line in lines:
        if ":" in line and "  " not in line.strip():
            assert " ".join(line.split()) in shown


@pytest.mark.parametrize("options", [(), ("--compare",)])
def test_what_changes_require_is_in_the_plan_of_a_file(offline: Page, tmp_path: Path, options: tuple[str, ...]) -> None:
    requirement = "changes require /estop/released : std_msgs/msg/Bool where data = true"
    text = (EXAMPLES / "talker" / "talker.stride").read_text()
    system, file = tmp_path / "talker.stride", tmp_path / "plan.html"
    system.write_text(f"{text}\n{requirement}\n")
    assert main(["plan", str(system), "--replace", "talker=NewTalker", "--html", str(file), *options]) == 0
    offline.goto(file.as_uri())
    expect(offline.locator("#report .permission")).to_have_text(f"Required when it is carried out: {requirement}.")


def test_hostile_names_are_text(offline: Page, tmp_path: Path) -> None:
    specification = json_form("talker")
    for component in specification["components"].values():
        component["parameters"] = {"label": {"value": HOSTILE}}
    specification["nodes"]["talker"]["parameters"] = {"label": HOSTILE}
    system = tmp_path / "x.json"
    system.write_text(json.dumps(specification))
    file = tmp_path / "plan.html"
    assert main(["plan", str(system), "--replace", "talker=NewTalker", "--html", str(file)]) == 0
    offline.goto(file.as_uri())
    expect(offline.locator(".component[transform]").first).to_be_visible()
    offline.get_by_text("Before, as JSON").click()
    expect(offline.locator("pre").first).to_contain_text("onerror=fail()")
    assert offline.locator("img").count() == 0


def test_the_graph_is_shown_before_with_the_plan_and_after(offline: Page, tmp_path: Path) -> None:
    file = tmp_path / "plan.html"
    talker = str(EXAMPLES / "talker" / "talker.stride")
    assert main(["plan", talker, "--replace", "talker=NewTalker", "--html", str(file)]) == 0
    offline.goto(file.as_uri())
    names = offline.locator(".component[transform]")
    expect(names).to_have_count(3)
    offline.get_by_role("button", name="Before").click()
    expect(names).to_have_count(2)
    expect(offline.locator('.component[data-name="talker"]')).to_be_visible()
    offline.get_by_role("button", name="After").click()
    expect(offline.locator('.component[data-name="talker_2"]')).to_be_visible()
    expect(offline.locator('.component[data-name="talker"]')).to_have_count(0)
