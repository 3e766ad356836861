"""The work of `midstride dev` on a save: it swaps the nodes whose code, parameters or declaration differ from the
files.

What to do follows from the state alone: the manager knows which programs have changed on disk since they started, and
the specification of the files is compared with the one that runs. So no save is lost, whatever happens meanwhile. What
was refused is tried again when a file that may have to do with it has another content, and so is a node that has
crashed: what ran before it exists no more, so there is nothing to hand back to.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final, Protocol

from msgspec import structs

from midstride.cli.client import Client
from midstride.cli.dev.contents import Contents, FileContents, remove_compiled
from midstride.cli.dev.watched_specification import WatchedSpecification
from midstride.codec.form import Document
from midstride.codec.specification_form import encode_specification
from midstride.errors import SpecificationError
from midstride.runtime.records.reports import Outcome
from midstride.runtime.records.status_forms import ProgramStatus

# For `_refused`: the specification as a whole. No node has this name.
_SPECIFICATION: Final = ""


class Screen(Protocol):
    """The screen that the user sees."""

    def swapped(self, what: str, outcome: Outcome) -> None:
        """A change was carried out, and has been measured."""

    def refused(self, what: str, because: str) -> None:
        """A change was not carried out: what ran before goes on."""

    def faulty(self, error: SpecificationError) -> None:
        """The specification has errors."""


@dataclass
class DevSession:
    """``carry_out(request, finished)`` requests a change and returns why it was refused, if it was.

    It calls ``finished`` with the outcome when that is known: a change may be taken back after its new publishers were
    let in. Without a save, the manager is asked every ``interval`` seconds: a program may import a module late.
    """

    specification: WatchedSpecification
    manager: Client
    carry_out: Callable[[Document, Callable[[Outcome], None]], str | None]
    screen: Screen
    interval: float = 1.0
    _contents: FileContents = field(default_factory=FileContents)
    _programs: list[ProgramStatus] = field(default_factory=list)
    _seen: Contents | None = None
    _read: Contents | None = None
    # Whether the files may have another specification than the one that runs.
    _differs: bool = True
    _ask_next: float = 0.0  # (monotonic s)
    # With which contents of its files each change was requested last, and those that were refused then.
    _tried: dict[str, Contents] = field(default_factory=dict)
    _refused: set[str] = field(default_factory=set)
    # What was requested at once, where it is not known yet what comes of it.
    _open: list[set[str]] = field(default_factory=list)

    def folders(self) -> frozenset[str]:
        """The folders of all files that matter."""
        return frozenset(path for path in map(os.path.dirname, self._watched()) if os.path.isdir(path))

    def look(self) -> None:
        """Something may have been saved: make what runs equal to the files."""
        now = self._contents.of(self._watched())
        if now == self._seen and time.monotonic() < self._ask_next:
            return
        before, self._seen = self._seen or now, now
        self._read_specification()
        self._ask_next = time.monotonic() + self.interval
        self._ask_programs(before)
        changes = dict(self._changes())
        if not changes:
            return
        names = set(changes)
        if self._attempt(changes, names) is not None and len(names) > 1:
            for name in sorted(names):  # one of them may be faulty, and must not keep the others out
                self._attempt(changes, {name})
        # New processes may have other files. What was saved meanwhile is still another content than what was seen.
        self._ask_programs(now)
        self._seen = {**self._contents.of(self._watched()), **self._seen}

    def _ask_programs(self, seen: Contents) -> None:
        """Ask the manager for the programs. That of a node that has crashed is kept: the next save restarts the node.

        ``seen``: the contents of the files before the crash was known.
        """
        known, self._programs = self._programs, self.manager.programs()
        running = {program.role for program in self._programs}
        ended = [program for program in known if program.role not in running]
        if not ended:
            return
        nodes = self.manager.specification().nodes  # what was removed is not missing
        self._programs += [
            structs.replace(program, changed=program.files) for program in ended if program.role in nodes
        ]
        for role in (program.role for program in ended):
            if role not in self._refused:
                self._refused.add(role)
                related = self._related(role)
                self._tried.setdefault(role, {path: seen.get(path, related[path]) for path in related})

    def _read_specification(self) -> None:
        faulty: SpecificationError | None = None
        files = self._contents.of(self.specification.files)
        while files != self._read:
            self._read, faulty = files, None
            try:
                self.specification.read()
                self._differs = True
            except SpecificationError as error:
                faulty = error
            # It may include other files now, and one may have been saved while it was read.
            files = self._contents.of(self.specification.files)
        if faulty is not None:
            self.screen.faulty(faulty)

    def _changes(self) -> Iterator[tuple[str, list[str]]]:
        """The differences from the files, but for what was refused: nodes, or the specification, each with its
        files.
        """
        wanted = self.specification.wanted
        if self._differs and self.manager.specification() == wanted:
            self._differs = False
            self._up_to_date(_SPECIFICATION)
        elif self._differs and self._is_new(_SPECIFICATION):
            yield _SPECIFICATION, [str(self.specification.path)]
        instances = Counter(program.role for program in self._programs)
        for program in self._programs:
            role = program.role
            if instances[role] > 1:  # the new one is being watched, or the change is being rolled back
                if any(role in names for names in self._open) and (saved := self._saved_since(role)):
                    yield role, saved
                continue  # else see what remains
            if not program.changed:
                self._up_to_date(role)
            elif role in wanted.nodes and self._is_new(role):
                if program.startable:
                    yield role, program.changed
                else:
                    self._tried[role] = self._related(role)
                    self.screen.refused(_what({role: program.changed}), f"{role} was started by hand: restart it")

    def _is_new(self, name: str) -> bool:
        """Return whether a change has not been requested yet with the files as they are."""
        return self._tried.get(name) != self._related(name)

    def _saved_since(self, role: str) -> list[str]:
        """The files that have changed since a change was requested with them."""
        tried = self._tried.get(role, {})
        return [path for path, content in self._related(role).items() if tried.get(path, content) != content]

    def _up_to_date(self, name: str) -> None:
        """Note that the running nodes are as the files have them."""
        self._tried.pop(name, None)
        self._refused.discard(name)

    def _attempt(self, changes: dict[str, list[str]], names: set[str]) -> str | None:
        """Request some of the changes; why they were refused, if they were."""
        wanted = self.specification.wanted
        request: Document = {"restart": sorted(names - {_SPECIFICATION})}
        if _SPECIFICATION in names:
            request["to"] = encode_specification(wanted)
        for path in {path for name in names for path in changes[name]}:
            remove_compiled(path)
        what = _what({name: changes[name] for name in sorted(names)})
        self._refused |= names  # from here on, the modules beside are watched, too
        self._tried |= {name: self._related(name) for name in names}
        self._open.append(names)
        refused = self.carry_out(request, partial(self._finished, what, names))
        if refused is None:
            self._refused -= names
        else:
            self._close(names)
            self.screen.refused(what, refused)
        return refused

    def _finished(self, what: str, names: set[str], outcome: Outcome) -> None:
        """Show the outcome of a change whose new publishers were let in. In another thread."""
        self._close(names)
        if outcome.outcome == "done":
            self.screen.swapped(what, outcome)
        else:
            self._refused = self._refused | names
            self.screen.refused(what, str(outcome.because))

    def _close(self, names: set[str]) -> None:
        self._open = [each for each in self._open if each is not names]

    # -- files -----------------------------------------------------------------------------------------

    def _watched(self) -> set[str]:
        files = {*self.specification.files, *(path for program in self._programs for path in program.files)}
        return files.union(*(self._related_paths(name) for name in self._refused))

    def _related(self, name: str) -> Contents:
        return self._contents.of(self._related_paths(name))

    def _related_paths(self, name: str) -> set[str]:
        """The files that may decide whether a change is let in: its own, and modules beside them of no other node."""
        if name == _SPECIFICATION:
            own = {*self.specification.files, *self.specification.programs()}
        else:
            own = {path for program in self._programs if program.role == name for path in program.files}
        others = {path for program in self._programs for path in program.files}
        beside = {str(path) for folder in {Path(path).parent for path in own} for path in folder.glob("*.py")}
        return own | (beside - others)


def _what(changes: dict[str, list[str]]) -> str:
    """``talker (talker.py), listener (listener.py)``"""
    named = {name: ", ".join(map(os.path.basename, files)) for name, files in changes.items()}
    return ", ".join(f"{name} ({files})" if name else files for name, files in named.items())
