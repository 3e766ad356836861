"""The examples that ``demo`` runs: a folder with a specification, its programs, and the changes to make."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

import midstride
from midstride.cli.input_files import load, read_json
from midstride.errors import SpecificationError
from midstride.model.diagnostics import suggestion
from midstride.model.specification import Specification
from midstride.plan.forms.request_form import decode_request
from midstride.plan.request import PlanRequest

_PACKAGE = Path(midstride.__file__).resolve().parent


@dataclass(frozen=True, slots=True)
class DemoStep:
    """One change of an example, with its heading and summary."""

    name: str
    summary: str
    request: PlanRequest


@dataclass(frozen=True, slots=True)
class Demo:
    """An example. ``subscriber`` is the role whose log shows the change from a subscriber's side.

    ``program``: the Python file whose ``run(example, backend, console, only)`` is the demo, where the steps alone are
    not; ``only`` is for :func:`matching`.
    """

    name: str
    folder: Path
    title: str
    specification: Specification
    subscriber: str
    steps: tuple[DemoStep, ...]
    program: Path | None = None


def matching(names: Iterable[str], only: Sequence[str]) -> list[str]:
    """The names that have one of these texts in them; all where none is given. Raises UsageError where none has."""
    every = list(names)
    found = [name for name in every if not only or any(text in name for text in only)]
    if not found:
        raise click.UsageError(f"no step has {' or '.join(map(repr, only))} in its name; there are: {'; '.join(every)}")
    return found


def known_examples() -> dict[str, Path]:
    """The examples of this Midstride: name -> folder."""
    return {file.parent.name: file.parent for file in sorted(examples_folder().glob("*/demo.json"))}


def find(name: str) -> Demo:
    """The example called ``name``, or in the folder ``name``. Raises UsageError if there is none."""
    known = known_examples()
    folder = known.get(name) or Path(name)
    if not (folder / "demo.json").is_file():
        raise click.UsageError(f"there is no example `{name}`; {suggestion(name, known)}")
    return read(folder)


def examples_folder() -> Path:
    """The examples of this Midstride: those of its repository if it runs from one, else those that were installed."""
    return (repository() or _PACKAGE) / "examples"


def repository() -> Path | None:
    """The repository that this Midstride runs from; None for an installed package."""
    root = _PACKAGE.parents[1]
    return root if (root / "examples").is_dir() and (root / "pyproject.toml").is_file() else None


def read(folder: Path) -> Demo:
    """The example in ``folder``. Raises SpecificationError where its ``demo.json`` is invalid."""
    file = folder / "demo.json"
    document: Any = read_json(file)
    try:
        return Demo(
            name=folder.name,
            folder=folder.resolve(),
            title=str(document["title"]),
            specification=load(folder / document["specification"]),
            subscriber=str(document["listen_to"]),
            steps=tuple(
                DemoStep(str(act["name"]), str(act["says"]), decode_request(act["request"])) for act in document["acts"]
            ),
            program=folder.resolve() / document["program"] if "program" in document else None,
        )
    except (KeyError, TypeError) as error:
        why = f"it has no {error}" if isinstance(error, KeyError) else error
        raise SpecificationError(f"{file} does not describe an example: {why}") from None
