"""Mistakes planted in Midstride's own code: only where they can be made, in what the code calls today."""

from __future__ import annotations

import dataclasses
import dis
import inspect
from collections.abc import Callable
from inspect import Parameter
from typing import Any

import pytest


def plant(patch: pytest.MonkeyPatch, owner: Any, name: str, replacement: Callable[..., Any]) -> None:
    """Replace the function, method or property ``name`` of ``owner``, a module, a class or an object.

    ``replacement`` has the parameters of the original (without ``self`` where the owner is an object), or the first of
    them and ``*args, **kwargs``. Raises ValueError if they differ, if only one of the two is a coroutine function, or
    if ``replacement`` reads an attribute of ``self`` that the class does not have: else what a test finds is another
    error, and not the mistake that was meant. Raises AttributeError if there is no such name.
    """
    is_object = not (inspect.ismodule(owner) or inspect.isclass(owner))
    original = getattr(owner, name) if is_object else inspect.getattr_static(owner, name)
    if inspect.isclass(owner) and not isinstance(original, (staticmethod, classmethod)):
        _require_attributes(owner, name, replacement)
    if isinstance(original, property):
        assert original.fget is not None
        _compare(name, original.fget, replacement)
        patch.setattr(owner, name, property(replacement))
    elif isinstance(original, (staticmethod, classmethod)):
        _compare(name, original.__func__, replacement)
        patch.setattr(owner, name, type(original)(replacement))
    else:
        _compare(name, original, replacement)
        patch.setattr(owner, name, replacement)


def plant_value(patch: pytest.MonkeyPatch, owner: type, name: str, make: Callable[[], object]) -> None:
    """The field ``name`` of each ``owner``, a dataclass, is what ``make`` returns, whatever is assigned to it.

    It is made for each reading, so that nothing is kept in it. Raises ValueError if there is no such field.
    """
    if name not in {each.name for each in dataclasses.fields(owner)}:
        raise ValueError(f"{owner.__name__} has no field {name}")
    patch.setattr(owner, name, property(lambda self: make(), lambda self, _: None), raising=False)


def _compare(name: str, original: Callable[..., Any], replacement: Callable[..., Any]) -> None:
    if inspect.iscoroutinefunction(original) != inspect.iscoroutinefunction(replacement):
        raise ValueError(f"{name}: only one of the original and its replacement is a coroutine function")
    wanted, given = _parameters(original), _parameters(replacement)
    if [kind for _, kind, _ in given[-2:]] == [Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD]:
        given = given[:-2]
        wanted = wanted[: len(given)]
    if wanted != given:
        raise ValueError(f"{name}{inspect.signature(original)} is not called as {inspect.signature(replacement)}")


def _require_attributes(owner: type, name: str, replacement: Callable[..., Any]) -> None:
    code = replacement.__code__
    loads = list(dis.get_instructions(code))
    of_self = (now.argval in code.co_varnames[:1] and now.opname.startswith("LOAD_FAST") for now in loads)
    read = {
        following.argval
        for following, is_of_self in zip(loads[1:], of_self, strict=False)
        if is_of_self and following.opname in ("LOAD_ATTR", "LOAD_METHOD")
    }
    functions = [each for kind in owner.__mro__ for each in vars(kind).values() if inspect.isfunction(each)]
    known = {*dir(owner), *(used for each in functions for used in each.__code__.co_names)}
    known.update(*(inspect.get_annotations(kind) for kind in owner.__mro__))
    if unknown := sorted(read - known):
        raise ValueError(
            f"{name} of {owner.__name__}: the replacement reads {', '.join(unknown)}, which it does not have"
        )


def _parameters(function: Callable[..., Any]) -> list[tuple[str, object, bool]]:
    """The name and kind of each, and whether it has a default."""
    parameters = inspect.signature(function).parameters.values()
    return [(each.name, each.kind, each.default is not Parameter.empty) for each in parameters]
