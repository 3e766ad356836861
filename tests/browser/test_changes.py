"""A change on the page: planned, compared, carried out, watched, rolled back, and looked back at."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, Route, expect

from midstride.cli.change_options import new_node, parse_value
from tests.browser.conftest import Opened, System, system
from tests.cli.conftest import EXAMPLES
from tests.cli.test_param import PROGRAM, SPECIFICATION

pytestmark = [pytest.mark.browser, pytest.mark.full]


def choose(page: Page, node: str, component: str) -> None:
    page.get_by_label("Node", exact=True).select_option(node)
    page.get_by_label("Component", exact=True).select_option(component)


def press(page: Page, name: str) -> None:
    page.locator("#change").get_by_role("button", name=name, exact=True).click()


def components(system: System) -> dict[str, str]:
    return {each["role"]: each["component"] for each in system.midstride("status", "--json").json["instances"]}


def counts(system: System) -> str:
    """What the history says of the latest change: on a busy machine, messages are missed."""
    [change] = system.midstride("history", "-n", "1", "--json").json["changes"]
    [swap] = change["swaps"]
    return f"{swap['subscriber']}: missed {swap['missed']}, lost {swap['lost']}, duplicates {swap['duplicates']}"


def test_a_plan_is_shown_as_the_command_line_shows_it_and_changes_nothing(talker: System, opened: Opened) -> None:
    page = opened(talker)
    choose(page, "talker", "NewTalker")
    expect(page.locator("#change .command").first).to_contain_text("midstride plan --replace talker=NewTalker")
    press(page, "Plan")
    expect(page.locator("#change .step")).to_have_count(4)
    printed = talker.midstride("plan", "--replace", "talker=NewTalker").out
    shown = " ".join(page.locator("#change").inner_text().split())
    for line in printed.splitlines()[2:]:
        words = re.split(r"  +", line.strip())
        assert all(word in shown for word in words), line
    expect(page.locator('.component[data-name="talker_2"]')).to_be_visible()
    expect(page.locator("#change .command")).to_have_text(re.compile("midstride replace talker NewTalker"))
    press(page, "Discard")
    expect(page.locator('.component[data-name="talker_2"]')).to_have_count(0)
    assert components(talker) == {"talker": "Talker", "listener": "Listener"}


def test_strategies_are_compared_on_one_axis(talker: System, opened: Opened) -> None:
    page = opened(talker)
    choose(page, "talker", "NewTalker")
    press(page, "Compare strategies")
    table = page.get_by_role("region", name="Strategies")
    for strategy in ("minimal", "paper", "quiesce", "stop"):
        expect(table.get_by_role("row", name=strategy)).to_be_visible()
    axes = page.locator("#change svg.axis")
    expect(axes).not_to_have_count(0)
    labels = {axes.nth(index).locator(".axis-tick").last.text_content() for index in range(axes.count())}
    assert len(labels) == 1, "all axes reach to the same time"
    table.get_by_role("button", name="stop").click()
    expect(page.locator("#change .falls")).to_contain_text("talker.talk")
    expect(page.locator("#change .command").first).to_contain_text("--strategy stop")


def test_a_refusal_shows_the_words_of_the_planner(talker: System, opened: Opened) -> None:
    page = opened(talker)
    choose(page, "listener", "Talker")
    press(page, "Plan")
    refused = talker.midstride("plan", "--replace", "listener=Talker").err.strip()
    words = refused.removeprefix("midstride: ").removeprefix("error: ").strip()
    expect(page.locator("#change .refusal")).to_contain_text("it has no port in (on /chatter)")
    shown = page.locator("#change .refusal").inner_text()
    assert shown in refused or words in shown


def test_a_change_is_carried_out_watched_and_rolled_back(own_talker: System, opened: Opened, tmp_path: Path) -> None:
    page = opened(own_talker)
    other = opened(own_talker)  # a second tab sees the same change
    choose(page, "talker", "NewTalker")
    press(page, "Plan")
    press(page, "Execute")
    for tab in (page, other):
        expect(tab.locator(".change-progress .step")).to_have_count(4)
    expect(page.locator("#change .outcome")).to_contain_text("Done in")
    expect(page.locator("#change .axis-heading")).to_contain_text("/chatter → listener.in")
    expect(page.locator("#change .counts")).to_have_text(counts(own_talker))
    expect(page.locator('.component[data-name="talker_2"]')).to_be_visible()
    expect(other.locator('.component[data-name="talker_2"]')).to_be_visible()
    past = page.locator("#timeline .past-change").filter(has_text="replace talker with NewTalker: done")
    expect(past).to_have_count(1)
    assert components(own_talker)["talker"] == "NewTalker"

    with page.expect_download() as saving:
        press(page, "Save report")
    file = tmp_path / "change.html"
    saving.value.save_as(file)
    report = page.context.new_page()
    report.goto(file.as_uri())
    expect(report.locator("h1")).to_have_text("dashboard: replace talker with NewTalker")
    expect(report.locator('.component[data-name="talker_2"]')).to_be_visible()

    scrubbed(page)
    press(page, "Roll back")
    expect(page.locator("#change .panel-title").get_by_text("rollback to version 1")).to_be_visible()
    expect(page.locator("#change .outcome")).to_contain_text("Done in")
    assert components(own_talker)["talker"] == "Talker"
    history = own_talker.midstride("history", "--json").json["changes"]
    assert [change["by"] for change in history[1:]] == [
        "dashboard: replace talker with NewTalker",
        "dashboard: rollback to version 1",
    ]


def scrubbed(page: Page) -> None:
    """Back to before the change, by the keyboard: the graph follows, and one key leads back."""
    slider = page.get_by_role("slider", name="Time that is shown")
    slider.focus()
    for _ in range(100):
        with page.expect_response(re.compile("/view/at")) as view:
            page.keyboard.press("ArrowLeft")
        if {row["name"] for row in view.value.json()["instances"]} == {"talker", "listener"}:
            break
    expect(page.locator('.component[data-name="talker"]')).to_be_visible()
    expect(page.locator('.component[data-name="talker_2"]')).to_have_count(0)
    expect(page.locator("#timeline .cursor")).to_be_visible()
    assert re.fullmatch(r"\d\d:\d\d:\d\d\.\d", slider.get_attribute("aria-valuetext") or "")
    page.keyboard.press("n")
    expect(slider).to_have_attribute("aria-valuetext", "live")
    expect(page.locator('.component[data-name="talker_2"]')).to_be_visible()


def test_a_change_without_an_answer_is_not_said_to_be_refused(own_talker: System, opened: Opened) -> None:
    """The manager completes a change whose client has gone."""
    page = opened(own_talker)
    choose(page, "talker", "NewTalker")
    press(page, "Plan")
    expect(page.locator("#change .step")).to_have_count(4)
    page.route("**/api/v1/change", lambda route: route.abort())
    press(page, "Execute")
    banner = page.locator("#change .change-result .banner")
    expect(banner).to_contain_text("No answer:")
    expect(banner).to_contain_text("may carry the change out all the same")
    expect(banner).not_to_contain_text("Refused")


def test_an_earlier_time_is_not_said_to_be_shown_before_its_view_has_come(talker: System, opened: Opened) -> None:
    page = opened(talker)
    asked: list[Route] = []
    page.route(re.compile("/view/at"), lambda route: asked.append(route))
    page.get_by_role("slider", name="Time that is shown").focus()
    page.keyboard.press("ArrowLeft")
    expect(page.locator("#connection")).to_contain_text("◌")
    expect(page.locator("#stale")).to_be_hidden()
    for route in asked:
        route.continue_()
    expect(page.locator("#stale")).to_contain_text("What is shown is the past")
    expect(page.locator("#connection")).to_contain_text("◷")


def test_why_shows_the_chain_of_what_was_lowered_on_the_graph(own_talker: System, opened: Opened) -> None:
    page = opened(own_talker)
    assert own_talker.midstride("remove", "talker", "--yes").status == 0
    segment = page.locator('#timeline .timeline-row[data-name="listener.listen"] [role="button"]').last
    expect(segment).to_be_visible()
    segment.focus()
    page.keyboard.press("Enter")
    chain = page.locator(".why-chain")
    expect(chain).to_contain_text("/chatter")
    why = own_talker.midstride("why", "listener.listen", "--json").json
    for line in why["chain"]:
        expect(chain).to_contain_text(line)
    expect(page.get_by_text("midstride why listener.listen")).to_be_visible()


def test_a_change_by_the_command_line_is_watched_too(own_talker: System, opened: Opened) -> None:
    page = opened(own_talker)
    command = own_talker.midstride.start("replace", "talker", "NewTalker", "--yes")
    try:
        expect(page.locator(".change-progress .panel-title").first).to_have_text("replace talker with NewTalker")
        expect(page.locator(".change-progress .step")).to_have_count(4)
        assert command.wait(60) == 0
        expect(page.locator(".change-progress .banner")).to_have_text("ended: done")
        expect(page.locator(".change-progress .axis-heading")).to_contain_text("/chatter → listener.in")
        page.locator(".change-progress").get_by_role("button", name="Close").click()
        expect(page.locator(".change-progress .step")).to_have_count(0)
    finally:
        command.kill()
        command.wait()
        assert command.stdout is not None
        command.stdout.close()


def test_an_edited_file_is_planned_and_its_errors_are_listed(talker: System, opened: Opened, tmp_path: Path) -> None:
    page = opened(talker)
    text = (EXAMPLES / "talker" / "talker.stride").read_text()
    file = tmp_path / "edited.stride"
    file.write_text(text.replace("node talker   : Talker", "node talker : NewTalker"))
    assert file.read_text() != text
    chooser = page.locator('#change input[type="file"]')
    chooser.set_input_files(file)
    expect(page.locator("#change .step")).to_have_count(4)
    expect(page.locator("#change .command").first).to_have_text(re.compile("midstride apply edited.stride --keep-code"))
    file.write_text(text.replace("node talker   : Talker", "node talker : Nobody"))
    chooser.set_input_files(file)
    printed = talker.midstride("check", str(file))
    assert printed.status == 1
    refusal = page.locator("#change .refusal")
    expect(refusal).to_contain_text("edited.stride:")
    expect(refusal).to_contain_text("Nobody")
    file.write_text("#" * 1_000_001 + "\n" + text)
    chooser.set_input_files(file)
    expect(page.locator("#change .change-result .banner")).to_contain_text("edited.stride is too large")


def test_a_rehearsal_says_how_its_runs_ended(talker: System, opened: Opened) -> None:
    page = opened(talker)
    choose(page, "talker", "NewTalker")
    press(page, "Rehearse")
    expect(page.locator("#change .banner")).to_contain_text("all that has to hold held", timeout=120_000)
    expect(page.locator("#change")).to_contain_text("How the change ended:")
    expect(page.locator("#change .command").last).to_contain_text("midstride simulate")


def commands(page: Page) -> list[str]:
    return page.locator("#change .command code").all_inner_texts()


def sent(page: Page, path: str, button: str) -> Any:
    """What a button sends to the manager."""
    with page.expect_request(f"**/api/v1{path}") as request:
        press(page, button)
    return request.value.post_data_json


def test_a_node_is_added_by_the_request_of_the_command_beside_it(own_talker: System, opened: Opened) -> None:
    page = opened(own_talker)
    page.get_by_label("What to do").select_option("add")
    expect(page.locator("#change").get_by_role("button", name="Plan", exact=True)).to_be_disabled()
    page.get_by_label("Name of the new node").fill("second")
    page.get_by_label("Component", exact=True).select_option("Listener")
    page.get_by_label("topic of in").fill("/chatter")
    shown = commands(page)
    assert shown[0] == "midstride plan --add 'second Listener in=/chatter' --explain"
    planned = own_talker.midstride(*shlex.split(shown[0])[1:], "--json").json
    asked = sent(page, "/plan", "Plan")
    assert asked["add"] == [new_node("second", "Listener", ["in=/chatter"])]
    expect(page.locator("#change .step")).to_have_count(len(planned["steps"]))
    expect(page.locator('.component[data-name="second"][data-planned="true"]')).to_be_visible()
    expect(page.locator("#change .command")).to_contain_text("midstride add second Listener in=/chatter")
    press(page, "Execute")
    expect(page.locator("#change .outcome")).to_contain_text("Done in")
    expect(page.locator('.component[data-name="second"] .mode-name')).to_have_text("normal")
    assert components(own_talker) == {"talker": "Talker", "listener": "Listener", "second": "Listener"}
    [*_, change] = own_talker.midstride("history", "--json").json["changes"]
    assert change["by"] == "dashboard: add second (Listener)"


def test_a_replacement_may_stay_in_the_process_of_its_container(talker: System, opened: Opened) -> None:
    """The page is told that the listener is in a container; the manager knows of none, and refuses it."""

    def told(route: Route) -> None:
        answer = route.fetch()
        document = answer.json()
        document["containers"] = {"pipeline": {"run": "component_container", "package": "rclcpp_components"}}
        document["nodes"]["listener"]["container"] = "pipeline"
        route.fulfill(response=answer, json=document)

    page = opened(talker)
    option = page.get_by_label("same process")
    choose(page, "talker", "NewTalker")
    expect(option).to_be_hidden()
    page.route("**/api/v1/specification", told)
    page.reload()
    page.get_by_label("What to do").select_option("restart")
    page.get_by_label("Node", exact=True).select_option("listener")
    option.check()
    assert commands(page)[0] == "midstride plan --restart listener --same-process --explain"
    asked = sent(page, "/plan", "Plan")
    assert (asked["restart"], asked["same_process"]) == (["listener"], True)
    refused = "no node of a container is replaced, so none can stay in its process"
    expect(page.locator("#change .refusal")).to_contain_text(refused)
    page.get_by_label("Node", exact=True).select_option("talker")
    expect(option).to_be_hidden()
    assert commands(page)[0] == "midstride plan --restart talker --explain"


def test_a_version_is_chosen_to_go_back_to(own_talker: System, opened: Opened) -> None:
    for component in ("NewTalker", "Talker", "NewTalker"):
        assert own_talker.midstride("replace", "talker", component, "--yes").status == 0
    page = opened(own_talker)
    page.get_by_label("What to do").select_option("rollback")
    version = page.get_by_label("Version")
    expect(version.locator("option")).not_to_have_count(0)
    earlier = version.locator("option").evaluate_all("options => options.map((each) => Number(each.value))")
    now = own_talker.midstride("history", "--json").json["changes"][-1]["version"]
    assert now not in earlier and earlier == sorted(earlier, reverse=True) and min(earlier) == 1
    version.select_option("1")
    expect(page.locator("#change .command")).to_contain_text("midstride rollback 1 --dry-run")
    press(page, "Plan")
    expect(page.locator("#change .step")).to_have_count(4)
    expect(page.locator("#change .command")).to_have_text(re.compile("midstride rollback 1"))
    press(page, "Execute")
    expect(page.locator("#change .outcome")).to_contain_text("Done in")
    assert components(own_talker)["talker"] == "Talker"


@pytest.fixture
def tuned(tmp_path: Path) -> Iterator[System]:
    (tmp_path / "tuned.json").write_text(SPECIFICATION)
    (tmp_path / "talker.py").write_text(PROGRAM)
    with system("tuned", tmp_path / "tuned.json") as found:
        yield found


@pytest.mark.parametrize(("name", "text"), [("gain", "2.5"), ("gain", "-3"), ("names", '["on", "b"]')])
def test_a_parameter_is_set_by_the_request_of_the_command_beside_it(
    tuned: System, opened: Opened, name: str, text: str
) -> None:
    page = opened(tuned)
    page.get_by_label("What to do").select_option("param")
    page.get_by_label("Parameter", exact=True).select_option(name)
    page.get_by_label("Value").fill(text)
    [command] = commands(page)
    *words, value = shlex.split(command)
    assert words == ["midstride", "param", "set", "talker", name]
    asked = sent(page, "/parameters", "Set")
    assert asked == {"node": "talker", "parameters": {name: parse_value(value)}}
    expect(page.locator("#change .banner")).to_contain_text(f"talker: {name} =")
    parameters = tuned.midstride("param", "get", "talker", name, "--json").json
    assert (parameters["value"], parameters["set_at_run_time"]) == (parse_value(text), True)


def test_the_values_of_an_added_node_are_written_as_its_command_reads_them(tuned: System, opened: Opened) -> None:
    page = opened(tuned)
    page.get_by_label("What to do").select_option("add")
    page.get_by_label("Name of the new node").fill("second")
    page.get_by_label("Component", exact=True).select_option("Talker")
    page.get_by_label("topic of out").fill("/chatter")
    page.get_by_label("gain", exact=True).fill("1e-7")
    asked = sent(page, "/plan", "Plan")
    assert asked["add"] == [new_node("second", "Talker", ["out=/chatter"], ["gain=1.0e-7"])]
    expect(page.locator("#change .command")).to_contain_text("--param gain=1.0e-7")


def test_a_refused_value_is_refused_in_the_nodes_words(tuned: System, opened: Opened) -> None:
    page = opened(tuned)
    page.get_by_label("What to do").select_option("param")
    page.get_by_label("Value").fill("-20")
    press(page, "Set")
    expect(page.locator("#change .refusal")).to_contain_text("it must be at least -10")
