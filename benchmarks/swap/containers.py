"""Ways to replace a component in a container: by ROS's own services, and by Midstride.

Of rclcpp_components there are no wheels: the container is the stand-in of the tests, in C on rcl, with components of
component.c, whose constructors do no work.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

from .handovers import ByMidstride
from .services import Services, services
from .streams import TYPE, Stream
from .systems import NAME
from .ways import Setting, Swap, Way

CONTAINER = "pipeline"
PACKAGE = "swap"


class StandIn:
    """The stand-in for rclcpp_components with this comparison's components, compiled when it is first used."""

    @cached_property
    def prefix(self) -> Path:
        """The folder that it is installed in; it is found by what is started from now on. Raises pytest's Skipped."""
        from tests.composition import StandIn as OfTests

        folder = Path(self._folder.name)
        made = OfTests(folder)
        classes, libraries = ("swap::Source", "swap::Managed"), ["lifecycle_msgs__rosidl_typesupport_c"]
        source = Path(__file__).parent / "programs" / "component.c"
        made.install(PACKAGE, classes=classes, source=source, libraries=libraries)
        sys.path.insert(0, str(made.python))
        return folder

    @cached_property
    def _folder(self) -> tempfile.TemporaryDirectory[str]:
        return tempfile.TemporaryDirectory(prefix="container")

    def environment(self) -> dict[str, str]:
        """The variables by which it is found, beside those of this process."""
        python = self.prefix / "lib" / "python"
        return {
            name: os.pathsep.join([str(first), *filter(None, [os.environ.get(name)])])
            for name, first in (("AMENT_PREFIX_PATH", self.prefix), ("PYTHONPATH", python))
        }


STAND_IN = StandIn()


def _missing() -> str | None:
    import pytest  # its tests are skipped where it cannot be compiled

    try:
        STAND_IN.prefix  # noqa: B018  # it is compiled
    except pytest.skip.Exception as because:
        return str(because)
    return None


class Container:
    """A container that runs."""

    def __init__(self, called: Services, stream: Stream) -> None:
        self._services, self._stream = called, stream

    def load(self, plugin: str, name: str, topic: str) -> int:
        from composition_interfaces.srv import LoadNode
        from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue

        def parameter(name: str, value: float) -> Any:
            number = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=float(value))
            return Parameter(name=name, value=number)

        request = LoadNode.Request(
            package_name=PACKAGE,
            plugin_name=plugin,
            node_name=name,
            remap_rules=[f"chatter:={topic}"],
            parameters=[parameter("rate", self._stream.rate), parameter("size", self._stream.size)],
        )
        return int(self._services.call(LoadNode, f"/{CONTAINER}/_container/load_node", request).unique_id)

    def unload(self, id_: int) -> None:
        from composition_interfaces.srv import UnloadNode

        request = UnloadNode.Request(unique_id=id_)
        self._services.call(UnloadNode, f"/{CONTAINER}/_container/unload_node", request)


@contextmanager
def container(setting: Setting) -> Iterator[tuple[Container, Services]]:
    """A container that has loaded a neighbour of what is swapped."""
    program = STAND_IN.prefix / "lib" / "rclcpp_components" / "component_container"
    words = [str(program), "--ros-args", "-r", f"__node:={CONTAINER}"]
    env = {**setting.host.env, **STAND_IN.environment()}
    process = subprocess.Popen(words, env=env, start_new_session=True)
    try:
        with services() as called:
            found = Container(called, setting.stream)
            found.load("swap::Source", "neighbour", "/other")
            yield found, called
    finally:
        process.kill()
        process.wait()


class Loading(Way):
    """A component is unloaded, and the same one loaded again: its old code, and none of its state."""

    name, title, seconds = "load", "container: `unload_node`, then `load_node`", 0.1

    def missing(self, setting: Setting) -> str | None:
        return _missing()

    @contextmanager
    def running(self, setting: Setting) -> Iterator[Swap]:
        with container(setting) as (found, _):
            ids = [found.load("swap::Source", "source", "/swap")]

            def swap() -> None:
                found.unload(ids[-1])
                ids.append(found.load("swap::Source", "source", "/swap"))

            yield swap


class ManagedComponents(Way):
    """Of two lifecycle components of a container, one is deactivated, and the other activated."""

    name, title, seconds = "load_lifecycle", "container: lifecycle, both loaded before", 0.1

    def missing(self, setting: Setting) -> str | None:
        return _missing()

    @contextmanager
    def running(self, setting: Setting) -> Iterator[Swap]:
        names = ["first", "second"]
        with container(setting) as (found, called):

            def swap() -> None:
                called.change(names[0], "deactivate")
                called.change(names[1], "activate")
                names.reverse()

            for name in names:
                found.load("swap::Managed", name, "/swap")
                called.change(name, "configure")
            called.change(names[0], "activate")
            yield swap


class ComposedHandover(ByMidstride):
    """A component leaves its container for a process, and then one process for another; a neighbour keeps running."""

    name, title = "composed", "Midstride, without its API: a container's component"

    def missing(self, setting: Setting) -> str | None:
        return _missing()

    @contextmanager
    def running(self, setting: Setting) -> Iterator[Swap]:
        STAND_IN.prefix  # noqa: B018  # it is compiled
        found = {**setting.host.env, **STAND_IN.environment()}
        with super().running(setting.on(found)) as swap:
            yield swap

    def text(self, setting: Setting) -> str:
        contract = f"{TYPE} @ {0.9 * setting.stream.rate:g} Hz"
        rate, size = setting.stream.words
        run = f'run component "swap::Source" package "{PACKAGE}" gate preload'
        return f"""system {NAME}

topic /swap  : {contract}
topic /other : {contract}

container {CONTAINER} {{ run "component_container" package "rclcpp_components" }}

component Source {{
  {run}
  parameters {{ rate = {float(rate)} size = {float(size)} }}
  output out as chatter
  functionality talk {{
    produces out
    mode normal {{ guarantee out : {contract} }}
    mode degraded {{ }}
  }}
}}
component OtherSource like Source {{ {run} }}

node source    : Source in {CONTAINER} {{ out -> /swap }}
node neighbour : Source in {CONTAINER} {{ out -> /other }}
"""
