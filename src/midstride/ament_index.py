"""Where ROS 2 packages are installed: the ament index below each prefix of AMENT_PREFIX_PATH, read without ROS."""

from __future__ import annotations

import os
from collections.abc import Mapping

from midstride.errors import StartFailed
from midstride.model.near_miss import did_you_mean

INDEX = os.path.join("share", "ament_index", "resource_index", "packages")


def prefixes(environment: Mapping[str, str]) -> list[str]:
    return [path for path in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if path]


def prefix_of(package: str, environment: Mapping[str, str]) -> str | None:
    """The first prefix below which ``package`` is installed, as `ros2 run` has it; None where it is nowhere."""
    found = (prefix for prefix in prefixes(environment) if os.path.isfile(os.path.join(prefix, INDEX, package)))
    return next(found, None)


def executable(package: str, name: str, environment: Mapping[str, str]) -> str:
    """The path of an executable of ``package``. Raises StartFailed, naming what was searched."""
    prefix = prefix_of(package, environment)
    if prefix is None:
        searched = prefixes(environment)
        if not searched:
            remedy = "AMENT_PREFIX_PATH is not set; source the setup file of your ROS"
            raise StartFailed(f"package {package} cannot be looked up: {remedy}")
        where = f"there is no {INDEX}/{package} in {' or '.join(searched)}"
        raise StartFailed(f"package {package} is not installed: {where}")
    folder = os.path.join(prefix, "lib", package)
    path = os.path.join(folder, name)
    if os.path.isfile(path) and os.access(path, os.X_OK):
        return path
    help = did_you_mean(name, _executables(folder))
    raise StartFailed(f"package {package} has no executable {name} in {folder}" + (f"; {help}" if help else ""))


def _executables(folder: str) -> list[str]:
    try:
        with os.scandir(folder) as entries:
            return sorted(each.name for each in entries if each.is_file() and os.access(each.path, os.X_OK))
    except OSError:
        return []
