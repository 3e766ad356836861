"""Reads specifications from files, in the Stride language or in JSON, and writes files. Errors name the file."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from midstride.codec.reading import parse_json
from midstride.codec.specification_form import decode_specification
from midstride.errors import MidstrideError, SpecificationError
from midstride.model.diagnostics import suggestion
from midstride.model.specification import Specification
from midstride.package_files import PACKAGE_NAME, SCHEME, NotFound, name_of, stride_files
from midstride.whole_file import write_whole

# Longer than any specification or plan. A device that never ends, such as /dev/zero, would fill the memory.
MAX_CHARACTERS: Final = 64_000_000
# How many specifications of a package a message names.
_MOST_NAMED: Final = 4
# Why a file that can be written may not be replaced: its folder is another's, or it is mounted alone.
_IN_PLACE: Final = frozenset({errno.EACCES, errno.EPERM, errno.EROFS, errno.EBUSY})


def as_typed_here(path: str) -> str:
    """An absolute path as a user would type it: relative to the current folder if it is inside, else by its package."""
    here = Path.cwd()
    if Path(path).is_relative_to(here):
        return str(Path(path).relative_to(here))
    return name_of(path, os.environ) or path


def read(path: Path) -> Specification:
    """The specification in a file. Raises SpecificationError with every error of form and of names."""
    if _is_stride(path):
        require_file(path)
        from midstride.lang import load as load_stride
        from midstride.lang.message_types import installed

        return load_stride(path, messages=installed()).require()
    text = _text(path)
    try:
        return decode_specification(parse_json(text))
    except SpecificationError as error:
        raise in_file(path, error.problems) from None


def read_json(path: Path) -> Any:
    """The value in a JSON file; ``-`` is standard input. Raises SpecificationError if it cannot be read."""
    text = _standard_input() if str(path) == "-" else _text(path)
    try:
        return parse_json(text)
    except SpecificationError as error:
        raise in_file(path, error.problems) from None


def load(path: Path) -> Specification:
    """A specification that can be run or planned with. Raises SpecificationError with every error found."""
    from midstride.model.specification_checks import check, errors

    specification = read(path)
    if _is_stride(path):
        return specification  # the language has checked it, with the place of each error
    if found := errors(check(specification)):
        raise in_file(path, found)
    return specification


def require_file(path: Path) -> None:
    """Raises SpecificationError if the file cannot be read, with the name that was probably meant.

    Whether it is UTF-8 is left to what reads it next, which reports the place.
    """
    _text(path, errors="replace")


def require_new(path: Path | None) -> None:
    """Raises MidstrideError if there is such a file: nothing is overwritten that a user may have edited."""
    if path is not None and path.exists():
        raise MidstrideError(f"{path} exists; remove it, or choose another file")


def write(path: Path, text: str) -> None:
    """Write a text file. Raises MidstrideError if that fails; a file that was there is then as before."""
    with written(path):
        if not path.exists() or path.is_file():
            try:
                write_whole(path, text.encode())
                return
            except OSError as error:
                if error.errno not in _IN_PLACE:
                    raise
        path.write_text(text, encoding="utf-8")  # also to /dev/stdout


@contextmanager
def written(path: Path) -> Iterator[None]:
    """Raises MidstrideError if ``path`` cannot be written in the block."""
    try:
        yield
    except OSError as error:
        raise MidstrideError(f"cannot write {path}: {error.strerror}") from None


def _is_stride(path: Path) -> bool:
    return path.suffix != ".json"


def _text(path: Path, errors: str = "strict") -> str:
    """The text of a UTF-8 file, with or without a byte order mark. ``errors``: as for ``open``."""
    try:
        with path.open(encoding="utf-8-sig", errors=errors) as file:
            return _bounded(str(path), file.read(MAX_CHARACTERS + 1))
    except FileNotFoundError:
        folder = path.parent
        files = [entry.name for entry in _candidates(folder)] if folder.is_dir() else []
        hint = suggestion(path.name, files)
        hints = [each for each in (hint, _in_package(str(path))) if each]
        raise SpecificationError("; ".join([f"there is no file {path}", *hints])) from None
    except IsADirectoryError:
        inside = ", ".join(sorted(str(path / entry.name) for entry in _candidates(path)))
        hints = [each for each in (inside and f"give a file in it: {inside}", _in_package(str(path))) if each]
        raise SpecificationError("; ".join([f"{path} is a folder", *hints])) from None
    except UnicodeDecodeError:
        raise SpecificationError(f"cannot read {path}: it is not valid UTF-8; save it as UTF-8") from None
    except OSError as error:
        raise SpecificationError(f"cannot read {path}: {error}") from None


def _in_package(word: str) -> str | None:
    """The specifications of an installed package, as they can be named; None where ``word`` is no name of one."""
    try:
        files = stride_files(word, os.environ) if PACKAGE_NAME.fullmatch(word) else []
    except NotFound:
        return None
    listed = " or ".join(f"`{SCHEME}{word}/{file}`" for file in files[:_MOST_NAMED])
    return f"package {word} has {listed}" if files else None


def _standard_input() -> str:
    try:
        return _bounded("standard input", sys.stdin.read(MAX_CHARACTERS + 1)).removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        raise SpecificationError(f"cannot read standard input: {error}") from None


def _bounded(name: str, text: str) -> str:
    if len(text) > MAX_CHARACTERS:
        raise SpecificationError(f"{name} has more than {MAX_CHARACTERS // 1_000_000} million characters: wrong file?")
    return text


def _candidates(folder: Path) -> list[Path]:
    """The files in ``folder`` that were probably meant: no hidden file, such as the list that `generate` keeps."""
    found = [*folder.glob("*.stride"), *folder.glob("*.json")]
    return sorted(path for path in found if not path.name.startswith("."))


def in_file(path: Path, problems: Iterable[object]) -> SpecificationError:
    return SpecificationError([f"{path}: {problem}" for problem in problems])
