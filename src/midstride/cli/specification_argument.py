"""Arguments of commands that are specifications: a path, `package://PACKAGE/FILE`, or the words PACKAGE FILE."""

from __future__ import annotations

import filecmp
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from glob import escape, glob
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from midstride import package_files
from midstride.errors import SpecificationError


class SpecificationPath(click.Path):
    """A path, or `package://PACKAGE/FILE`, whose path is the value. Raises SpecificationError where that is none."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if isinstance(value, str) and package_files.is_name(value):
            return _of_package(value)
        return super().convert(value, param, ctx)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        scheme = package_files.SCHEME
        if incomplete and (scheme.startswith(incomplete) or incomplete.startswith(scheme)):
            with suppress(package_files.NotFound):
                return [CompletionItem(name) for name in _names(incomplete)]
            return []
        return super().shell_complete(ctx, param, incomplete)


def specification_argument(
    name: str = "file", *, required: bool = True, metavar: str = "[PACKAGE] FILE"
) -> Callable[[Any], Any]:
    """The argument of a command that is about one specification: a Path, or None where none is given."""
    return click.argument(
        name,
        nargs=-1,
        required=required,
        metavar=metavar if required else f"[{metavar}]",
        callback=lambda context, parameter, words: path_of_words(words, context, parameter),
        shell_complete=_complete,
    )


def path_of_words(
    words: tuple[str, ...], context: click.Context | None = None, parameter: click.Parameter | None = None
) -> Path | None:
    """The path that one or two words of a command line name. Raises UsageError, or SpecificationError for a package
    that is not installed or does not have the file."""
    if len(words) < 2:
        return SpecificationPath().convert(words[0], parameter, context) if words else None
    package, file = words[:2]
    if len(words) > 2 or not package_files.PACKAGE_NAME.fullmatch(package):
        extra = " ".join(words[2:] if len(words) > 2 else words[1:])
        raise click.UsageError(
            f"Got unexpected extra argument{'s' if ' ' in extra else ''} ({extra}); give one file, or a package and "
            "the name of a file in it"
        )
    if package_files.is_name(file) or os.path.isabs(file):
        raise click.UsageError(f"{file} says where it is; leave {package} out")
    beside = os.path.join(package, file)
    try:
        path = package_files.find(package, file, os.environ)
    except package_files.NotFound as error:
        here = f"; there is a file {beside} here" if os.path.isfile(beside) else ""
        raise SpecificationError(f"{error}{here}") from None
    for other in (beside, file):
        if os.path.isfile(other) and not filecmp.cmp(other, path, shallow=False):
            click.echo(f"({path} of package {package} is taken; {other} here differs from it)", err=True)
    return Path(path)


def absolute(path: Path) -> Path:
    """The absolute path of a specification, with links followed; but that of an installed package stays there.

    The next build may replace what it links to, and relative paths in it are those of the installed files.
    """
    if package_files.owner(str(path), os.environ) is not None:
        return Path(os.path.abspath(path))
    return path.resolve()


def _of_package(name: str) -> Path:
    try:
        path = package_files.path_of(name, os.environ)
    except package_files.NotFound as error:
        raise SpecificationError(str(error)) from None
    if not os.path.isfile(path):
        package, _, file = name.removeprefix(package_files.SCHEME).partition("/")
        folder = package_files.share(package, os.environ)
        raise SpecificationError(
            f"package {package} has no file {file} in {folder}; {package_files.other_file(folder, file)}"
        )
    return Path(path)


def _complete(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """The files here, else packages, for the first word; the specifications of that package for the second."""
    first = context.params.get(parameter.name or "")
    if first is None:
        found = SpecificationPath().shell_complete(context, parameter, incomplete)
        if incomplete and found[:1] and found[0].type == "file" and not glob(f"{escape(incomplete)}*"):
            names = package_files.packages(os.environ)
            return [CompletionItem(name) for name in names if name.startswith(incomplete)]
        return found
    with suppress(package_files.NotFound):
        names = package_files.stride_files(str(first), os.environ)
        return [CompletionItem(name) for name in names if name.startswith(incomplete)]
    return []


def _names(incomplete: str) -> Iterable[str]:
    package, slash, _ = incomplete.removeprefix(package_files.SCHEME).partition("/")
    if not slash or not incomplete.startswith(package_files.SCHEME):
        names = (f"{package_files.SCHEME}{name}/" for name in package_files.packages(os.environ))
    else:
        names = (f"{package_files.SCHEME}{package}/{file}" for file in package_files.stride_files(package, os.environ))
    return sorted(name for name in names if name.startswith(incomplete))
