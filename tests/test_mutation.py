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
