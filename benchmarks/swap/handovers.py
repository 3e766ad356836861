"""The ways of Midstride: its hand-over with and without its API, and its strategy that removes before it creates."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path

from .systems import running, with_api, without_api
from .ways import Setting, Swap, Way

TALKER = Path(__file__).parent / "programs" / "talker.cpp"


class ByMidstride(Way):
    """A node of a system that is up is replaced by another one of the same program."""

    seconds = 2.0
    strategy = "minimal"

    def text(self, setting: Setting) -> str:
        """The specification of the system."""
        raise NotImplementedError

    @contextmanager
    def running(self, setting: Setting) -> Iterator[Swap]:
        with running(setting.host, self.text(setting)) as system:

            def swap() -> str | None:
                outcome = system.change(self.strategy)
                return None if outcome.outcome == "done" else str(outcome.because)

            yield swap


class Handover(ByMidstride):
    """Both nodes use Midstride's API, and the system has a subscriber that relies on the stream."""

    name, title = "handover", "Midstride, with its API"
    backends = ("ros2", "ros1")

    def text(self, setting: Setting) -> str:
        return with_api(setting.host.nodes, setting.stream)


class Paper(Handover):
    """As before, but the old node is removed before the new one is created."""

    name, title, seconds = "paper", "Midstride's `paper`: remove, then create", 3.0
    strategy = "paper"


class Gated(ByMidstride):
    """Plain nodes on rclpy, behind a gate: a library in the process, or a relay beside it."""

    def __init__(self, gate: str, title: str) -> None:
        self.name, self.title, self._gate = f"gate_{gate}", title, gate

    def text(self, setting: Setting) -> str:
        return without_api(self.command(setting), self._gate, setting.stream)

    def command(self, setting: Setting) -> Sequence[str]:
        """How the node is started, which publishes on `chatter`."""
        return ["python3", str(setting.host.nodes), "bare", "bare", *setting.stream.words, "chatter"]


class OnRclcpp(Gated):
    """The same of nodes in C++ on rclcpp, where a ROS 2 that has it is sourced, and a compiler is there."""

    def __init__(self) -> None:
        super().__init__("preload", "Midstride, without its API: rclcpp, `gate preload`")
        self.name = "rclcpp"

    def missing(self, setting: Setting) -> str | None:
        if _prefix_of_rclcpp() is None:
            return "no ROS 2 with the headers of rclcpp is sourced here; its wheels have none"
        return None if shutil.which("g++") else "there is no C++ compiler here"

    def command(self, setting: Setting) -> Sequence[str]:
        return [str(self._program), *setting.stream.words]

    @cached_property
    def _program(self) -> Path:
        program = Path(self._folder.name) / "talker"
        _compile(program)
        return program

    @cached_property
    def _folder(self) -> tempfile.TemporaryDirectory[str]:
        return tempfile.TemporaryDirectory(prefix="rclcpp")  # for all conditions, whose own folders go


def _prefix_of_rclcpp() -> Path | None:
    sourced = [Path(each) for each in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if each]
    return next((each for each in sourced if (each / "include" / "rclcpp").is_dir()), None)


def _compile(program: Path) -> None:
    from tests.native import compile_with_ros

    prefix = _prefix_of_rclcpp()
    assert prefix is not None
    include, libraries = prefix / "include", prefix / "lib"
    headers = [f"-I{each}" for each in (include, *sorted(include.iterdir())) if each.is_dir()]
    options = [*headers, f"-L{libraries}", f"-Wl,-rpath,{libraries}"]
    linked = ("rclcpp", "rmw", "tracetools", "std_msgs__rosidl_typesupport_cpp")
    compile_with_ros([TALKER], program, options, linked, compiler=["g++", "-std=c++17"])
