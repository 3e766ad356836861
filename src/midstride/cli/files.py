"""Reading specifications from files, in the Stride language or in JSON; whatever is wrong with one names the file."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from midstride.codec.reading import parse_json
from midstride.codec.specification import decode_specification
from midstride.errors import SpecificationError
from midstride.model.diagnostics import suggestion
from midstride.model.specification import Specification

# No specification and no plan is as long (characters); a device that never ends would fill the memory.
MOST: Final = 64_000_000


def read(path: Path) -> Specification:
    """The specification in a file. Raises SpecificationError with every fault of form and of names."""
    text = _text(path)
    if _is_stride(path):
        return _stride(path)
    try:
        return _parsed(text)
    except SpecificationError as error:
        raise _named(path, error.problems) from None


def read_json(path: Path) -> Any:
    """The value in a JSON file; ``-`` is standard input. Raises SpecificationError where it cannot be read."""
    try:
        return parse_json(_bounded("standard input", sys.stdin.read(MOST + 1)) if str(path) == "-" else _text(path))
    except UnicodeDecodeError as error:
        raise SpecificationError(f"standard input cannot be read: {error}") from None
    except SpecificationError as error:
        raise _named(path, error.problems) from None


def load(path: Path) -> Specification:
    """A specification that may be run or planned with. Raises SpecificationError with every error there is."""
    from midstride.model.specification_checks import check, errors

    specification = read(path)
    if _is_stride(path):
        return specification  # the language tells every error at its place
    if found := errors(check(specification)):
        raise _named(path, found)
    return specification


def _is_stride(path: Path) -> bool:
    return path.suffix != ".json"


def _stride(path: Path) -> Specification:
    from midstride.lang import load as load_stride
    from midstride.lang.message_types import installed

    return load_stride(path, messages=installed()).require()


def must_exist(path: Path) -> None:
    """Raises SpecificationError, with a near miss where there is one, where there is no such file."""
    _text(path)


def _parsed(text: str) -> Specification:
    return decode_specification(parse_json(text))


def _text(path: Path) -> str:
    try:
        with path.open(encoding="utf-8") as file:
            return _bounded(str(path), file.read(MOST + 1))
    except FileNotFoundError:
        folder = path.parent
        files = [entry.name for entry in _candidates(folder)] if folder.is_dir() else []
        hint = suggestion(path.name, files)
        raise SpecificationError(f"there is no file {path}" + (f"; {hint}" if hint else "")) from None
    except IsADirectoryError:
        inside = ", ".join(sorted(str(path / entry.name) for entry in _candidates(path)))
        raise SpecificationError(f"{path} is a folder" + (f"; give a file in it: {inside}" if inside else "")) from None
    except UnicodeDecodeError as error:
        if _is_stride(path):
            return ""  # the language says where
        raise SpecificationError(f"{path} cannot be read: {error}") from None
    except OSError as error:
        raise SpecificationError(f"{path} cannot be read: {error}") from None


def _bounded(name: str, text: str) -> str:
    if len(text) > MOST:
        raise SpecificationError(f"{name} has more than {MOST // 1_000_000} million characters: is it what you meant?")
    return text


def _candidates(folder: Path) -> list[Path]:
    return sorted([*folder.glob("*.stride"), *folder.glob("*.json")])


def _named(path: Path, problems: Iterable[object]) -> SpecificationError:
    return SpecificationError([f"{path}: {problem}" for problem in problems])
