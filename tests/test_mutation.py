"""The mutants of tools/mutation.py: each is one of today's code, and is put in the place of a function in memory."""

from __future__ import annotations

import ast
import importlib.util
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from midstride.model.contract import Interval


@pytest.fixture(scope="module")
def mutation() -> Any:
    spec = importlib.util.spec_from_file_location("midstride_mutation", Path("tools/mutation.py").absolute())
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # for its dataclasses
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def unchanged() -> Iterator[None]:
    code = Interval.is_subset.__code__
    yield
    Interval.is_subset.__code__ = code


def mutants(mutation: Any, function: str) -> list[Any]:
    return [each for each in mutation.mutants_of("model/contract.py") if each.function == function]


@pytest.mark.usefixtures("unchanged")
def test_a_mutant_changes_one_place_in_memory_only(mutation: Any) -> None:
    source = (mutation.SOURCE / "model/contract.py").read_text()
    wide = Interval(0.0, 3.0)
    assert not Interval(1.0, 4.0).is_subset(wide)
    [mutant] = [
        each for each in mutants(mutation, "Interval.is_subset") if each.after == "starts_inside or ends_inside"
    ]
    assert mutation.exchange(mutant)
    assert Interval(1.0, 4.0).is_subset(wide)
    assert (mutation.SOURCE / "model/contract.py").read_text() == source


def test_the_changes_of_a_function_are_told_apart(mutation: Any) -> None:
    found = mutants(mutation, "Interval.is_subset")
    assert len({each.key for each in found}) == len(found) > 3
    assert all(each.before != each.after for each in found)


def test_every_mutant_that_is_called_equivalent_is_one_of_todays_code_and_says_why(mutation: Any) -> None:
    known: dict[str, str] = json.loads(mutation.EQUIVALENT.read_text(encoding="utf-8"))
    files = {key.partition("::")[0] for key in known}
    today = {mutant.key for path in files if (mutation.SOURCE / path).exists() for mutant in mutation.mutants_of(path)}
    assert set(known) - today == set()
    assert all(because.endswith(".") for because in known.values())


def test_asserts_annotations_and_docstrings_are_left_alone(mutation: Any) -> None:
    tree = ast.parse('def f(a: int = 1) -> int:\n    """1 + 1"""\n    assert a > 1\n    return a\n')
    changed = [mutant.before for mutant, _ in mutation._changed(tree, "f.py")]
    assert changed == ["return a"]


def test_the_tests_that_reach_the_line_of_a_mutant_are_asked_those_of_its_module_first(mutation: Any) -> None:
    [mutant] = [
        each for each in mutants(mutation, "Interval.is_subset") if each.after == "starts_inside or ends_inside"
    ]
    costs = {
        "tests/runtime/test_a.py::close": 0.5,
        "tests/model/test_why.py::close": 5.0,
        "tests/model/test_contract.py::slow": 3.0,
        "tests/model/test_contract.py::quick": 1.0,
        "tests/model/test_contract.py::elsewhere": 0.1,
    }
    reached = {name: {"model/contract.py": 1 << mutant.line} for name in costs}
    reached["tests/model/test_contract.py::elsewhere"] = {
        "model/contract.py": 1 << mutant.line - 1,
        "model/best.py": -1,
    }
    recorded = mutation.Recorded(costs, reached)
    quick, slow = "tests/model/test_contract.py::quick", "tests/model/test_contract.py::slow"
    assert recorded.chosen(mutant, 100.0) == [
        quick,
        slow,
        "tests/model/test_why.py::close",
        "tests/runtime/test_a.py::close",
    ]
    assert recorded.chosen(mutant, 4.6) == [quick, slow, "tests/runtime/test_a.py::close"]
    assert recorded.chosen(mutant, 0.1) == [quick], "one at least"


def test_the_lines_that_are_reached_are_noted_once_for_each_test(mutation: Any) -> None:
    def lines(of: Any) -> int:
        return sum(1 << line for line in {line for *_, line in of.__code__.co_lines() if line is not None})

    noted, before = mutation._Lines(), sys.gettrace()
    for _ in range(2):
        noted.reached = {}
        sys.settrace(noted)
        try:
            Interval(1.0, 4.0).is_subset(Interval(0.0, 3.0))
        finally:
            sys.settrace(before)
        assert set(noted.reached) == {"model/contract.py"}
        assert noted.reached["model/contract.py"] & lines(Interval.is_subset)
        assert not noted.reached["model/contract.py"] & lines(Interval.__str__)
