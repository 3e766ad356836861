"""Composable nodes on rclcpp (foreign/component.cpp), where a ROS 2 that has rclcpp_components is sourced."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from tests.native import compile_with_ros

_SOURCE = Path(__file__).parent / "foreign" / "component.cpp"
_CLASSES = ("demo::Talker", "demo::Listener")


class OnRclcpp:
    """A package `demo` with these nodes, in the ament index below ``prefix``. Skips where they cannot be compiled."""

    def __init__(self, prefix: Path) -> None:
        sourced = [Path(each) for each in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if each]
        found = next((each for each in sourced if (each / "include" / "rclcpp_components").is_dir()), None)
        compiler = shutil.which("g++")
        if found is None:
            pytest.skip("no ROS 2 with rclcpp_components is sourced here; its wheels have neither that nor rclcpp")
        if compiler is None:
            pytest.skip("no C++ compiler here")
        self.prefix = prefix
        self._compiler = [compiler, "-std=c++17"]
        self._linked = [f"-L{found / 'lib'}", f"-Wl,-rpath,{found / 'lib'}"]
        self._nodes = prefix / "component.o"
        (prefix / "lib").mkdir(parents=True)
        include = found / "include"
        headers = [f"-I{each}" for each in (include, *sorted(include.iterdir())) if each.is_dir()]
        compile_with_ros([_SOURCE], self._nodes, ["-c", "-fPIC", "-O0", *headers], compiler=self._compiler)

    def install(self, text: str) -> None:
        """Link the library of the nodes, which say ``text``, and put it into the place of the one before."""
        said = self.prefix / "text.cpp"
        said.write_text(f'extern "C" {{ extern const char demo_text[] = "{text}"; }}\n', encoding="utf-8")
        built = self.prefix / "lib" / "libdemo.new"
        libraries = ("rclcpp", "class_loader", "component_manager", "std_msgs__rosidl_typesupport_cpp")
        compile_with_ros(
            [said, self._nodes], built, ["-shared", "-fPIC", *self._linked], libraries, compiler=self._compiler
        )
        built.replace(built.with_suffix(".so"))  # a process has the old one open
        index = self.prefix / "share" / "ament_index" / "resource_index"
        classes = "".join(f"{each};lib/libdemo.so\n" for each in _CLASSES)
        for resource, entry in (("packages", ""), ("rclcpp_components", classes)):
            (index / resource).mkdir(parents=True, exist_ok=True)
            (index / resource / "demo").write_text(entry, encoding="utf-8")
