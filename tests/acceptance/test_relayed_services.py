"""Servers of services and ROS actions, in plain rclpy behind relays, replace each other, and one with the API, or the
library.

Meanwhile bare clients call them.

Where one of the two is killed meanwhile: `test_failing_servers`.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.lang.load import load_text
from midstride.model.specification import Specification
from tests.acceptance import acting
from tests.acceptance.foreign_support import robot
from tests.acceptance.serving import CLIENTS, COUNTING_OURS, SERVER, called
from tests.acceptance.support import ended
from tests.backends.ros2_support import run

pytestmark = pytest.mark.ros2

FUNCTIONALITIES = """
  functionality talk { produces out  mode normal { guarantee out : std_msgs/msg/String @ 50 Hz }  mode degraded { } }
  functionality counting { produces count  mode normal { guarantee count : Listing }  mode off { } }
"""
TEXT = f"""system serving
contract Listing = rcl_interfaces/srv/ListParameters
topic /chat : std_msgs/msg/String @ 50 Hz
service /count : Listing
component Relayed {{
  run "python3 server.py" gate relay
  output out as chatter
  server count
{FUNCTIONALITIES}
}}
component Other like Relayed {{ run "python3 ./server.py" gate relay }}
component Ours {{
  run "python3 ours.py"
  output out
  server count
{FUNCTIONALITIES}
}}
component Plain like Relayed {{ run "python3 server.py" gate preload }}
node talker : Relayed {{ out -> /chat  count -> /count }}
"""


def written(folder: Path) -> Specification:
    """A node that serves behind a relay, in ``folder``; it can become `Other`, also behind one, and `Ours`."""
    for name, text in (("server", SERVER), ("clients", CLIENTS), ("ours", COUNTING_OURS)):
        (folder / f"{name}.py").write_text(text)
    return load_text(TEXT).require()


@pytest.mark.full
def test_each_request_to_a_relayed_server_is_answered_once(tmp_path: Path) -> None:
    specification = written(tmp_path)

    async def scenario() -> None:
        async with robot(specification, tmp_path) as made:
            async with called(tmp_path, made, clients=10):  # which judges that each request is handled once
                for component in ("Other", "Plain", "Ours"):
                    await made.replaced(component)
            assert made.holes() == []

    with ended():
        run(scenario(), 120)


ACTIONS = f"""system serving
contract Count = test_msgs/action/Fibonacci
topic /chat : std_msgs/msg/String @ 50 Hz
action /count : Count
component Relayed {{
  run "python3 server.py" gate relay
  output out as chatter
  action server count
{FUNCTIONALITIES.replace("Listing", "Count")}
}}
component Other like Relayed {{ run "python3 ./server.py" stop patience 30 s gate relay }}
component Own {{
  run "python3 own.py"
  output out
  action server count
{FUNCTIONALITIES.replace("Listing", "Count")}
}}
node talker : Relayed {{ out -> /chat  count -> /count }}
"""


@pytest.mark.long
@pytest.mark.parametrize("components", [("Other", "Relayed", "Own", "Relayed") * 3])
def test_each_goal_of_a_relayed_server_is_executed_once(tmp_path: Path, components: tuple[str, ...]) -> None:
    """Each fourth is cancelled; goals in progress finish where they were accepted."""
    pytest.importorskip("test_msgs.action", reason="no package with a ROS action is installed")
    for name, text in (("server", acting.SERVER), ("client", acting.CLIENT), ("own", acting.OWN)):
        (tmp_path / f"{name}.py").write_text(text)

    async def scenario() -> None:
        async with robot(load_text(ACTIONS).require(), tmp_path) as made:
            async with acting.asked(
                tmp_path, made, 15, relayed=True
            ) as goals:  # which judges that each is executed once
                for component in components:
                    await made.replaced(component)
            print(f"{len(goals.ended)} goals in {len(components)} replacements")

    with ended():
        run(scenario(), 600)


@pytest.mark.long
@pytest.mark.parametrize("takes", [0, 30], ids=["at once", "30 ms"])
def test_each_request_is_answered_once_in_many_replacements(tmp_path: Path, takes: int) -> None:
    specification = written(tmp_path)
    components = ("Other", "Relayed", "Ours", "Plain", "Ours", "Relayed", "Plain", "Relayed") * 3

    async def scenario() -> None:
        async with robot(specification, tmp_path) as made:
            async with called(tmp_path, made, clients=20 if takes == 0 else 2, takes=takes) as calls:
                for component in components:
                    await made.replaced(component)
                    if component == "Other":  # relayed programs go on without a manager
                        await made.another_manager()
            slowest = max(each.latency for each in calls.answered)
            print(f"{len(calls.answered)} requests in {len(components)} replacements; the slowest took {slowest:.3f} s")

    with ended():
        run(scenario(), 600)
