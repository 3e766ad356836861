"""What forbids a change is on the page: a lock, and what changes require; before a change is asked for, and after."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser.conftest import Opened, System, system
from tests.browser.test_changes import choose, components, press
from tests.cli.conftest import EXAMPLES

pytestmark = [pytest.mark.browser, pytest.mark.full]

# The emergency stop is a node of the system: its parameter says whether it is released.
GUARDED = """
system guarded
topic /chatter : std_msgs/msg/String @ 10 Hz
topic /estop/released : std_msgs/msg/Bool @ 10 Hz
changes require /estop/released : std_msgs/msg/Bool where data = true
component Talker {
  run "python3 talker.py"
  output out
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 10 Hz }
    mode degraded { }
  }
}
component EmergencyStop {
  run "python3 estop.py"
  output out
  parameters { changeable released = true }
  functionality say {
    produces out
    mode normal { guarantee out : std_msgs/msg/Bool @ 10 Hz }
    mode degraded { }
  }
}
node talker : Talker { out -> /chatter }
node estop : EmergencyStop { out -> /estop/released }
"""

ESTOP = """
from midstride import Component
from std_msgs.msg import Bool

comp = Component("estop")
out = comp.create_output("out", Bool)
released = comp.parameter("released", True, on_change=lambda value: None)
say = comp.create_functionality("say", outputs=[out])
say.set_normal_mode(lambda: out.write(Bool(data=released.value)), rate=10, outputs=[out])
say.set_degraded_mode(lambda: None)
comp.start()
"""


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[System]:
    (tmp_path / "guarded.stride").write_text(GUARDED)
    (tmp_path / "estop.py").write_text(ESTOP)
    (tmp_path / "talker.py").write_text((EXAMPLES / "talker" / "talker.py").read_text())
    with system("guarded", tmp_path / "guarded.stride") as found:
        yield found


def asked_to(page: Page, what: str, node: str) -> None:
    page.get_by_label("What to do").select_option(what)
    page.get_by_label("Node", exact=True).select_option(node)


def test_a_lock_is_shown_and_refuses_until_it_ends(talker: System, opened: Opened) -> None:
    page, other = opened(talker), opened(talker)
    summaries = [each.locator("#summary") for each in (page, other)]
    expect(summaries[0]).not_to_contain_text("locked")
    reason = "a person is <b>inside</b> the cell"
    assert talker.midstride("lock", "--reason", reason, "--by", "alice").status == 0
    try:
        for summary in summaries:
            expect(summary).to_contain_text(f"⚿ locked by alice: {reason}")
        expect(page.locator(".event-list li").first).to_contain_text("the system is locked by alice since")
        choose(page, "talker", "NewTalker")
        press(page, "Plan")
        expect(page.locator("#change .permission")).to_contain_text(
            "It may not be carried out now: the system is locked by alice since"
        )
        press(page, "Execute")
        outcome = page.locator("#change .outcome")
        expect(outcome).to_contain_text("Refused, nothing was changed: the system is locked by alice since")
        expect(outcome).to_contain_text(reason)
        assert components(talker)["talker"] == "Talker"
        other.reload()
        expect(summaries[1]).to_contain_text(f"⚿ locked by alice: {reason}")
    finally:
        unlocked = talker.midstride("unlock", "--by", "bob")
    assert unlocked.status == 0
    for summary in summaries:
        expect(summary).not_to_contain_text("locked")
    expect(page.locator(".event-list li").first).to_contain_text("bob has unlocked the system, which alice had locked")
    press(page, "Close")
    press(page, "Plan")
    expect(page.locator("#change .step")).to_have_count(4)
    expect(page.locator("#change .permission")).to_have_count(0)


def test_what_changes_require_is_shown_and_whether_it_holds(guarded: System, opened: Opened) -> None:
    page = opened(guarded)
    summary, permission = page.locator("#summary"), page.locator("#change .permission")
    requirement = "changes require /estop/released : std_msgs/msg/Bool where data = true"
    expect(summary).not_to_contain_text("changes are refused")
    asked_to(page, "restart", "talker")
    press(page, "Plan")
    expect(permission).to_have_text(f"Required: {requirement}: it holds.")

    assert guarded.midstride("param", "set", "estop", "released", "false").status == 0
    expect(summary).to_contain_text("⚿ changes are refused: /estop/released, data is False")
    expect(page.locator(".event-list li").first).to_contain_text(f"{requirement}: data is False")
    press(page, "Plan")
    expect(permission.first).to_contain_text(f"It may not be carried out now: {requirement}: data is False")
    expect(permission.last).to_contain_text(f"Required: {requirement}: data is False")
    press(page, "Execute")
    expect(page.locator("#change .outcome")).to_contain_text(f"Refused, nothing was changed: {requirement}")
    press(page, "Close")
    page.get_by_label("What to do").select_option("param")
    page.get_by_label("Node", exact=True).select_option("estop")
    page.get_by_label("Value").fill("true")
    press(page, "Set")
    expect(page.locator("#change .refusal")).to_contain_text(f"{requirement}: data is False")

    set_ = guarded.midstride("param", "set", "estop", "released", "true", "--despite-requirements")
    assert set_.status == 0, set_.err
    expect(summary).not_to_contain_text("changes are refused")
    asked_to(page, "restart", "talker")
    press(page, "Plan")
    expect(permission).to_have_text(f"Required: {requirement}: it holds.")
    press(page, "Execute")
    expect(page.locator("#change .outcome")).to_contain_text("Done in")
