"""The folders of installed ROS 2 packages: the ament index of each prefix in AMENT_PREFIX_PATH, read without ROS."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress

from midstride.errors import StartFailed
from midstride.model.near_miss import did_you_mean

# The component classes of each package: a line each, the class and its library.
COMPONENTS = os.path.join("share", "ament_index", "resource_index", "rclcpp_components")
INDEX = os.path.join("share", "ament_index", "resource_index", "packages")


def prefixes(environment: Mapping[str, str]) -> list[str]:
    return [path for path in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if path]


def prefix_of(package: str, environment: Mapping[str, str]) -> str | None:
    """The first prefix below which ``package`` is installed, as `ros2 run` has it; None where it is nowhere."""
    found = (prefix for prefix in prefixes(environment) if os.path.isfile(os.path.join(prefix, INDEX, package)))
    return next(found, None)


def installed(environment: Mapping[str, str]) -> list[str]:
    """The names of all installed packages."""
    found: set[str] = set()
    for prefix in prefixes(environment):
        with suppress(OSError):
            found.update(name for name in os.listdir(os.path.join(prefix, INDEX)) if not name.startswith("."))
    return sorted(found)


def executable(package: str, name: str, environment: Mapping[str, str]) -> str:
    """The path of an executable of ``package``. Raises StartFailed, naming what was searched."""
    prefix = prefix_of(package, environment)
    if prefix is None:
        raise StartFailed(not_installed(package, environment))
    folder = os.path.join(prefix, "lib", package)
    path = os.path.join(folder, name)
    if os.path.isfile(path) and os.access(path, os.X_OK):
        return path
    help = did_you_mean(name, _executables(folder))
    raise StartFailed(f"package {package} has no executable {name} in {folder}" + (f"; {help}" if help else ""))


def installed_program(pid: int, proc: str = "/proc") -> tuple[str, str] | None:
    """The executable, with its arguments, and its package, that the process ``pid`` was started as.

    Without those for ROS that Midstride states itself: the name and the namespace of its node, and the enclave.
    None where that is no `PREFIX/lib/PACKAGE/NAME`, nor a script there, of an installed package.
    """
    try:
        with open(os.path.join(proc, str(pid), "cmdline"), "rb") as file:
            words = file.read().decode(errors="replace").split("\0")[:-1]
    except OSError:
        return None
    for number, word in enumerate(words[:2]):  # the second is the script of an interpreter
        folder, name = os.path.split(word)
        above, package = os.path.split(folder)
        indexed = os.path.join(os.path.dirname(above), INDEX, package)
        if os.path.basename(above) == "lib" and os.path.isabs(word) and os.path.isfile(indexed):
            return shlex.join([name, *_without_names(words[number + 1 :])]), package
    return None


def _without_names(words: Sequence[str]) -> list[str]:
    """The arguments of a process without the options for ROS that name its node, or its enclave."""
    own: list[str] = []
    of_ros: list[str] = []
    for_ros, rest = False, iter(words)
    for word in rest:
        if word == ("--" if for_ros else "--ros-args"):
            for_ros = not for_ros
        elif for_ros and word in {"-r", "--remap", "-e", "--enclave"}:
            value = next(rest, "")
            name = value.partition(":=")[0].rpartition(":")[2]
            if word in {"-r", "--remap"} and name not in {"__node", "__name", "__ns"}:
                of_ros += [word, value]
        else:
            (of_ros if for_ros else own).append(word)
    return [*own, "--ros-args", *of_ros] if of_ros else own


def component_library(package: str, plugin: str, environment: Mapping[str, str]) -> str:
    """The path of the library that has the class ``plugin`` of ``package``, as a component container looks it up.

    Raises StartFailed, naming what was searched.
    """
    for prefix in prefixes(environment):
        try:
            with open(os.path.join(prefix, COMPONENTS, package), encoding="utf-8", errors="replace") as file:
                entries = [line.split(";") for line in file.read().splitlines() if line]
        except OSError:
            continue
        libraries = {entry[0]: os.path.join(prefix, entry[1]) for entry in entries if len(entry) == 2}
        if plugin not in libraries:
            help = did_you_mean(plugin, libraries) or f"it has {', '.join(sorted(libraries)) or 'none'}"
            raise StartFailed(f"package {package} has no component class {plugin}; {help}")
        if not os.path.isfile(libraries[plugin]):
            raise StartFailed(f"the library of {plugin} is not there: {libraries[plugin]}; build package {package}")
        return libraries[plugin]
    if prefix_of(package, environment) is not None:
        raise StartFailed(f"package {package} registers no component classes (there is no {COMPONENTS}/{package})")
    raise StartFailed(not_installed(package, environment, COMPONENTS))


def not_installed(package: str, environment: Mapping[str, str], index: str = INDEX) -> str:
    """Say that no prefix has ``package`` in its ``index``, or that there is none to look at."""
    searched = prefixes(environment)
    if not searched:
        remedy = "AMENT_PREFIX_PATH is not set; source the setup file of your ROS"
        return f"package {package} cannot be looked up: {remedy}"
    return f"package {package} is not installed: there is no {index}/{package} in {' or '.join(searched)}"


def _executables(folder: str) -> list[str]:
    try:
        with os.scandir(folder) as entries:
            return sorted(each.name for each in entries if each.is_file() and os.access(each.path, os.X_OK))
    except OSError:
        return []
