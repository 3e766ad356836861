"""Each symbol of ROS 2 that the source uses is in a list, which says from which distribution to which one it exists.

The list, ros_symbols.tsv, has facts from the public sources of the distributions' releases. What is installed is looked
up. The parameters of functions and the layouts of structures: tests/foreign/test_ros_layouts.py.
"""

from __future__ import annotations

import ctypes
import inspect
import pkgutil
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NamedTuple

import pytest

from midstride.backends.ros2.distributions import DISTRIBUTIONS, of_this_process
from tests.backends import ros_usage

ALL: Final = ("humble", "jazzy", "kilted", "lyrical")
# Names that Midstride, or Python's library, has besides ROS: these are not uses of ROS's.
OTHERS: Final = frozenset(
    "abstractmethod f_back f_code f_lineno util stderr stdout sep environ monotonic time_ns Lock Thread".split()
) | {"__file__", "Response", "GetResultService"}  # which each generated type of a service, or of an action, has
# The libraries that have the functions; those of rclcpp are in none that the wheels bring.
LIBRARIES: Final = (
    "librcl.so",
    "librcl_action.so",
    "librmw_implementation.so",
    "librmw.so",
    "librcutils.so",
    "libtracetools.so",
    "libtype_description_interfaces__rosidl_typesupport_c.so",
)


class Fact(NamedTuple):
    """``without`` says what comes of it where it does not exist."""

    kind: str
    symbol: str
    first: str
    last: str
    files: frozenset[str]
    without: str

    @property
    def name(self) -> str:
        return self.symbol.rpartition(".")[2]

    def is_in(self, distribution: str) -> bool:
        first, last = map(DISTRIBUTIONS.index, (self.first, self.last))
        return first <= DISTRIBUTIONS.index(distribution) <= last


def facts(kind: str = "") -> list[Fact]:
    lines = Path(__file__).with_name("ros_symbols.tsv").read_text().splitlines()[1:]
    found = []
    for line in lines:
        its_kind, symbol, first, last, files, without = line.split("\t")
        found.append(Fact(its_kind, symbol, first, last, frozenset(files.split()), without))
    return [fact for fact in found if fact.kind == kind or not kind]


def listed(kind: str) -> dict[str, set[str]]:
    return {fact.symbol: set(fact.files) for fact in facts(kind)}


def test_what_is_imported_from_ros_is_listed_and_what_is_listed_is_imported() -> None:
    assert listed("import") == ros_usage.imports()


def test_what_the_library_in_nodes_calls_is_listed_and_what_is_listed_is_called() -> None:
    assert listed("function") == ros_usage.functions()


def test_attributes_that_are_listed_are_used_where_the_list_says() -> None:
    used = ros_usage.read()
    assert {
        fact.symbol: set(fact.files) for fact in facts("attribute") if used.get(fact.name, set()) != fact.files
    } == {}


def test_what_does_not_exist_in_each_distribution_says_what_comes_of_that() -> None:
    assert len({fact.symbol for fact in facts()}) == len(facts())
    assert [fact.symbol for fact in facts() if bool(fact.without) == all(map(fact.is_in, ALL))] == []


def modules() -> Iterator[ModuleType]:
    import rclpy

    for found in pkgutil.walk_packages(rclpy.__path__, "rclpy."):
        name = found.name.rpartition(".")[2]
        if "experimental" not in found.name and not name.startswith("_") and name != "qos_event":  # it warns
            yield import_module(found.name)


def classes() -> Iterator[tuple[ModuleType, type]]:
    for module in modules():
        yield from ((module, each) for each in vars(module).values() if inspect.isclass(each))


@pytest.mark.ros2
def test_attributes_of_rclpy_that_are_used_are_listed() -> None:
    """Those that Midstride's or Python's own types have as well are not noticed: the list has them as far as known."""
    names = {name for _, each in classes() for name in dir(each)}
    names |= {name for module in modules() for name in vars(module)}
    used = {name: files for name, files in ros_usage.attributes().items() if name in names - OTHERS}
    missing = used.keys() - {fact.name for fact in facts("attribute")}
    assert {name: used[name] for name in missing} == {}


def found_in_python(symbol: str) -> bool | None:
    """Return whether the installed ROS has an attribute; None where its package is not installed."""
    words = symbol.replace("_rclpy.", "rclpy._rclpy_pybind11.", 1).split(".")
    owner: Any = None
    for length in range(len(words) - 1, 0, -1):
        try:
            owner, rest = import_module(".".join(words[:length])), words[length:-1]
        except ImportError:
            continue
        break
    if owner is None:
        return None
    module = owner
    for word in rest:
        owner = getattr(owner, word, None)
    if owner is None:
        return False
    parts = [owner, *(part for name in ("Request", "Response") if (part := getattr(owner, name, None)) is not None)]
    if any(hasattr(part, words[-1]) for part in parts):
        return True
    if inspect.isclass(owner) and any(words[-1] in getattr(part, "__slots__", ()) for part in parts):
        return True
    return hasattr(module, "__file__") and f"self.{words[-1]}" in Path(module.__file__).read_text(errors="replace")


def found_import(symbol: str) -> bool | None:
    module, _, name = symbol.partition(":")
    try:
        owner = import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        return None if error.name == package else False
    return not name or hasattr(owner, name)


def libraries() -> list[ctypes.CDLL]:
    from rclpy.type_support import check_for_type_support
    from type_description_interfaces.srv import GetTypeDescription

    check_for_type_support(GetTypeDescription)  # which loads its library
    found = []
    for name in LIBRARIES:
        try:
            found.append(ctypes.CDLL(name))
        except OSError:
            continue
    return found


@pytest.mark.ros2
def test_what_is_listed_is_found_in_the_installed_distribution_or_is_not_as_the_list_says() -> None:
    distribution = of_this_process()
    if distribution not in ("jazzy", "kilted"):
        pytest.skip(f"the list says nothing of {distribution}")
    loaded = libraries()
    wrong, looked_up = [], 0
    for fact in facts():
        if fact.kind == "function":
            found = None if fact.symbol.startswith("_ZN") else any(hasattr(each, fact.symbol) for each in loaded)
        else:
            found = found_import(fact.symbol) if fact.kind == "import" else found_in_python(fact.symbol)
        looked_up += found is not None
        if found is not None and found != fact.is_in(distribution):
            wrong.append(f"{fact.symbol} is {'' if found else 'not '}in {distribution}")
    assert wrong == []
    assert looked_up > 200
