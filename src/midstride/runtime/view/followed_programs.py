"""The files of a command, followed from the one that it names: links, console scripts, and the modules behind them.

A program with Midstride's API lists the modules that it has imported. Of any other, only what its files say is known:
of a Python program the modules that it imports from beside it, of a console script of an installed package the module
of its entry point and what that imports from its own package.
"""

from __future__ import annotations

import ast
import glob
import os
from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata
from typing import Final, NamedTuple

# How many files are followed at most, and how large a program's text may be (bytes).
MOST_FILES: Final = 1000
LARGEST_TEXT: Final = 2**20
# Where a package of Python is installed below a prefix of ROS 2, on the distributions that have it.
_INSTALLED: Final = (
    "lib/python3*/site-packages",
    "lib/python3*/dist-packages",
    "local/lib/python3*/dist-packages",
)
_LOADS: Final = ("load_entry_point", "importlib_load_entry_point")


class _Base(NamedTuple):
    """A folder from which modules are followed: all that are there, or only those of one package."""

    folder: str
    package: str | None = None


def module_folders(environment: Mapping[str, str | None], prefix: str | None = None) -> list[str]:
    """The folders where Python finds modules besides its own: PYTHONPATH, and what is installed below ``prefix``."""
    stated = [path for path in (environment.get("PYTHONPATH") or "").split(os.pathsep) if path]
    below = [] if prefix is None else [each for name in _INSTALLED for each in glob.glob(os.path.join(prefix, name))]
    return [*stated, *sorted(below)]


def followed(path: str, folders: Sequence[str]) -> list[str]:
    """The program ``path`` itself, where its links lead, and the modules behind it, in ``folders`` or beside it."""
    found = dict.fromkeys((path, os.path.realpath(path)))
    tree = _parsed(path)
    if tree is not None:
        beside = [_Base(folder) for folder in dict.fromkeys(map(os.path.dirname, found))]
        found |= dict.fromkeys(_imported(tree, path, "", beside))
        entry = _entry_point(tree, folders)
        if entry is not None:
            found |= dict.fromkeys(followed_module(entry, folders))
    return list(found)[:MOST_FILES]


def followed_module(name: str, folders: Sequence[str]) -> list[str]:
    """The file of a module, and those of the modules that it imports from its own package."""
    package = name.partition(".")[0]
    for folder in folders:
        if file := _file_of(name, folder):
            base = _Base(folder, package)
            found = dict.fromkeys([*_packages(name, folder), file, os.path.realpath(file)])
            if (tree := _parsed(file)) is not None:
                found |= dict.fromkeys(_imported(tree, file, name, [base]))
            return list(found)[:MOST_FILES]
    return []


def _parsed(path: str) -> ast.Module | None:
    """The program as Python reads it; None where it is none: a compiled one, or one for another interpreter."""
    try:
        with open(path, "rb") as file:
            text = file.read(LARGEST_TEXT)
        first = text.partition(b"\n")[0]
        if path.endswith(".py") or (first.startswith(b"#!") and b"python" in first):
            return ast.parse(text)
    except (OSError, ValueError, SyntaxError, RecursionError, MemoryError):
        pass
    return None


def _imported(tree: ast.Module, file: str, name: str, bases: Sequence[_Base]) -> Iterator[str]:
    """The files of the modules that a program imports from ``bases``, directly or through others of them.

    ``name``: that of the module in ``file``, empty for a script.
    """
    seen = {file}
    pending = [(tree, file, name)]
    while pending:
        tree, file, name = pending.pop()
        is_package = os.path.basename(file) == "__init__.py"
        for wanted in _names(tree, name, is_package):
            base = next(
                (
                    each
                    for each in bases
                    if each.package in (None, wanted.partition(".")[0]) and _file_of(wanted, each.folder)
                ),
                None,
            )
            if base is None or (module := _file_of(wanted, base.folder)) is None or module in seen:
                continue
            if len(seen) >= MOST_FILES:
                return
            seen.add(module)
            yield from _packages(wanted, base.folder)
            yield from (module, os.path.realpath(module))
            if (parsed := _parsed(module)) is not None:
                pending.append((parsed, module, wanted))


def _names(tree: ast.Module, name: str, is_package: bool) -> Iterator[str]:
    """The full names of what is imported, of which the last word may be that of a name in a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parts = name.split(".") if name else []
            up = node.level - 1 if is_package else node.level
            origin = parts[: len(parts) - up] if node.level else []
            origin += node.module.split(".") if node.module else []
            if origin:
                yield ".".join(origin)
            yield from (".".join([*origin, alias.name]) for alias in node.names)


def _file_of(name: str, folder: str) -> str | None:
    if not all(part.isidentifier() for part in name.split(".")):
        return None
    path = os.path.join(folder, *name.split("."))
    return next((each for each in (f"{path}.py", os.path.join(path, "__init__.py")) if os.path.isfile(each)), None)


def _packages(name: str, folder: str) -> Iterator[str]:
    """The files of the packages that a module is in, which are imported before it."""
    parts = name.split(".")
    for length in range(1, len(parts)):
        path = os.path.join(folder, *parts[:length], "__init__.py")
        if os.path.isfile(path):
            yield path


def _entry_point(tree: ast.Module, folders: Sequence[str]) -> str | None:
    """The module of the entry point that a console script calls, by setuptools or by pip; None where it is neither."""
    origins: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            origins |= {alias.asname or alias.name: node.module for alias in node.names}
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Call) and _is_exit(node.func)):
            continue
        for called in (each.func for each in node.args if isinstance(each, ast.Call)):
            if isinstance(called, ast.Call) and (module := _loaded(called, folders)) is not None:
                return module
            if isinstance(called, ast.Name) and _file_in(origins.get(called.id), folders):
                return origins[called.id]
    return None


def _is_exit(function: ast.expr) -> bool:
    """Return whether it is `sys.exit`, to which a console script passes what its entry point returns."""
    name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
    return name in ("exit", "SystemExit")


def _file_in(module: str | None, folders: Sequence[str]) -> bool:
    return module is not None and any(_file_of(module, folder) for folder in folders)


def _loaded(call: ast.Call, folders: Sequence[str]) -> str | None:
    """The module that ``load_entry_point("demo==1.0", "console_scripts", "talker")`` finds."""
    texts = [each.value for each in call.args if isinstance(each, ast.Constant) and isinstance(each.value, str)]
    if not (isinstance(call.func, ast.Name) and call.func.id in _LOADS and len(texts) == 3):
        return None
    distribution, group, name = texts[0].partition("==")[0], *texts[1:]
    for found in metadata.distributions(name=distribution, path=list(folders)):
        for entry in found.entry_points:
            if (entry.group, entry.name) == (group, name):
                return entry.value.partition(":")[0].strip()
    return None
