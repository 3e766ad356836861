"""Reading specifications from files; whatever is wrong with one names the file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from midstride.errors import SpecificationError
from midstride.model.document import parse_json, specification_from_document
from midstride.model.problems import suggestion
from midstride.model.specification import Specification


def read(path: Path) -> Specification:
    """The specification in a file. Raises SpecificationError with every fault of form and of names."""
    text = _text(path)
    try:
        return _parsed(text)
    except SpecificationError as error:
        raise _named(path, error.problems) from None


def parse(path: Path) -> Specification:
    """As :func:`read`, but the faults are bare :class:`Problem` values, for those who name the file themselves."""
    return _parsed(_text(path))


def load(path: Path) -> Specification:
    """A specification that may be run or planned with. Raises SpecificationError with every error there is."""
    from midstride.model.wellformed import check, errors

    specification = read(path)
    if found := errors(check(specification)):
        raise _named(path, found)
    return specification


def _parsed(text: str) -> Specification:
    return specification_from_document(parse_json(text))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        folder = path.parent
        files = [entry.name for entry in folder.glob("*.json")] if folder.is_dir() else []
        hint = suggestion(path.name, files)
        raise SpecificationError(f"there is no file {path}" + (f"; {hint}" if hint else "")) from None
    except IsADirectoryError:
        inside = ", ".join(sorted(str(path / entry.name) for entry in path.glob("*.json")))
        raise SpecificationError(f"{path} is a folder" + (f"; give a file in it: {inside}" if inside else "")) from None
    except (OSError, UnicodeDecodeError) as error:
        raise SpecificationError(f"{path} cannot be read: {error}") from None


def _named(path: Path, problems: Iterable[object]) -> SpecificationError:
    return SpecificationError([f"{path}: {problem}" for problem in problems])
