"""The specification that `midstride dev` watches, with all files that it is read from."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path

from midstride.cli.specification_argument import absolute
from midstride.errors import SpecificationError
from midstride.model.specification import Specification
from midstride.wire.program import files_named


class WatchedSpecification:
    """``wanted`` is the specification as it was last without errors."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.files: tuple[str, ...] = (str(path.resolve()),)
        self.wanted = self.read()

    def read(self) -> Specification:
        """Read ``wanted`` again, and which files it includes. Raises SpecificationError."""
        from midstride.lang import load
        from midstride.lang.message_types import installed

        if self.path.suffix == ".json":
            from midstride.cli.input_files import load as load_json

            self.wanted = load_json(self.path)
            return self.wanted
        loaded = load(self.path, messages=installed())
        found = [str(source.path.resolve()) for source in loaded.files if source.path is not None]
        if loaded.has_errors:  # with errors, it may not have come to all of them
            self.files = tuple(dict.fromkeys([*found, *self.files]))
            raise SpecificationError([problem for problem in loaded.diagnostics if problem.severity == "error"])
        self.files = tuple(found)
        self.wanted = loaded.require()
        return self.wanted

    def programs(self) -> Iterator[str]:
        """The files that its components name in `run`."""
        for component in self.wanted.components.values():
            try:
                words = shlex.split(component.run or "")
            except ValueError:
                continue
            yield from files_named(words, str(absolute(self.path).parent))
