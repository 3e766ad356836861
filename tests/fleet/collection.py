"""The Ansible collection of ansible/, as data and as code that needs no Ansible."""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

ROOT = Path(__file__).parents[2]
COLLECTION = ROOT / "ansible"
MODULES = sorted((COLLECTION / "plugins" / "modules").glob("*.py"))


def _load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("robot", COLLECTION / "plugins" / "module_utils" / "robot.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


robot: Any = _load()


def texts(path: Path) -> dict[str, Any]:
    """The documents that a Python file states as strings, by name, as DOCUMENTATION."""
    found = {}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            (target,) = node.targets
            assert isinstance(target, ast.Name)
            found[target.id] = yaml.safe_load(node.value.value) if target.id.isupper() else node.value.value
    return found


def documentation(path: Path) -> dict[str, Any]:
    """The documentation of a module, with the fragments that it extends."""
    stated: dict[str, Any] = texts(path)["DOCUMENTATION"]
    fragments = texts(COLLECTION / "plugins" / "doc_fragments" / "robot.py")
    for name in stated["extends_documentation_fragment"]:
        _, _, part = name.removeprefix("midstride.fleet.").partition(".")
        for key, value in fragments[part.upper() or "DOCUMENTATION"].items():
            stated[key] = {**stated.get(key, {}), **value} if isinstance(value, dict) else value
    return stated


def parameters(specification: dict[str, dict[str, Any]], **given: Any) -> dict[str, Any]:
    """The parameters that Ansible hands to a module: those given, and the default values of the others."""
    assert given.keys() <= specification.keys()
    return {name: given.get(name, stated.get("default")) for name, stated in specification.items()}
