"""Programs in C on rcl, compiled against the ROS 2 that the tests run with (wheels, or a sourced one); and in Rust."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import sysconfig
from collections.abc import Mapping, Sequence
from ctypes import c_int, c_uint32, c_uint64
from pathlib import Path
from typing import Any

import pytest

from midstride.foreign import build
from midstride.foreign.page import load_library

# What tools/rust builds.
RUST_TALKER = Path(__file__).parents[1] / ".cache" / "rust" / "debug" / "rust_talker"
SOURCE = Path(__file__).parent / "foreign" / "talker.c"
LISTENER = SOURCE.with_name("listener.c")
SERVER = SOURCE.with_name("server.c")
ACTION_SERVER = SOURCE.with_name("action_server.c")
ANSWERER = SOURCE.with_name("answerer.c")
# What ACTION_SERVER is linked with besides.
ACTION_LIBRARIES = (
    "rcl_action",
    "action_msgs__rosidl_typesupport_c",
    "action_msgs__rosidl_generator_c",
    "test_msgs__rosidl_typesupport_c",
    "test_msgs__rosidl_generator_c",
)
_LIBRARIES = (
    "rcl",
    "rcutils",
    "rosidl_runtime_c",
    "rcl_interfaces__rosidl_typesupport_c",
    "rcl_interfaces__rosidl_generator_c",
    "std_msgs__rosidl_typesupport_c",
    "std_msgs__rosidl_generator_c",
)


def baton_steps(path: Path) -> Any:
    """The gate library at ``path``, with what the steps of a baton make of its word as functions."""
    library, number = load_library(path), c_uint32
    following = ctypes.POINTER(c_uint64)
    library.midstride_enter.argtypes = [c_uint64, number, number, c_int, c_int, c_int, following]
    library.midstride_leave.argtypes, library.midstride_leave.restype = [c_uint64, c_uint64, number, c_int], c_uint64
    library.midstride_answers_may.argtypes = [c_uint64, c_int, c_uint64, number, number]
    library.midstride_step.argtypes, library.midstride_step.restype = [c_uint64, c_int, number, number, c_int], c_uint64
    return library


def requests_steps(path: Path) -> Any:
    """The gate library at ``path``, with what its steps make of the words of a role and of a client as functions."""
    library, number = load_library(path), c_uint32
    library.midstride_requests_word.argtypes = [c_uint64, c_int, number, c_int]
    library.midstride_requests_word.restype = c_uint64
    library.midstride_requests_claim.argtypes = [c_uint64, number, ctypes.POINTER(c_uint64)]
    return library


def goal_steps(path: Path) -> Any:
    """The gate library at ``path``, with what its steps make of the word of a goal, and whose turn it is."""
    library, number = requests_steps(path), c_uint32
    library.midstride_goal.argtypes, library.midstride_goal.restype = [c_uint64, c_int, number, c_int], c_uint64
    library.midstride_turn.argtypes = [c_int, number, c_int, number, c_int, c_int, c_int]
    return library


def c_compiler() -> list[str]:
    """The command of the C compiler. Skips where there is none."""
    found = build.compiler()
    if found is None:
        pytest.skip("no C compiler is installed")
    return found


def environment_of_compiled(base: Mapping[str, str]) -> dict[str, str]:
    """That of a program that :func:`compiled` has made. With wheels, rclpy has set the path of their libraries."""
    paths = [base.get("LD_LIBRARY_PATH", ""), sysconfig.get_config_var("LIBDIR")]
    return {**base, "LD_LIBRARY_PATH": os.pathsep.join(filter(None, paths))}


def compiled(folder: Path, source: Path = SOURCE, name: str = "c_talker", besides: Sequence[str] = ()) -> Path:
    """A node on rcl as a program ``name`` in ``folder``, with more libraries. Skips where it cannot be compiled."""
    program = folder / name
    compile_with_ros([source], program, besides=besides)
    return program


def ros_prefix() -> Path:
    """The prefix of the ROS 2 that the tests run with. Skips where it has no headers."""
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    prefix = next((Path(found) for found in prefixes if (Path(found) / "include" / "rcl").is_dir()), None)
    if prefix is None:
        pytest.skip(f"the headers of rcl are in none of {', '.join(prefixes)}")
    return prefix


def compile_with_ros(
    sources: Sequence[Path],
    target: Path,
    options: Sequence[str] = (),
    besides: Sequence[str] = (),
    compiler: Sequence[str] | None = None,
) -> None:
    """Compile ``sources`` in C, and link them with the libraries of rcl and those ``besides``.

    ``options`` stand before the sources; ``compiler``: for another language. Skips where that cannot be done.
    """
    if compiler is None:
        compiler = [*c_compiler(), "-std=gnu11"]
    prefix = ros_prefix()
    include = prefix / "include"
    headers = [f"-I{each}" for each in (include, *sorted(include.iterdir())) if each.is_dir()]
    libraries = [f"-L{prefix / 'lib'}", "-Wl,--no-as-needed", *(f"-l{name}" for name in (*_LIBRARIES, *besides))]
    folder_of_python, version = sysconfig.get_config_vars("LIBDIR", "LDVERSION")
    if (
        Path(folder_of_python) / f"libpython{version}.so"
    ).exists():  # libraries of the wheels need it, without naming it
        libraries += [f"-L{folder_of_python}", f"-lpython{version}"]
    libraries.append("-Wl,--allow-shlib-undefined")
    standard = [] if target.suffix == ".o" else libraries
    command = [*compiler, "-O2", *options, *headers, *map(str, sources), "-o", str(target), *standard]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
