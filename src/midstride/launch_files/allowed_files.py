"""The files that an import may read: a launch file may be a stranger's, and must not choose freely what is read."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from midstride.lang.source import Source
from midstride.lang.source_files import MAX_TOTAL, Bounds, Unreadable, read_source, read_text
from midstride.launch_files.findings import UnknownValue

MAX_FILES: Final = 2048


class ReadableFiles:
    """The files below the folder of ``root``, below the folders that the user names, and below those of packages.

    ``installed``: folders of the workspaces that the user has sourced. A link there leads to a file that may be read:
    `colcon build --symlink-install` installs links to the sources.
    """

    def __init__(self, root: Path, packages: Iterable[str], installed: Iterable[str] = ()) -> None:
        self._bounds = Bounds.of(root, packages)
        self._installed = [each for folder in installed for each in {os.path.abspath(folder), os.path.realpath(folder)}]
        self._read: dict[str, Source] = {}
        self._total = 0

    def source(self, path: str, *endings: str) -> Source:
        """The text of the file at an absolute path. Raises UnknownValue with the reason."""
        if endings and not path.endswith(endings):
            raise UnknownValue(f"its name does not end in {' or '.join(endings)}", "include")
        if not self._bounds.contain(path) and not self._is_installed(path):
            folder = shlex.quote(os.path.dirname(os.path.realpath(path)))
            remedy = f"allow its folder: `midstride --include-path {folder} import …`"
            raise UnknownValue(f"it is not below the folder of the launch file; {remedy}", "include")
        if path not in self._read:
            if len(self._read) >= MAX_FILES or self._total > MAX_TOTAL:
                raise UnknownValue("too many files", "include")
            try:
                self._read[path] = read_source(Path(path), read_text, _shown(path))
            except Unreadable as error:
                raise UnknownValue(str(error), "include") from None
            self._total += len(self._read[path].text)
        return self._read[path]

    def _is_installed(self, path: str) -> bool:
        name = os.path.abspath(path)
        return any(os.path.commonpath((folder, name)) == folder for folder in self._installed)


def _shown(path: str) -> str:
    """``path`` as a user would name it: relative, if it is below the current folder."""
    relative = os.path.relpath(path)
    return path if relative.startswith("..") else relative
