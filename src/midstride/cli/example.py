"""The examples that ``demo`` runs: a folder with a specification, its programs, and what to do with them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

import midstride
from midstride.cli.files import load
from midstride.codec.reading import parse_json
from midstride.errors import SpecificationError
from midstride.model.diagnostics import suggestion
from midstride.model.specification import Specification
from midstride.plan.request import Request
from midstride.plan.request_form import decode_request

_PACKAGE = Path(midstride.__file__).resolve().parent


@dataclass(frozen=True, slots=True)
class DemoStep:
    """One change of an example: what it is called, what is said of it, what is asked for."""

    name: str
    says: str
    request: Request


@dataclass(frozen=True, slots=True)
class Demo:
    """``listen_to`` is the role whose log shows what the change looks like from a subscriber's side."""

    name: str
    folder: Path
    title: str
    specification: Specification
    listen_to: str
    acts: tuple[DemoStep, ...]


def find(name: str) -> Demo:
    """The example called ``name``, or in the folder ``name``. Raises UsageError where there is none."""
    known = {file.parent.name: file.parent for file in sorted(examples_folder().glob("*/demo.json"))}
    folder = known.get(name) or Path(name)
    if not (folder / "demo.json").is_file():
        raise click.UsageError(f"there is no example `{name}`; {suggestion(name, known)}")
    return read(folder)


def examples_folder() -> Path:
    """The examples of this Midstride: those of its repository if it runs from one, else those that were installed."""
    root = repository()
    return _PACKAGE / "examples" if root is None else root / "examples"


def repository() -> Path | None:
    """The repository that this Midstride runs from; None for an installed package."""
    root = _PACKAGE.parents[1]
    return root if (root / "examples").is_dir() and (root / "pyproject.toml").is_file() else None


def read(folder: Path) -> Demo:
    """The example in ``folder``. Raises SpecificationError where its ``demo.json`` is none."""
    file = folder / "demo.json"
    document: Any = parse_json(file.read_text(encoding="utf-8"))
    try:
        return Demo(
            name=folder.name,
            folder=folder.resolve(),
            title=str(document["title"]),
            specification=load(folder / document["specification"]),
            listen_to=str(document["listen_to"]),
            acts=tuple(
                DemoStep(str(act["name"]), str(act["says"]), decode_request(act["request"])) for act in document["acts"]
            ),
        )
    except (KeyError, TypeError) as error:
        raise SpecificationError(f"{file}: not the description of an example ({error!r})") from None
