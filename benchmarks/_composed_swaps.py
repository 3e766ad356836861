"""Swaps of a component in a container: by ROS's own services, and by Midstride. See benchmarks/swap.py.

Of rclcpp_components there are no wheels: by default the container is the stand-in of the tests, in C on rcl. With
`--components`, it is the one of rclcpp_components that is installed, with talkers of the user's packages.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PATIENCE = 20.0
CONTAINER = "pipeline"


@dataclass(frozen=True)
class Components:
    """Composable nodes that publish a String on `chatter` at 50 Hz, and where their container is found.

    ``talker`` and ``lifecycle``: package and class; the latter is a lifecycle node.
    """

    talker: tuple[str, str] = ("demo", "demo::Talker")
    lifecycle: tuple[str, str] = ("managed", "managed::Source")
    container: Path | None = None

    def prepared(self, folder: Path) -> Components:
        """With the stand-in compiled into ``folder``, in the environment of this process."""
        from tests.composition import StandIn

        stand_in = StandIn(folder)
        stand_in.install(
            "managed",
            classes=("managed::Source",),
            source=Path(__file__).with_name("_lifecycle_component.c"),
            libraries=["lifecycle_msgs__rosidl_typesupport_c"],
        )
        os.environ["AMENT_PREFIX_PATH"] = f"{folder}:{os.environ.get('AMENT_PREFIX_PATH', '')}"
        os.environ["PYTHONPATH"] = f"{stand_in.python}:{os.environ.get('PYTHONPATH', '')}"
        sys.path.insert(0, str(stand_in.python))
        return Components(container=folder / "lib" / "rclcpp_components" / "component_container")

    def specification(self) -> str:
        """A container with two components on /swap and /other."""
        package, plugin = self.talker
        return f"""system swap_container

topic /swap  : std_msgs/msg/String @ 45 Hz
topic /other : std_msgs/msg/String @ 45 Hz

container {CONTAINER} {{ run "component_container" package "rclcpp_components" }}

component Source {{
  run component "{plugin}" package "{package}" gate preload
  output out as chatter
  functionality talk {{
    produces out
    mode normal {{ guarantee out : std_msgs/msg/String @ 45 Hz }}
    mode degraded {{ }}
  }}
}}
component OtherSource like Source {{ run component "{plugin}" package "{package}" gate preload }}

node source    : Source in {CONTAINER} {{ out -> /swap }}
node neighbour : Source in {CONTAINER} {{ out -> /other }}
"""


class Container:
    """A container that runs, and a node that calls its services."""

    def __init__(self, components: Components) -> None:
        import rclpy

        assert components.container is not None
        words = [str(components.container), "--ros-args", "-r", f"__node:={CONTAINER}"]
        self._process = subprocess.Popen(words, start_new_session=True)
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node("loader", context=self._context)
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._clients: dict[str, Any] = {}

    def call(self, type_: Any, service: str, request: Any) -> Any:
        if service not in self._clients:
            self._clients[service] = self._node.create_client(type_, service)
            if not self._clients[service].wait_for_service(timeout_sec=PATIENCE):
                raise SystemExit(f"{service} is not there")
        future = self._clients[service].call_async(request)
        self._executor.spin_until_future_complete(future, timeout_sec=PATIENCE)
        if not (future.done() and future.result().success):
            raise SystemExit(f"{service} has failed: {future.result() if future.done() else 'no answer'}")
        return future.result()

    def load(self, component: tuple[str, str], name: str, topic: str) -> int:
        from composition_interfaces.srv import LoadNode

        package, plugin = component
        request = LoadNode.Request(
            package_name=package, plugin_name=plugin, node_name=name, remap_rules=[f"chatter:={topic}"]
        )
        return int(self.call(LoadNode, f"/{CONTAINER}/_container/load_node", request).unique_id)

    def unload(self, id_: int) -> None:
        from composition_interfaces.srv import UnloadNode

        self.call(UnloadNode, f"/{CONTAINER}/_container/unload_node", UnloadNode.Request(unique_id=id_))

    def change(self, name: str, transition: int) -> None:
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        request = ChangeState.Request(transition=Transition(id=transition))
        self.call(ChangeState, f"/{name}/change_state", request)

    def close(self) -> None:
        import rclpy

        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)
        self._process.kill()
        self._process.wait()


@contextmanager
def container(components: Components) -> Iterator[Container]:
    """A container that has loaded a neighbour of what is swapped."""
    found = Container(components)
    try:
        found.load(components.talker, "neighbour", "/other")
        yield found
    finally:
        found.close()


def by_loading(components: Components, swaps: int, timed: Callable[[Callable[[], None]], None]) -> None:
    """One component is unloaded, and the same one loaded again."""
    with container(components) as found:
        ids = [found.load(components.talker, "source", "/swap")]
        time.sleep(2)
        for _ in range(swaps):

            def swap() -> None:
                found.unload(ids[-1])
                ids.append(found.load(components.talker, "source", "/swap"))
                time.sleep(0.5)  # until it certainly writes: the window must hold its first messages

            timed(swap)


def by_lifecycle_in_container(components: Components, swaps: int, timed: Callable[[Callable[[], None]], None]) -> None:
    """Of two lifecycle components of a container, one is deactivated, and the other activated."""
    from lifecycle_msgs.msg import Transition

    names = ("first", "second")
    with container(components) as found:
        for name in names:
            found.load(components.lifecycle, name, "/swap")
            found.change(name, Transition.TRANSITION_CONFIGURE)
        found.change("first", Transition.TRANSITION_ACTIVATE)
        time.sleep(2)
        for number in range(swaps):
            old, new = names[number % 2], names[1 - number % 2]

            def swap(old: str = old, new: str = new) -> None:
                found.change(old, Transition.TRANSITION_DEACTIVATE)
                found.change(new, Transition.TRANSITION_ACTIVATE)

            timed(swap)
