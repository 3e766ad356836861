"""A swap of the talker on real ROS 2, carried out on the page and watched there."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.browser.conftest import Opened, System, system
from tests.browser.test_changes import choose, counts, press
from tests.cli.conftest import EXAMPLES

pytestmark = [pytest.mark.ros2, pytest.mark.browser, pytest.mark.full]


@pytest.fixture
def ros_talker() -> Iterator[System]:
    with system("talker", EXAMPLES / "talker" / "talker.stride", "--backend", "ros2") as found:
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


SERVICES = """
system services
topic /chatter : std_msgs/msg/String @ 10 Hz
component Keeper {{
  run "{python} {folder}/keeper.py"
  output out
  allows service /map/list   allows service ~/reset
  functionality work {{
    produces out
    mode normal {{ guarantee out : std_msgs/msg/String @ 10 Hz }}
    mode degraded {{ }}
  }}
}}
component Caller {{
  run "{prefix}{python} {folder}/caller.py"
  input in : std_msgs/msg/String @ 10 Hz
  allows service /map/list
  functionality work {{ uses in   mode normal {{ assume in }}   mode degraded {{ }} }}
}}
node keeper : Keeper {{ out -> /chatter }}
node caller : Caller {{ in <- /chatter }}
"""
KEEPER = """
from midstride import Component
from rcl_interfaces.srv import ListParameters
from std_msgs.msg import String

comp = Component("keeper")
out = comp.create_output("out", String)
work = comp.create_functionality("work", outputs=[out])
work.set_normal_mode(lambda: out.write(String(data="hello")), rate=10, outputs=[out])
work.set_degraded_mode(lambda: None)

@comp.on_setup
def set_up(node):
    for name in ("/map/list", "~/reset"):
        node.create_service(ListParameters, name, lambda request, response: response)

comp.start()
"""
CALLER = """
from midstride import Component
from rcl_interfaces.srv import ListParameters
from std_msgs.msg import String

comp = Component("caller")
heard = comp.create_input("in", String, rate=10)
work = comp.create_functionality("work", inputs=[heard])
work.set_normal_mode(lambda message: None, inputs=[heard])
work.set_degraded_mode(lambda: None)

@comp.on_setup
def set_up(node):
    comp.client = node.create_client(ListParameters, "/map/list")

comp.start()
"""


@pytest.fixture
def services(tmp_path: Path) -> Iterator[System]:
    """A node that serves what another one calls. The other one has another host's name, where that can be given."""
    (tmp_path / "keeper.py").write_text(KEEPER)
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "there.sh").write_text('hostname robot-2 && exec "$@"\n')
    prefix = f"unshare --uts sh {tmp_path}/there.sh " if namespaces() else ""
    file = tmp_path / "services.stride"
    file.write_text(SERVICES.format(python=sys.executable, folder=tmp_path, prefix=prefix))
    with system("services", file, "--backend", "ros2") as found:
        yield found


def namespaces() -> bool:
    return os.geteuid() == 0 and None not in (shutil.which("unshare"), shutil.which("hostname"))


def test_services_lead_from_the_node_that_calls_to_the_one_that_serves_also_on_another_host(
    services: System, opened: Opened
) -> None:
    page = opened(services)
    expect(page.locator('.topic.service[data-topic="service /map/list"]')).to_be_visible()
    expect(page.locator(".link.service")).to_have_count(2)
    keeper = page.locator('.component[data-name="keeper"]')
    expect(keeper.locator('.port-row[data-direction="out"] .port-name')).to_have_text(
        ["out", "⇄ ~/reset", "⇄ /map/list"]
    )
    caller = page.locator('.component[data-name="caller"] .port-row[data-direction="in"] .port-name')
    expect(caller).to_have_text(["in", "⇄ /map/list"])
    page.locator('.topic.service[data-topic="service /map/list"]').click()
    expect(page.locator("#details li")).to_have_text(["caller calls it", "keeper serves it"])
    if not namespaces():
        pytest.skip("giving a process another host's name takes root")
    page.get_by_label("Group by").select_option("host")
    expect(page.locator(".group.open .title")).to_have_text(["this host", "robot-2"])
    page.get_by_role("button", name="Collapse all groups").click()
    expect(page.locator(".collapsed .title")).to_have_text(["this host", "robot-2"])
    expect(page.locator(".bundle .label")).to_have_text(["1 topic, 1 service"])
