"""What the source uses of ROS 2, read from it: modules and names, attributes of ROS's objects, and functions in C."""

from __future__ import annotations

import ast
import asyncio
import builtins
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Final

SOURCE: Final = Path(__file__).parents[2] / "src" / "midstride"
GATE: Final = SOURCE / "foreign" / "gate"
# The packages of ROS 2 whose versions are those of a distribution. Message packages of users are none of them.
PACKAGES: Final = frozenset(
    "rclpy launch launch_ros ament_index_python rcl_interfaces lifecycle_msgs composition_interfaces action_msgs "
    "type_description_interfaces".split()
)
# Its own modules are ROS 2's back end, and those that import one of its packages.
_BACKEND: Final = SOURCE / "backends" / "ros2"
# What Midstride defines: functions, classes, attributes and variables.
_DEFINED: Final = re.compile(
    r"(?:\bdef |\bclass |\bself\.(?=\w+(?:: [^=\n]+)? = )|^\s*(?=\w+(?:: .+|(?:: [^=\n]+)? = )$))(\w+)", re.MULTILINE
)
# Python's own types, whose attributes are not taken for those of ROS's objects.
_PYTHON: Final = (
    *(each for each in vars(builtins).values() if isinstance(each, type)),
    Path,
    re.Match,
    re.Pattern,
    asyncio.Future,
    asyncio.Task,
    asyncio.Event,
    asyncio.Lock,
    asyncio.AbstractEventLoop,
)


def _packages(name: str) -> bool:
    return name.partition(".")[0] in PACKAGES


def _name(path: Path) -> str:
    return str(path.relative_to(SOURCE))


@cache
def _texts() -> Mapping[Path, str]:
    return {path: path.read_text() for path in sorted(SOURCE.rglob("*.py"))}


@cache
def trees() -> Sequence[tuple[Path, ast.Module]]:
    """Those of the files in which a package of ROS 2 is named."""
    named = re.compile(rf"\b({'|'.join(PACKAGES)})\b")
    return [
        (path, ast.parse(text)) for path, text in _texts().items() if _BACKEND in path.parents or named.search(text)
    ]


def _imported(tree: ast.Module) -> Iterator[str]:
    """The modules, as they are, and the names, as `MODULE:NAME`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names if _packages(each.name))
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module and _packages(node.module):
            yield from (f"{node.module}:{each.name}" for each in node.names)


def imports() -> dict[str, set[str]]:
    """Each module, and each name of one, with the files that import it."""
    found = defaultdict[str, set[str]](set)
    for path, tree in trees():
        for each in _imported(tree):
            found[each].add(_name(path))
    return found


def read() -> dict[str, set[str]]:
    """Each attribute that the modules for ROS 2 use, of whatever object, with their files."""
    used = defaultdict[str, set[str]](set)
    for path, tree in trees():
        if _BACKEND in path.parents or any(_imported(tree)):
            for each in _attributes(tree):
                used[each].add(_name(path))
    return used


def attributes() -> dict[str, set[str]]:
    """Each attribute that the modules for ROS 2 use and that is not Midstride's or Python's own, with their files."""
    own = {name for text in _texts().values() for name in _DEFINED.findall(text)}
    python = {name for type_ in _PYTHON for name in dir(type_)}
    return {name: files for name, files in read().items() if name not in own | python}


def _attributes(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        match node:
            case ast.Attribute(attr=name):
                yield name
            case ast.Call(
                func=ast.Name(id="getattr" | "hasattr" | "setattr"), args=[_, ast.Constant(value=str(name)), *_]
            ):
                yield name


def functions() -> dict[str, set[str]]:
    """Each function of ROS, by its symbol, that the library of the gate calls or comes before, with its files in C."""
    texts = {path: path.read_text() for path in sorted(GATE.glob("*.[ch]"))}
    header = texts[GATE / "rcl.h"]
    macros: Mapping[str, str] = dict(re.findall(r'#define (\w+)\s*\\?\s*"(\w+)"', header))
    called = {name: name for name in re.findall(r"^REAL\([^,]*, (\w+),", header, re.MULTILINE)}
    for name, symbol in re.findall(r"^REAL_CALLED\([^,]*, (\w+),\s*(\"?\w+\"?),", header, re.MULTILINE):
        called[name] = symbol.strip('"') if symbol.startswith('"') else macros[symbol]
    found = defaultdict[str, set[str]](set)
    for path, text in texts.items():
        for name, symbol in called.items():
            if re.search(rf"\breal_{name}\(\)", text):
                found[symbol].add(_name(path))
        for name in re.findall(r"^EXPORT \w[\w ]*?\*? ?\*?(\w+)\(", text, re.MULTILINE):
            if not name.startswith("midstride_") and name not in called:
                found[name].add(_name(path))
            elif name in called:
                found[called[name]].add(_name(path))
    return found
