"""Who may import whom: docs/architecture.md, held by reading the source.

A package is a folder or module directly under ``midstride``. One that does not exist yet is bound by its rule from its
first module on, and one that has no rule fails. Imports for type checking alone count: they are dependencies too.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path

import pytest

from midstride.plan.strongly_connected import strongly_connected

ROOT = Path(__file__).parent.parent / "src"
PACKAGE = "midstride"

EVERY = frozenset(
    "model codec wire lang launch_files capture plan verify generate runtime backends node foreign server cli "
    "simulation transitions verdicts whole_file".split()
)

# What each package may import of Midstride, besides itself and `errors`. "" is Midstride's own __init__.
MAY_IMPORT: dict[str, frozenset[str]] = {
    "errors": frozenset(),
    "model": frozenset(),
    "codec": frozenset({"model"}),
    "wire": frozenset({"model", "codec"}),
    "ament_index": frozenset({"model"}),
    "package_files": frozenset({"model", "ament_index"}),
    "transitions": frozenset(),
    "whole_file": frozenset(),
    "verdicts": frozenset({"model", "codec"}),
    "lang": frozenset({"model", "codec", "ament_index", "package_files"}),
    "launch_files": frozenset({"model", "lang", "ament_index", "package_files"}),
    "capture": frozenset({"model", "lang"}),
    "plan": frozenset({"model", "codec", "verdicts"}),
    "generate": frozenset({"model", "codec"}),
    "node": frozenset({"model", "codec", "wire", "transitions"}),
    "verify": frozenset({"model", "codec", "plan"}),
    "runtime": frozenset({"model", "codec", "wire", "plan", "verify", "transitions", "verdicts"}),
    "backends": frozenset({"model", "codec", "wire", "node", "foreign", "runtime", "capture", "ament_index"}),
    "foreign": frozenset({"model", "codec", "wire", "node", "whole_file"}),
    "server": EVERY - {"node", "cli", "simulation", "launch_files", "capture"} | {""},
    "cli": EVERY | {"", "ament_index", "package_files"},
    "simulation": EVERY - {"server", "cli"},
    "": EVERY - {"server", "cli", "simulation"},
    "launch": frozenset({"backends"}),
    "__main__": frozenset({"cli"}),
}

# What a package may import from outside, where that is bounded.
OUTSIDE: dict[str, frozenset[str]] = {
    "errors": frozenset({"__future__"}),
    "model": (frozenset(sys.stdlib_module_names) | {"immutables"}),
    "codec": frozenset(sys.stdlib_module_names) | {"immutables", "msgspec"},
    "wire": frozenset(sys.stdlib_module_names) | {"immutables", "msgspec"},
}

# The model does no I/O and knows no clock.
IMPURE = frozenset(
    "asyncio datetime http io logging multiprocessing os pathlib random selectors shutil signal socket sqlite3 ssl "
    "subprocess tempfile threading time urllib".split()
)

ROS = frozenset(
    "ament_index_python catkin genmsg genpy launch launch_ros rcl rclpy rclpy_action rosgraph roslaunch roslib "
    "rosidl_parser rosidl_runtime_py rosmaster rosparam rospkg rospy rosservice rostopic rpyutils "
    "tf tf2_py tf2_ros xmlrpcros".split()
)
ROS_ENDINGS = ("_msgs", "_srvs", "_interfaces")


def is_ros(module: str) -> bool:
    top = module.partition(".")[0]
    return top in ROS or top.endswith(ROS_ENDINGS)


def absolute(node: ast.ImportFrom, module: str, is_package: bool) -> str:
    """The absolute name of the module that a ``from`` import names."""
    origin = node.module or ""
    if not node.level:
        return origin
    parts = module.split(".")
    parts = parts[: len(parts) - node.level + is_package]
    return ".".join([*parts, origin] if origin else parts)


def imported_by(node: ast.AST, module: str, is_package: bool) -> Iterator[tuple[int, str]]:
    """The line and the absolute name of every module that one node of the syntax tree imports."""
    if isinstance(node, ast.Import):
        for alias in node.names:
            yield node.lineno, alias.name
    elif isinstance(node, ast.ImportFrom):
        origin = absolute(node, module, is_package)
        if origin == PACKAGE:  # `from midstride import model` is about the inner package, not about midstride
            yield from ((node.lineno, f"{PACKAGE}.{alias.name}") for alias in node.names)
        else:
            yield node.lineno, origin
    elif isinstance(node, ast.Call) and node.args:
        called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", None)
        name = node.args[0].value if isinstance(node.args[0], ast.Constant) else None
        if called in {"import_module", "__import__"} and isinstance(name, str):
            yield node.lineno, name


def imported(tree: ast.AST, module: str, is_package: bool) -> Iterator[tuple[int, str]]:
    """The line and the absolute name of every import in a module."""
    for node in ast.walk(tree):
        yield from imported_by(node, module, is_package)


def package_of(name: str) -> str:
    """The package that an absolute name of Midstride belongs to; a public name belongs to its own __init__, ""."""
    package = name.split(".")[1] if "." in name else ""
    return package if package in MAY_IMPORT or package in EVERY else ""


def violations(source: str, module: str, is_package: bool = False) -> list[str]:
    """What a module's imports break, one sentence each."""
    package = module.split(".")[1] if "." in module else ""
    if package not in MAY_IMPORT:
        return [f"{module}: the package {package!r} has no rule: give it one here and in docs/architecture.md"]
    found = []
    for line, name in imported(ast.parse(source), module, is_package):
        top = name.partition(".")[0]
        where = f"{module}:{line}"
        if top == PACKAGE:
            other = package_of(name)
            if other not in MAY_IMPORT[package] | {package, "errors"} or package == "errors":
                found.append(f"{where}: {package or PACKAGE!r} may not import {other or PACKAGE!r} ({name})")
            continue
        if is_ros(name) and package != "backends":
            found.append(f"{where}: only 'backends' imports a ROS library ({name})")
        elif top == "ros2cli" and module != f"{PACKAGE}.cli.ros2_command":
            found.append(f"{where}: only cli/ros2_command.py imports ros2cli")
        elif package in OUTSIDE and top not in OUTSIDE[package]:
            found.append(f"{where}: {package!r} may not import {top!r}")
        elif package == "model" and top in IMPURE:
            found.append(f"{where}: 'model' is pure, and {top!r} is not")
        elif package == "verify" and top == "subprocess" and module != f"{PACKAGE}.verify.run":
            found.append(f"{where}: only verify/run.py starts processes")
    return found


def modules() -> Iterator[tuple[Path, str, bool]]:
    for path in sorted((ROOT / PACKAGE).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        is_package = parts[-1] == "__init__"
        yield path, ".".join(parts[:-1] if is_package else parts), is_package


def test_the_package_keeps_the_rules() -> None:
    found = [
        fault
        for path, module, is_package in modules()
        for fault in violations(path.read_text(encoding="utf-8"), module, is_package)
    ]
    assert not found, "\n" + "\n".join(found)


def test_the_rules_are_not_circular() -> None:
    settled: set[str] = {"errors"}
    waiting = dict(MAY_IMPORT)
    while waiting:
        ready = {package for package, others in waiting.items() if others - {package} <= settled}
        assert ready, f"these import each other: {sorted(waiting)}"
        settled |= ready
        waiting = {package: others for package, others in waiting.items() if package not in ready}


def module_graph(sources: Mapping[str, tuple[str, bool]]) -> dict[str, list[str]]:
    """Which module imports which, given the source of each and whether it is a package.

    Every import counts: also one inside a function, or for type checking alone.
    """
    graph: dict[str, list[str]] = {}
    for module, (source, is_package) in sources.items():
        found: set[str] = set()
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.ImportFrom):
                origin = absolute(node, module, is_package)
                for alias in node.names:  # a name is a submodule, or else an attribute of the package
                    submodule = f"{origin}.{alias.name}"
                    found.add(submodule if submodule in sources else origin)
            else:
                found.update(name for _, name in imported_by(node, module, is_package))
        graph[module] = sorted(found & sources.keys() - {module})
    return graph


def cycles(graph: Mapping[str, Sequence[str]]) -> list[list[str]]:
    """One import cycle of each strongly connected component of more than one module, as a closed path."""
    return [closed_path(graph, part) for part in strongly_connected(graph) if len(part) > 1]


def closed_path(graph: Mapping[str, Sequence[str]], part: Sequence[str]) -> list[str]:
    """A shortest path within ``part`` from its first module, by name, back to it."""
    start = min(part)
    paths = [[start]]
    seen: set[str] = set()
    while True:
        path = paths.pop(0)
        for following in graph[path[-1]]:
            if following == start:
                return [*path, start]
            if following in part and following not in seen:
                seen.add(following)
                paths.append([*path, following])


def test_no_module_imports_itself_through_others() -> None:
    sources = {module: (path.read_text(encoding="utf-8"), is_package) for path, module, is_package in modules()}
    benchmarks = (ROOT.parent / "benchmarks").glob("*.py")
    sources |= {path.stem: (path.read_text(encoding="utf-8"), False) for path in benchmarks}
    graph = module_graph(sources)
    found = cycles(graph)
    assert not found, "\n" + "\n".join(" -> ".join(path) for path in found)


@pytest.mark.parametrize(
    "source",
    [
        "from midstride.plan import one",
        "from . import one",
        "from .one import name",
        "import midstride.plan.one",
        "if TYPE_CHECKING:\n    from midstride.plan.one import Name",
        "def later():\n    from midstride.plan.one import name",
        "import importlib\nimportlib.import_module('midstride.plan.one')",
    ],
)
def test_every_kind_of_import_closes_a_cycle(source: str) -> None:
    sources = {
        "midstride.plan": ("", True),
        "midstride.plan.one": ("from midstride.plan.two import name", False),
        "midstride.plan.two": ("from midstride.plan.three import name", False),
        "midstride.plan.three": (source, False),
    }
    one, two, three = (f"midstride.plan.{name}" for name in ("one", "two", "three"))
    assert cycles(module_graph(sources)) == [[one, two, three, one]]


@cache
def public_names(package: str) -> frozenset[str]:
    """The names that other packages may use of a package's modules: the words of ``PUBLIC`` in its __init__."""
    path = ROOT / package.replace(".", "/") / "__init__.py"
    for statement in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "PUBLIC":
            return frozenset(ast.literal_eval(statement.value).split())
    return frozenset()


def foreign_names(
    tree: ast.AST, module: str, is_package: bool, known: Collection[str]
) -> Iterator[tuple[int, str, str]]:
    """The line, module and name of each import from a module of another package."""
    own = module if is_package else module.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            origin = absolute(node, module, is_package)
            for alias in node.names:
                whole = f"{origin}.{alias.name}" in known
                home = f"{origin}.{alias.name}" if whole else origin
                package = home.rpartition(".")[0]
                if home in known and package != PACKAGE and not f"{own}.".startswith(f"{package}."):
                    yield node.lineno, home, alias.name


def test_other_packages_use_only_the_names_that_a_package_lists() -> None:
    """A package's inner packages may use all of it; examples, as what users write, keep to the lists as well."""
    sources = list(modules())
    known = {module for _, module, is_package in sources if not is_package}
    sources += [(path, "examples", False) for path in sorted((ROOT.parent / "examples").rglob("*.py"))]
    used: dict[str, set[str]] = {}
    faults = []
    for path, module, is_package in sources:
        for line, home, name in foreign_names(ast.parse(path.read_text(encoding="utf-8")), module, is_package, known):
            package = home.rpartition(".")[0]
            used.setdefault(package, set()).add(name)
            if name not in public_names(package):
                faults.append(f"{path}:{line}: {name} of {home} is not in PUBLIC of {package}")
    for package in (module for _, module, is_package in modules() if is_package):
        unused = public_names(package) - used.get(package, set())
        faults += [f"{name} is in PUBLIC of {package}, and no other package uses it" for name in sorted(unused)]
    assert not faults, "\n" + "\n".join(faults)


def public_types(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """The line and the name of each public class of a module, nested ones too, and of each public alias of a type."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield node.lineno, node.name
    for statement in tree.body:
        if isinstance(statement, ast.Assign):
            targets = statement.targets
        elif isinstance(statement, ast.AnnAssign):
            targets = [statement.target]
        else:
            continue
        for target in targets:  # in camel case, or one word; constants and type variables are in capitals
            if isinstance(target, ast.Name) and re.fullmatch(r"[A-Z]\w*[a-z]\w*", target.id):
                yield statement.lineno, target.id


def test_no_two_public_types_share_a_name() -> None:
    homes: dict[str, list[str]] = {}
    for path, module, _ in modules():
        for line, name in public_types(ast.parse(path.read_text(encoding="utf-8"))):
            homes.setdefault(name, []).append(f"{module}:{line}")
    twins = {name: where for name, where in homes.items() if len(where) > 1}
    assert not twins, "\n".join(f"{name}: {', '.join(where)}" for name, where in twins.items())


def test_an_alias_of_a_type_counts_as_a_public_type() -> None:
    source = (
        "Kind = Literal['a']\nPart: TypeAlias = str\nLIMIT = 3\nT = TypeVar('T')\nclass Whole:\n    class Inner: ..."
    )
    assert [name for _, name in public_types(ast.parse(source))] == ["Whole", "Inner", "Kind", "Part"]


# Each platform has modules for the same things; one change of a platform touches one of them.
PLATFORMS = tuple(f"{PACKAGE}.backends.{name}." for name in ("simulator", "ros1", "ros2"))


def test_no_two_modules_share_a_name() -> None:
    homes: dict[str, list[str]] = {}
    for _, module, is_package in modules():
        if not is_package:
            homes.setdefault(module.rpartition(".")[2], []).append(module)
    twins = {
        name: where
        for name, where in homes.items()
        if len(where) > 1 and not all(module.startswith(PLATFORMS) for module in where)
    }
    assert not twins, "\n".join(f"{name}: {', '.join(where)}" for name, where in twins.items())


@pytest.mark.parametrize(
    ("module", "source"),
    [
        (
            "midstride.model.action",
            "from midstride.errors import ActionRefused\nfrom .contract import Contract\nimport enum",
        ),
        ("midstride.model.best", "from immutables import Map"),
        ("midstride.codec.form", "import msgspec\nfrom midstride.model.contract import QoS"),
        ("midstride.wire", "from midstride.model import Mode"),
        ("midstride.plan.strategies.paper", "from ..model.action import Action"),
        ("midstride.runtime.manager", "from midstride.wire import Command\nimport time"),
        ("midstride.backends.ros2", "import rclpy\nfrom std_msgs.msg import String\nfrom midstride.node import ports"),
        ("midstride.server.http_app", "from midstride import __version__\nimport fastapi"),
        ("midstride.cli", "from midstride.server import app\nfrom midstride.backends import ros2"),
        ("midstride", "from midstride.node import Component"),
        ("midstride.verify.run", "import subprocess"),
        ("midstride.cli.ros2_command", "from ros2cli.verb import VerbExtension"),
    ],
)
def test_what_is_allowed(module: str, source: str) -> None:
    assert violations(source, module, is_package=module in {"midstride", "midstride.cli"}) == []


@pytest.mark.parametrize(
    ("module", "source", "because"),
    [
        ("midstride.errors", "import os", "may not import 'os'"),
        ("midstride.errors", "from midstride import model", "may not import 'model'"),
        ("midstride.model.best", "import time", "pure"),
        ("midstride.model.best", "import numpy", "may not import 'numpy'"),
        ("midstride.model.best", "from midstride.plan import paper", "may not import 'plan'"),
        ("midstride.model.best", "from .. import plan", "may not import 'plan'"),
        ("midstride.model.best", "from ..plan.paper import replace", "may not import 'plan'"),
        ("midstride.model.best", "def later():\n    import midstride.runtime", "may not import 'runtime'"),
        ("midstride.model.best", "import msgspec", "may not import 'msgspec'"),
        ("midstride.codec.form", "from midstride.plan import plan", "may not import 'plan'"),
        ("midstride.wire", "from midstride.node import Component", "may not import 'node'"),
        ("midstride.wire", "import pydantic", "may not import 'pydantic'"),
        ("midstride.lang.parser", "from midstride.plan import paper", "may not import 'plan'"),
        ("midstride.node.author.component_class", "import rclpy", "only 'backends'"),
        ("midstride.node.author.component_class", "from sensor_msgs.msg import Image", "only 'backends'"),
        (
            "midstride.node.author.component_class",
            "import importlib\nimportlib.import_module('rclpy.node')",
            "only 'backends'",
        ),
        (
            "midstride.node.author.component_class",
            "if TYPE_CHECKING:\n    import midstride.runtime",
            "may not import 'runtime'",
        ),
        ("midstride.runtime.manager", "from midstride.backends import ros2", "may not import 'backends'"),
        ("midstride.server.http_app", "from midstride.node import Component", "may not import 'node'"),
        ("midstride.plan.strategies.paper", "from midstride import Component", "may not import 'midstride'"),
        ("midstride.verify.export", "import subprocess", "verify/run.py"),
        ("midstride.cli.commands.up", "from ros2cli.cli import main", "only cli/ros2_command.py"),
        ("midstride.attic.old", "", "has no rule"),
    ],
)
def test_what_is_not(module: str, source: str, because: str) -> None:
    assert any(because in fault for fault in violations(source, module))
