"""Files of ROS packages: `package://PACKAGE/FILE`, and the file FILE of PACKAGE as `ros2 launch PACKAGE FILE` finds it.

A package of ROS 2 is one of the ament index, below AMENT_PREFIX_PATH; one of ROS 1 is below ROS_PACKAGE_PATH.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Final

from midstride.ament_index import installed, not_installed, prefix_of, prefixes
from midstride.model.near_miss import did_you_mean

SCHEME: Final = "package://"
PACKAGE_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
MAX_FOLDERS: Final = 50_000
# Files of a package that are looked at, and those that a message names.
_MAX_FILES: Final = 20_000
_MOST_NAMED: Final = 6
_NAME: Final = re.compile(rb"<name>\s*([A-Za-z][A-Za-z0-9_-]*)\s*</name>")
_HEAD: Final = 65_536
_OF_ROS1: Final = "ROS_PACKAGE_PATH"


class NotFound(Exception):
    """There is no such package, or no such file in it; ``help`` says what to do, if that is known."""

    def __init__(self, message: str, help: str | None = None) -> None:
        super().__init__(message if help is None else f"{message}; {help}")
        self.message = message
        self.help = help


def is_name(text: str) -> bool:
    """Return whether ``text`` names a file of a package: `package://…`."""
    return text.startswith(SCHEME)


def path_of(name: str, environment: Mapping[str, str]) -> str:
    """The path of `package://PACKAGE/FILE`; the file need not exist. Raises NotFound."""
    package, _, file = name.removeprefix(SCHEME).partition("/")
    if not (is_name(name) and PACKAGE_NAME.fullmatch(package) and file):
        raise NotFound(f"{name} does not name a file of a package", "write `package://PACKAGE/FILE`")
    folder = share(package, environment)
    path = os.path.normpath(os.path.join(folder, file))
    if file.startswith("/") or not _is_below(folder, path):
        raise NotFound(f"{name} is not a file of package {package}", f"its files are below {folder}")
    return path


def find(package: str, file: str, environment: Mapping[str, str]) -> str:
    """The path of a file of a package: by its path below the share folder, else by its name alone.

    Raises NotFound where there is none, or where several have that name.
    """
    folder = share(package, environment)
    path = path_of(f"{SCHEME}{package}/{file}", environment)
    if os.path.isfile(path):
        return path
    names = list(_files(folder))
    found = [name for name in names if os.path.basename(name) == file]
    if len(found) > 1:
        listed = " or ".join(f"`{SCHEME}{package}/{name}`" for name in found[:_MOST_NAMED])
        raise NotFound(f"package {package} has {len(found)} files {file}", f"write {listed}")
    if not found:
        raise NotFound(f"package {package} has no file {file} in {folder}", other_file(folder, file, names))
    return os.path.join(folder, found[0])


def share(package: str, environment: Mapping[str, str]) -> str:
    """The folder of a package's files. Raises NotFound, naming what was searched."""
    prefix = prefix_of(package, environment)
    if prefix is not None:
        return os.path.join(prefix, "share", package)
    folders = ros1_folders(environment)
    sources = packages_below(folders)
    if package in sources:
        return sources[package]
    message = not_installed(package, environment)
    if folders:
        message = f"package {package} is not below {' or '.join(folders)} ({_OF_ROS1})"
        if prefixes(environment):
            message += f", nor in {' or '.join(prefixes(environment))} (AMENT_PREFIX_PATH)"
    source = "build it, and source the `setup.bash` of its workspace" if folders or prefixes(environment) else None
    raise NotFound(message, did_you_mean(package, [*installed(environment), *sources]) or source)


def other_file(folder: str, file: str, names: Iterable[str] | None = None) -> str:
    """The name in the share folder that was probably meant by ``file``, else the files of its kind that are there."""
    ending = os.path.splitext(file)[1] or ".stride"
    listed = [name for name in (_files(folder) if names is None else names) if name.endswith(ending)]
    if meant := did_you_mean(file, listed) or did_you_mean(os.path.basename(file), listed):
        return meant
    if not listed:
        return f"it has no {ending} files: install them to share/{os.path.basename(folder)}"
    more = f" and {len(listed) - _MOST_NAMED} others" if len(listed) > _MOST_NAMED else ""
    return f"it has {', '.join(listed[:_MOST_NAMED])}{more}"


def owner(path: str, environment: Mapping[str, str]) -> tuple[str, str] | None:
    """The package whose share folder ``path`` is below, and that folder; None for one that is in none.

    Links are not followed: `colcon build --symlink-install` installs links to the sources.
    """
    path = os.path.abspath(path)
    for prefix in prefixes(environment):
        for base in dict.fromkeys((os.path.abspath(prefix), os.path.realpath(prefix))):
            above = os.path.join(base, "share")
            if _is_below(above, path):
                package = os.path.relpath(path, above).partition(os.sep)[0]
                if prefix_of(package, {"AMENT_PREFIX_PATH": base}) is not None:
                    return package, os.path.join(above, package)
    for above in map(os.path.abspath, ros1_folders(environment)):
        folder = os.path.dirname(path)
        while _is_below(above, folder) or folder == above:
            if (named := _package_name(folder)) is not None:
                return named, folder
            if folder == above:
                break
            folder = os.path.dirname(folder)
    return None


def name_of(path: str, environment: Mapping[str, str]) -> str | None:
    """`package://PACKAGE/FILE` for a path that this name finds; None for any other."""
    if (owned := owner(path, environment)) is None:
        return None
    package, folder = owned
    name = f"{SCHEME}{package}/{os.path.relpath(os.path.abspath(path), folder)}"
    try:
        found = path_of(name, environment)
    except NotFound:
        return None
    return name if os.path.realpath(found) == os.path.realpath(path) else None


def stride_files(package: str, environment: Mapping[str, str]) -> list[str]:
    """The specifications of a package, by path below its share folder. Raises NotFound where it is not installed."""
    return [name for name in _files(share(package, environment)) if name.endswith(".stride")]


def packages(environment: Mapping[str, str]) -> list[str]:
    """The names of all packages that can be found."""
    return sorted({*installed(environment), *packages_below(ros1_folders(environment))})


def packages_below(roots: Iterable[str]) -> dict[str, str]:
    """The folder of each package in source trees: the one with its `package.xml`."""
    found: dict[str, str] = {}
    seen = 0
    for root in roots:
        for folder, inner, files in os.walk(root):
            seen += 1
            if seen > MAX_FOLDERS:
                return found
            inner[:] = sorted(name for name in inner if not name.startswith("."))
            if "package.xml" in files:
                inner.clear()
                if (name := _package_name(folder)) is not None:
                    found.setdefault(name, folder)
    return found


def _package_name(folder: str) -> str | None:
    """The name in a folder's `package.xml`; None where that cannot be read, as a link that leads nowhere."""
    try:
        with open(Path(folder, "package.xml"), "rb") as stream:
            match = _NAME.search(stream.read(_HEAD))
    except OSError:
        return None
    return None if match is None else match[1].decode()


def ros1_folders(environment: Mapping[str, str]) -> list[str]:
    """The folders below which packages of ROS 1 are."""
    return [folder for folder in environment.get(_OF_ROS1, "").split(os.pathsep) if folder]


def _files(folder: str) -> Iterator[str]:
    """The files below ``folder``, by path; no hidden ones."""
    seen = 0
    for where, inner, files in os.walk(folder):
        inner[:] = sorted(name for name in inner if not name.startswith("."))
        for name in sorted(files):
            seen += 1
            if seen > _MAX_FILES:
                return
            if not name.startswith("."):
                yield os.path.relpath(os.path.join(where, name), folder)


def _is_below(folder: str, path: str) -> bool:
    return path.startswith(folder.rstrip(os.sep) + os.sep)
